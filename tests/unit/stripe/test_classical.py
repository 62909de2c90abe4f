"""The field's usual estimators, on stripes on which each of them is right within its own known limits."""

import numpy as np
import pytest

from tests.unit.stripe.stripes import clean_picture, gray_light, noisy_picture
from twinline.geometry.noise import NoiseModel
from twinline.stripe import ExtractionSettings, Method, extract
from twinline.stripe.classical import STEGER_WIDTH_PX, fit_classical
from twinline.stripe.tabulated import AMPLITUDE, MISFIT, MU

CENTRES = 48 + np.linspace(-0.5, 0.5, 201)

# Rounding to whole grey levels leaves a Gaussian fit 0.003 px RMS and a centre of gravity over +-7 px 0.006 px. The
# brightest pixel is half a pixel off at worst; Steger's filter has a truncated window and one step of Newton's, whose
# third-order error is largest half a pixel away.
LIMITS: dict[Method, float] = {
    "gaussian": 0.01,
    "centre-of-gravity": 0.03,
    "steger": 0.03,
    "brightest-pixel": 0.51,
}


@pytest.mark.parametrize(("method", "limit_px"), LIMITS.items())
def test_the_centre_of_a_clean_stripe(method: Method, limit_px: float) -> None:
    profile = extract(clean_picture(CENTRES), ExtractionSettings(method=method))
    assert np.abs(profile.centre_px[0] - CENTRES).max() < limit_px


# Below STEGER_WIDTH_PX / sqrt(2) two widths give the same second derivative, and the wider is reported.
WIDTHS: list[tuple[float, Method]] = [(1.0, "gaussian"), *((w, m) for w in (2.0, 3.0) for m in ("gaussian", "steger"))]


def test_the_brightest_pixel_is_a_whole_number() -> None:
    profile = extract(clean_picture(CENTRES), ExtractionSettings(method="brightest-pixel"))
    assert np.array_equal(profile.centre_px[0], np.rint(profile.centre_px[0]))
    assert np.abs(profile.centre_px[0] - CENTRES).max() > 0.45


@pytest.mark.parametrize(("width_px", "method"), WIDTHS)
def test_amplitude_width_and_background_of_a_clean_stripe(width_px: float, method: Method) -> None:
    profile = extract(clean_picture(CENTRES, width_px=width_px), ExtractionSettings(method=method))
    tolerance = 0.01 if method == "gaussian" else 0.2
    assert profile.amplitude_dn[0] == pytest.approx(150, rel=max(tolerance, 0.02) if width_px > 1 else 0.15)
    assert profile.width_px[0] == pytest.approx(width_px, rel=tolerance)
    assert profile.background_dn[0] == pytest.approx(20, abs=1.0 if width_px < 3 else 8.0)


@pytest.mark.parametrize("method", ["gaussian", "centre-of-gravity", "steger"])
def test_the_reported_deviation_is_that_of_the_errors_where_the_method_is_right(method: Method) -> None:
    rng = np.random.default_rng(8)
    centres = 48 + rng.uniform(-0.5, 0.5, 3000)
    image = noisy_picture(centres, rng, width_px=STEGER_WIDTH_PX, amplitude_dn=150.0, noise_dn=2.0)
    settings = ExtractionSettings(method=method, noise=NoiseModel(float(np.sqrt(4 + 1 / 12))))
    profile = extract(image, settings)
    error = profile.centre_px[0] - centres
    assert np.sqrt(np.mean(profile.sd_px[0] ** 2)) / np.std(error) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("method", LIMITS)
def test_a_flat_picture_has_no_stripe_and_no_misfit_is_claimed(method: Method) -> None:
    settings = ExtractionSettings(method=method)
    flat = gray_light(np.full((96, 6), 40, np.uint8))
    columns = np.arange(6, dtype=np.int32)
    out = fit_classical(flat, settings, NoiseModel(1.0), columns, np.full(6, 48, np.int32))
    assert np.isnan(out[MISFIT]).all()
    assert not (out[AMPLITUDE] > 1.0).any()
    profile = extract(np.full((96, 6), 40, np.uint8), settings)
    assert not profile.found.any()


@pytest.mark.parametrize("method", LIMITS)
def test_a_stripe_cut_by_the_border_does_not_leave_the_picture(method: Method) -> None:
    light = gray_light(clean_picture(np.full(9, 0.8)))
    columns = np.arange(9, dtype=np.int32)
    out = fit_classical(light, ExtractionSettings(method=method), NoiseModel(1.0), columns, np.full(9, 1, np.int32))
    centre = out[MU][np.isfinite(out[MU])]
    assert (centre > -0.5).all()
    assert (centre < 8).all()
