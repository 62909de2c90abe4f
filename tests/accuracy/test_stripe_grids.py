"""Centres against the Cramer-Rao bound, over the whole grid of widths, amplitudes and noises.

Budgets are the "must" column of the accuracy goals. They are asserted as they are: the pixels of a cell are always the
same, and the 1.1 % by which 4096 columns may mislead is not conceded on top.
"""

import pytest

from tests.accuracy.stripe_grids import (
    ADDITIVE,
    BUDGETED_CONTRASTS,
    GRADIENTS,
    SATURATED,
    SHOT,
    SLOPED,
    SPECKLED,
    Outcome,
    given,
    plain,
    saturated,
)
from tests.accuracy.synthetic_columns import Stripe

pytestmark = pytest.mark.slow

ADDITIVE_RATIO = 1.10
SLOPED_RATIO = 1.15
SATURATED_RATIO = 1.20
SPECKLED_RATIO = 1.25
SD_SHARE = 0.20
GROSS_SHARE = 0.002
"""Errors beyond 1 px and 5 bounds: at C = 0.37 a row of dark grains may hide one flank of a stripe 1.5 px wide."""
ASTRAY_SHARE = 0.002
"""One false peak in 500 columns, at A/n of little more than 6: what a look at the neighbours removes."""
LOST_SHARE = {False: 0.01, True: 0.10}
"""Share of columns lost, without and with speckle: at A/n = 6.7 and C = 0.37 a grain may put out a stripe 1 px wide."""

SHORTFALLS = {"s1-A1410-n6": 0.30, "s1-A2350-n1": 0.35, "s1-A160-n6-C0.37": 0.24, "s1-A40-n6-C0.37": 0.22}
"""Cells that miss the budget of the reported sd, with the deviation that they may not exceed; server/ACCURACY.md lists
them as missed. A saturated stripe 1 px wide leaves hardly a grey pixel beside its run, and the likelihood is no longer
a parabola over the sd: what is reported is too large, on the safe side. Under the strongest speckle the dark grains of
a stripe 1 px wide that stay below saturation are the quieter ones, so that the contrast estimated from the picture
itself comes out low."""


def sd_share(outcome: Outcome) -> float:
    return SHORTFALLS.get(str(outcome.stripe), SD_SHARE)


def assert_within(outcome: Outcome, ratio: float) -> None:
    __tracebackhide__ = True
    assert outcome.ratio <= ratio, outcome
    assert abs(outcome.sd_ratio - 1) <= sd_share(outcome), outcome
    assert outcome.gross <= GROSS_SHARE, outcome
    assert outcome.astray <= ASTRAY_SHARE, outcome
    assert outcome.lost <= LOST_SHARE[outcome.stripe.contrast > 0], outcome


@pytest.mark.parametrize("stripe", ADDITIVE, ids=str)
def test_additive_noise(stripe: Stripe) -> None:
    assert_within(plain(stripe), ADDITIVE_RATIO)


STEEPEST = tuple(s for s in SLOPED if abs(s.gradient_dn_per_px) == max(GRADIENTS))


@pytest.mark.parametrize("stripe", STEEPEST, ids=str)
def test_an_ambient_gradient(stripe: Stripe) -> None:
    outcome = plain(stripe)
    assert_within(outcome, SLOPED_RATIO)
    # A gradient that is taken for a flank shifts all centres to its bright side.
    assert abs(outcome.bias) <= 0.1, outcome


@pytest.mark.parametrize("stripe", SATURATED, ids=str)
def test_saturation(stripe: Stripe) -> None:
    outcome = saturated(stripe)
    assert outcome.ratio <= SATURATED_RATIO, outcome
    assert outcome.gross == 0, outcome
    assert outcome.lost == 0, outcome


@pytest.mark.parametrize("stripe", SATURATED, ids=str)
def test_the_reported_sd_of_saturated_stripes(stripe: Stripe) -> None:
    outcome = saturated(stripe)
    assert abs(outcome.sd_ratio - 1) <= sd_share(outcome), outcome


@pytest.mark.parametrize("stripe", [s for s in SPECKLED if s.contrast in BUDGETED_CONTRASTS], ids=str)
def test_speckle_of_a_rig_whose_noise_is_known(stripe: Stripe) -> None:
    assert_within(given(stripe), SPECKLED_RATIO)


COARSEST = tuple(
    s for s in SPECKLED if s.contrast == 0.37 and s.amplitude_dn in {40.0, 160.0} and s.width_px in {1.0, 1.5, 3.0}
)


@pytest.mark.parametrize("stripe", COARSEST, ids=str)
def test_speckle_with_the_noise_estimated_from_the_picture_itself(stripe: Stripe) -> None:
    assert_within(plain(stripe), SPECKLED_RATIO)


@pytest.mark.parametrize("stripe", SHOT, ids=str)
def test_shot_noise(stripe: Stripe) -> None:
    assert_within(given(stripe), ADDITIVE_RATIO)
