"""The careful fit against a general maximiser of an independently written likelihood."""

import numpy as np
import pytest
from scipy.optimize import minimize

from tests.unit.stripe.stripes import censored_log_likelihood
from twinline.arrays import ByteArray, FloatArray, IntArray
from twinline.stripe.censored import fit_carefully, solve
from twinline.stripe.tabulated import AMPLITUDE, BACKGROUND, DONE, MU, NOTHING, RESULTS, SD, SD_AMPLITUDE, WIDTH

SATURATION = 250
NO_OFF = np.empty((1, 1), np.uint8)


def careful(
    image: ByteArray,
    rows: IntArray,
    *,
    noise_dn: float,
    contrast: float = 0.0,
    usual: float = 2.0,
    prior: float = 0.0,
    reach: int = 16,
    off: ByteArray | None = None,
) -> tuple[FloatArray, ByteArray]:
    out, outcome = np.full((RESULTS, len(rows)), np.nan), np.zeros(len(rows), np.uint8)
    noise = np.array([noise_dn**2, 0.0, contrast**2])
    fit_carefully(image, NO_OFF if off is None else off, off is not None, 1, 0, -1, SATURATION,
                  np.arange(len(rows), dtype=np.int32), rows.astype(np.int32), usual, prior, reach, noise, out,
                  outcome)  # fmt: skip
    return out, outcome


def picture(amplitude_dn: float, width_px: float, noise_dn: float, columns: int, contrast: float = 0.0) -> ByteArray:
    rng = np.random.default_rng(11)
    k = np.arange(80)[:, None]
    signal = amplitude_dn * np.exp(-((k - 40 - np.linspace(-0.5, 0.5, columns)) ** 2) / (2 * width_px**2))
    value = 20 + signal * (1 + contrast * rng.standard_normal(signal.shape))
    return np.clip(np.rint(value + noise_dn * rng.standard_normal(signal.shape)), 0, 255).astype(np.uint8)


def window(column: ByteArray, row: int, reach: int) -> tuple[FloatArray, int]:
    """The pixels that the careful fit looks at, NaN where saturated, and the row of the first."""
    over = np.flatnonzero(column >= SATURATION)
    low, high = (int(over[0]), int(over[-1])) if len(over) else (row, row)
    middle, grown = (low + high) // 2, reach + high - low
    first, last = max(middle - grown, 0), min(middle + grown + 1, len(column))
    pixels = column[first:last].astype(float)
    pixels[pixels >= SATURATION] = np.nan
    return pixels, first


@pytest.mark.parametrize(
    ("amplitude_dn", "width_px", "noise_dn", "contrast"),
    [(600.0, 2.0, 2.0, 0.0), (1500.0, 3.0, 4.0, 0.0), (100.0, 2.0, 3.0, 0.0), (120.0, 2.0, 2.0, 0.25)],
    ids=["saturated", "far over the top", "not saturated", "speckled"],
)
def test_it_finds_the_maximum_of_the_likelihood(
    amplitude_dn: float, width_px: float, noise_dn: float, contrast: float
) -> None:
    image = picture(amplitude_dn, width_px, noise_dn, 12, contrast)
    rows = np.argmax(image, axis=0)
    out, outcome = careful(image, rows, noise_dn=noise_dn, contrast=contrast, usual=width_px)
    assert (outcome == DONE).all()
    for j in range(12):
        pixels, first = window(image[:, j], int(rows[j]), 16)
        n = len(pixels)

        def loss(theta: FloatArray, pixels: FloatArray = pixels) -> float:
            return -censored_log_likelihood(theta, pixels, SATURATION - 0.5, noise_dn, contrast)

        start = np.array([40.0 - first, np.log(width_px), np.log(amplitude_dn), 20.0, 0.0])
        best = minimize(loss, start, method="Nelder-Mead", options={"maxiter": 6000, "xatol": 1e-6, "fatol": 1e-9})
        best = minimize(loss, best.x, method="Nelder-Mead", options={"maxiter": 6000, "xatol": 1e-6, "fatol": 1e-9})
        sd = out[SD, j]
        # The fit weighs by the variance but takes no hint of the centre from the variance itself.
        near = 0.03 if contrast == 0 else 0.5
        assert out[MU, j] == pytest.approx(first + best.x[0], abs=near * sd)
        assert out[WIDTH, j] == pytest.approx(np.exp(best.x[1]), rel=0.01 if contrast == 0 else 0.15)
        assert out[AMPLITUDE, j] == pytest.approx(np.exp(best.x[2]), rel=0.02 if contrast == 0 else 0.25)
        below = best.x[3] + best.x[4] * (best.x[0] - 0.5 * n)
        assert out[BACKGROUND, j] == pytest.approx(below, abs=0.1 if contrast == 0 else 0.5)


def test_its_deviation_is_that_of_its_errors() -> None:
    image = picture(600.0, 2.0, 3.0, 3000)
    out, _ = careful(image, np.argmax(image, axis=0), noise_dn=np.sqrt(9 + 1 / 12))
    pulls = (out[MU] - 40 - np.linspace(-0.5, 0.5, 3000)) / out[SD]
    assert np.std(pulls) == pytest.approx(1.0, abs=0.06)
    amplitude_pulls = (out[AMPLITUDE] - 600) / out[SD_AMPLITUDE]
    assert np.std(amplitude_pulls) == pytest.approx(1.0, abs=0.1)


def test_few_data_leave_the_width_near_the_usual_one() -> None:
    image = picture(15.0, 3.0, 4.0, 200)
    rows = np.full(200, 40)
    free, held = (careful(image, rows, noise_dn=4.0, usual=3.0, prior=p)[0][WIDTH] for p in (0.0, 0.06))
    assert np.nanstd(held) < 0.25
    assert np.nanstd(free) > 4 * np.nanstd(held)


def test_the_clip_is_lower_by_what_is_subtracted() -> None:
    image = picture(900.0, 2.0, 2.0, 40)
    off = np.full_like(image, 20)
    plain, _ = careful(image, np.argmax(image, axis=0), noise_dn=2.0)
    less, _ = careful(image, np.argmax(image, axis=0), noise_dn=2.0, off=off)
    assert less[MU] == pytest.approx(plain[MU], abs=1e-3)
    assert less[AMPLITUDE] == pytest.approx(plain[AMPLITUDE], rel=1e-3)
    assert less[BACKGROUND] == pytest.approx(plain[BACKGROUND] - 20, abs=1e-2)


def test_a_column_that_is_bright_all_over_holds_nothing() -> None:
    image = np.full((40, 3), 255, np.uint8)
    out, outcome = careful(image, np.full(3, 20), noise_dn=2.0)
    assert (outcome == NOTHING).all()
    assert np.isnan(out[MU]).all()


def test_solve_answers_like_numpy_and_refuses_what_is_not_definite() -> None:
    rng = np.random.default_rng(2)
    for n in (2, 5):
        a = rng.standard_normal((n, n))
        matrix, vector, out = a @ a.T + np.eye(n), rng.standard_normal(n), np.empty(n)
        expected = np.linalg.solve(matrix, vector)
        assert solve(matrix.copy(), vector, out)
        assert out == pytest.approx(expected)
    assert not solve(np.array([[1.0, 2.0], [2.0, 1.0]]), np.ones(2), np.empty(2))
