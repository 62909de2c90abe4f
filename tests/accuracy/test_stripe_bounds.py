"""The yardstick itself: generator and bounds agree with each other and with closed forms."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from tests.accuracy.bounds import _edge, centre_bound_px, clipped_bounds_px, cut_bounds_px
from tests.accuracy.stripe_grids import generator, picture
from tests.accuracy.synthetic_columns import Floats, Stripe, photograph


def oracle_errors(stripe: Stripe, image: Floats, centres: Floats) -> Floats:
    """Errors of one scoring step from the truth, which knows all but the centre: it attains the bound by design."""
    k = np.arange(image.shape[0])[:, None]
    x = k - centres
    m = stripe.amplitude_dn * np.exp(-(x**2) / (2 * stripe.width_px**2))
    slope = m * x / stripe.width_px**2
    weight = 1 / (stripe.noise_dn**2 + 1 / 12 + m / stripe.electrons_per_dn + (stripe.contrast * m) ** 2)
    residual = image - stripe.background_dn - m
    return np.asarray((slope * weight * residual).sum(axis=0) / (slope**2 * weight).sum(axis=0))


@pytest.mark.parametrize(
    "stripe",
    [
        Stripe(1.0, 80.0, 1.0),
        Stripe(4.0, 160.0, 3.0),
        Stripe(2.0, 60.0, 2.0, contrast=0.2),
        Stripe(1.5, 120.0, 2.0, electrons_per_dn=20.0),
    ],
    ids=str,
)
def test_an_oracle_told_all_but_the_centre_attains_the_bound(stripe: Stripe) -> None:
    image, centres = picture(stripe)
    error = oracle_errors(stripe, image.astype(float), centres)
    # 4096 columns: the root mean square has a relative standard deviation of 1.1 %.
    assert np.sqrt(np.mean(error**2)) / centre_bound_px(stripe) == pytest.approx(1.0, abs=0.04)


@pytest.mark.parametrize("width_px", [1.0, 2.0, 4.0])
def test_the_additive_bound_is_the_closed_form_of_a_finely_sampled_gaussian(width_px: float) -> None:
    stripe = Stripe(width_px, 100.0, 3.0)
    closed = 1.0623 * np.sqrt(width_px) * np.sqrt(9.0 + 1 / 12) / 100.0
    assert centre_bound_px(stripe) == pytest.approx(closed, rel=2e-3)


def test_a_clip_far_above_the_stripe_changes_nothing() -> None:
    stripe = Stripe(2.0, 100.0, 3.0)
    assert clipped_bounds_px(stripe) == pytest.approx(centre_bound_px(stripe), rel=2e-3)


@pytest.mark.parametrize("z", [-2.0, -0.3, 0.0, 1.1, 3.0])
def test_the_information_of_a_clipped_pixel_is_that_of_its_likelihood(z: float) -> None:
    # With unit noise and the clip at 0, z is the mean; the squared score is integrated by quadrature.
    below = quad(lambda y: (y - z) ** 2 * norm.pdf(y - z), -np.inf, 0.0)[0]
    at_clip = norm.pdf(z) ** 2 / norm.cdf(z)
    assert norm.cdf(-z) + _edge(np.array([z]))[0] == pytest.approx(below + at_clip, rel=1e-7)


def test_a_cut_profile_tells_less_and_a_whole_one_as_much() -> None:
    stripe = Stripe(2.0, 100.0, 3.0)
    whole, half = cut_bounds_px(stripe, 128, np.array([64.2, 0.0]))
    assert whole == pytest.approx(centre_bound_px(stripe), rel=2e-3)
    assert half > 2 * whole


def test_the_generator_is_what_it_says() -> None:
    stripe = Stripe(2.0, 100.0, 3.0, background_dn=40.0, gradient_dn_per_px=0.5, contrast=0.2)
    image = photograph(stripe, 33, np.full(20000, 16.3), generator(stripe)).astype(float)
    k = np.arange(33)
    signal = 100.0 * np.exp(-((k - 16.3) ** 2) / 8.0)
    assert image.mean(axis=1) == pytest.approx(40.0 + 0.5 * (k - 16) + signal, abs=0.6)
    assert image.var(axis=1) == pytest.approx(9.0 + 1 / 12 + (0.2 * signal) ** 2, rel=0.05)
    assert photograph(Stripe(2.0, 900.0, 3.0), 33, np.array([16.0]), generator(stripe)).max() == 255
