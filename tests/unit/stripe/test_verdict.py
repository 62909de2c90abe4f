"""What is compiled here gives the same as its definition in NumPy."""

import numpy as np
import pytest

from twinline.stripe.tabulated import AMPLITUDE, DONE, MU, NEEDS_CARE, RESULTS, SD, WIDTH
from twinline.stripe.verdict import median, settle_width, significant


@pytest.mark.parametrize("count", [1, 2, 31, 32, 33, 64, 500, 1281])
@pytest.mark.parametrize("kind", ["spread", "few different", "equal", "with gaps"])
def test_the_median_is_that_of_the_finite_values(count: int, kind: str) -> None:
    rng = np.random.default_rng(count)
    values = rng.lognormal(0.0, 1.0, count)
    if kind == "few different":
        values = rng.integers(0, 3, count).astype(np.float64)
    elif kind == "equal":
        values[:] = 2.5
    elif kind == "with gaps":
        values[1::3] = np.nan
    assert median(values, -1.0) == np.nanmedian(values)


def test_the_median_of_nothing_is_what_was_asked_for_instead() -> None:
    assert median(np.full(3, np.nan), 1.5) == 1.5
    assert median(np.empty(0), 1.5) == 1.5


def fits(amplitude: float, width: float, count: int = 1) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    fit = np.ones((RESULTS, count))
    fit[AMPLITUDE], fit[WIDTH] = amplitude, width
    return fit


@pytest.mark.parametrize(
    ("amplitude", "width", "found"),
    [(5.0, 2.0, True), (4.0, 2.0, True), (3.5, 1.2, False), (50.0, 0.9, False), (np.nan, np.nan, False)],
)
def test_a_stripe_stands_out_of_the_noise_and_is_not_much_narrower_than_usual(
    amplitude: float, width: float, found: bool
) -> None:
    assert significant(fits(amplitude, width), 1.0, 4.5, 2.0)[0] == found


def test_a_fit_without_a_centre_is_no_stripe() -> None:
    fit = fits(50.0, 2.0)
    fit[MU] = np.nan
    assert not significant(fit, 1.0, 4.5, 2.0)[0]


def test_the_usual_width_counts_fitted_columns_only_and_needs_half_of_them() -> None:
    fit = fits(50.0, 2.0, 5)
    fit[WIDTH, 3:] = 9.0
    fit[SD] = 0.0
    outcome = np.array([DONE, DONE, DONE, NEEDS_CARE, NEEDS_CARE], np.uint8)
    assert settle_width(fit, outcome, 1.0, 4.5, (0.06, 0.5)) == (2.0, 0.06)
    outcome[2] = NEEDS_CARE
    width, spread = settle_width(fit, outcome, 1.0, 4.5, (0.06, 0.5))
    assert np.isnan(width)
    assert spread == 0.5
