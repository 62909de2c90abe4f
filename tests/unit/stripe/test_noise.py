"""The noise of the pixels, recovered from pictures whose noise is known."""

import numpy as np
import pytest

from tests.unit.stripe.stripes import gray_light, noisy_picture, whole_band
from twinline.geometry.noise import NoiseModel
from twinline.stripe import ExtractionSettings
from twinline.stripe.light import take_light
from twinline.stripe.noise import estimate_noise, read_noise, rounded

COLUMNS = 1500
CENTRES = 48 + 4 * np.sin(np.arange(COLUMNS) / 50.0)


def estimated(width_px: float, amplitude_dn: float, noise_dn: float, contrast: float) -> NoiseModel:
    rng = np.random.default_rng(7)
    image = noisy_picture(
        CENTRES, rng, width_px=width_px, amplitude_dn=amplitude_dn, noise_dn=noise_dn, contrast=contrast
    )
    light = gray_light(image)
    return estimate_noise(light, whole_band(light), ExtractionSettings())


@pytest.mark.parametrize("noise_dn", [0.5, 1.0, 3.0, 8.0])
@pytest.mark.parametrize("slope", [0.0, 1.5])
def test_read_noise_is_that_of_the_dark_pixels_and_no_gradient(noise_dn: float, slope: float) -> None:
    rng = np.random.default_rng(1)
    image = noisy_picture(CENTRES, rng, rows=720, noise_dn=noise_dn, background_dn=40.0)
    ramp = np.rint(slope * np.arange(720) / 7.5).astype(np.uint8)[:, None]
    expected = np.sqrt(noise_dn**2 + 1 / 12)
    assert read_noise(gray_light(np.minimum(image, 255 - ramp) + ramp)) == pytest.approx(expected, rel=0.1)


def test_a_subtracted_picture_adds_its_own_read_noise() -> None:
    rng = np.random.default_rng(1)
    image, off = (noisy_picture(np.full(400, np.nan), rng, noise_dn=3.0) for _ in range(2))
    light = take_light(image, "gray", along_v=False, off=off)
    assert read_noise(light) == pytest.approx(np.sqrt(2 * (9 + 1 / 12)), rel=0.05)
    colour = np.dstack([image, image, off])
    assert read_noise(take_light(colour, "red-blue", along_v=False)) == pytest.approx(read_noise(light), rel=1e-9)


@pytest.mark.parametrize(("width_px", "noise_dn"), [(1.0, 2.0), (2.0, 1.0), (2.0, 4.0), (4.0, 2.0)])
def test_additive_noise_is_recovered_and_no_speckle_invented(width_px: float, noise_dn: float) -> None:
    found = estimated(width_px, 120.0, noise_dn, 0.0)
    assert found.read_dn == pytest.approx(np.sqrt(noise_dn**2 + 1 / 12), rel=0.06)
    assert np.sqrt(found.variance_dn2(np.array([120.0]))[0]) < 1.3 * found.read_dn


@pytest.mark.parametrize("contrast", [0.1, 0.2, 0.3])
@pytest.mark.parametrize("width_px", [2.0, 4.0])
def test_speckle_is_recovered_with_the_read_noise(width_px: float, contrast: float) -> None:
    found = estimated(width_px, 100.0, 2.0, contrast)
    assert found.read_dn == pytest.approx(np.sqrt(4 + 1 / 12), rel=0.15)
    spread = np.sqrt(found.variance_dn2(np.array([100.0]))[0] - found.read_dn**2) / 100.0
    assert spread == pytest.approx(contrast, rel=0.12)


def test_a_picture_without_a_stripe_tells_only_its_read_noise() -> None:
    rng = np.random.default_rng(4)
    light = gray_light(noisy_picture(np.full(500, np.nan), rng, noise_dn=2.0))
    found = estimate_noise(light, whole_band(light), ExtractionSettings())
    assert found == NoiseModel(found.read_dn)
    assert found.read_dn == pytest.approx(2.02, rel=0.05)


def test_other_methods_need_only_the_read_noise() -> None:
    rng = np.random.default_rng(4)
    light = gray_light(noisy_picture(CENTRES, rng, contrast=0.3))
    found = estimate_noise(light, whole_band(light), ExtractionSettings(method="steger"))
    assert found == NoiseModel(found.read_dn)


def test_a_picture_of_two_rows_does_not_break_it() -> None:
    assert read_noise(gray_light(np.zeros((2, 50), np.uint8))) == 1.0


def test_models_are_rounded_to_two_digits() -> None:
    assert rounded(NoiseModel(1.2345, 17.89, 0.2149)) == NoiseModel(1.2, 18.0, 0.21)
    assert rounded(NoiseModel(1.26)) == NoiseModel(1.3)
