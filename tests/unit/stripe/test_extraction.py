"""One picture in, one profile out: flags, bands, runner-ups, and what cannot be extracted."""

import numpy as np
import pytest

from tests.unit.stripe.stripes import clean_picture, noisy_picture
from twinline.errors import StripeError
from twinline.geometry.noise import NoiseModel
from twinline.stripe import METHODS, ExtractionSettings, Flag, Method, extract
from twinline.stripe.light import take_light
from twinline.stripe.peaks import TILE_COLUMNS, tile_bands
from twinline.stripe.width import usual_width

COLUMNS = 300
CENTRES = 47.3 + 3 * np.sin(np.arange(COLUMNS) / 40.0)


def rng() -> np.random.Generator:
    return np.random.default_rng(21)


def flagged(flags: np.ndarray, flag: Flag) -> np.ndarray:
    return np.asarray((flags & int(flag)) != 0)


def test_a_clean_stripe_is_measured_with_all_its_numbers_and_no_flag() -> None:
    profile = extract(noisy_picture(CENTRES, rng(), amplitude_dn=150.0, noise_dn=1.0))
    assert profile.found.all()
    assert np.sqrt(np.mean((profile.centre_px[0] - CENTRES) ** 2)) < 0.012
    assert np.median(profile.amplitude_dn) == pytest.approx(150, rel=0.01)
    assert np.median(profile.width_px) == pytest.approx(2.0, rel=0.01)
    assert np.median(profile.background_dn) == pytest.approx(20, abs=0.3)
    assert np.median(profile.misfit) == pytest.approx(1.0, abs=0.15)
    assert (profile.flags == 0).mean() > 0.98


@pytest.mark.parametrize("width_px", [0.8, 1.5, 3.0, 6.0, 10.0, 18.0])
def test_stripes_of_any_width_are_measured(width_px: float) -> None:
    image = noisy_picture(np.full(COLUMNS, 120.4), rng(), rows=240, width_px=width_px)
    profile = extract(image)
    bound = 1.0623 * np.sqrt(width_px) * np.sqrt(4 + 1 / 12) / 120
    assert profile.found.all()
    assert np.sqrt(np.mean((profile.centre_px[0] - 120.4) ** 2)) < 1.3 * bound
    assert np.median(profile.width_px) == pytest.approx(width_px, rel=0.03)


@pytest.mark.parametrize("method", METHODS)
def test_columns_without_a_stripe_are_missing_and_nan(method: Method) -> None:
    centres = CENTRES.copy()
    centres[100:200] = np.nan
    profile = extract(noisy_picture(centres, rng()), ExtractionSettings(method=method))
    dark = slice(101, 199)
    assert not profile.found[0, dark].any()
    assert flagged(profile.flags[0, dark], Flag.MISSING).all()
    for values in (profile.centre_px, profile.sd_px, profile.amplitude_dn, profile.width_px, profile.misfit):
        assert np.isnan(values[0, dark]).all()
    assert profile.found[0, :100].all()
    assert profile.found[0, 200:].all()
    assert not flagged(profile.flags[0, :99], Flag.MISSING).any()


def test_the_columns_beside_a_gap_are_broken() -> None:
    centres = CENTRES.copy()
    centres[100:200] = np.nan
    broken = flagged(extract(noisy_picture(centres, rng())).flags[0], Flag.BROKEN)
    assert np.flatnonzero(broken).tolist() == [99, 200]


def test_a_weak_stripe_is_flagged_so() -> None:
    weak = extract(noisy_picture(CENTRES, rng(), amplitude_dn=10.0))
    strong = extract(noisy_picture(CENTRES, rng(), amplitude_dn=100.0))
    assert flagged(weak.flags[weak.found], Flag.WEAK).mean() > 0.4
    assert not flagged(strong.flags, Flag.WEAK).any()


def test_a_saturated_stripe_is_flagged_and_still_measured() -> None:
    profile = extract(noisy_picture(CENTRES, rng(), amplitude_dn=800.0))
    assert flagged(profile.flags, Flag.SATURATED).all()
    assert np.abs(profile.centre_px[0] - CENTRES).max() < 0.1
    assert np.median(profile.amplitude_dn) == pytest.approx(800, rel=0.05)


def test_the_saturation_level_is_a_setting() -> None:
    image = np.minimum(noisy_picture(CENTRES, rng(), amplitude_dn=220.0), 180)
    profile = extract(image, ExtractionSettings(saturation_dn=180))
    assert flagged(profile.flags, Flag.SATURATED).all()
    assert np.median(profile.amplitude_dn) == pytest.approx(220, rel=0.05)


@pytest.mark.parametrize("row", [1.0, 94.0])
def test_a_stripe_at_the_border_is_flagged_and_measured(row: float) -> None:
    profile = extract(noisy_picture(np.full(COLUMNS, row), rng()))
    assert flagged(profile.flags, Flag.NEAR_EDGE).mean() > 0.97
    assert np.nanstd(profile.centre_px - row) < 0.2


def test_a_second_peak_is_named_with_its_place_and_height() -> None:
    image = noisy_picture(CENTRES, rng(), rows=160)
    ghost = clean_picture(np.full(COLUMNS, 120.0), rows=160, amplitude_dn=90.0, background_dn=0.0)
    profile = extract(image + ghost)
    assert flagged(profile.flags, Flag.SECOND_PEAK).all()
    assert np.abs(profile.runner_up_px - 120).max() <= 2
    assert np.median(profile.runner_up_dn) == pytest.approx(90, abs=8)
    faint = extract(image + (ghost // 3))
    assert not flagged(faint.flags, Flag.SECOND_PEAK).any()
    assert np.abs(profile.centre_px[0] - CENTRES).max() < 0.15


@pytest.mark.parametrize("distance_px", [16.0, 20.0, 24.0, 28.0, 32.0, 40.0, 60.0])
def test_a_dimmer_ghost_does_not_pass_for_the_stripe_and_a_bright_one_is_named(distance_px: float) -> None:
    centres = np.linspace(60.0, 100.0, 1000)
    for share in (0.6, 0.8):
        ghost = clean_picture(centres + distance_px, rows=220, amplitude_dn=150.0 * share, background_dn=0.0)
        profile = extract(clean_picture(centres, rows=220) + ghost, ExtractionSettings(noise=NoiseModel(1.0)))
        right = np.abs(profile.centre_px[0] - centres) < 0.5
        assert right.all() or share > 0.75
        assert flagged(profile.flags[0, ~right], Flag.SECOND_PEAK).all()


def test_a_wide_patch_and_an_odd_shape_are_flagged() -> None:
    image = noisy_picture(CENTRES, rng())
    wide = noisy_picture(CENTRES, rng(), width_px=6.0)
    image[:, 50:60] = wide[:, 50:60]
    profile = extract(image)
    assert flagged(profile.flags[0, 50:60], Flag.WIDE).all()
    assert not flagged(profile.flags[0, 100:], Flag.WIDE).any()
    image = noisy_picture(CENTRES, rng())
    image[:, 150:160] = np.where(np.abs(np.arange(96)[:, None] - CENTRES[150:160]) < 4, 140, 20)
    assert flagged(extract(image).flags[0, 150:160], Flag.POOR_FIT).all()


def test_a_hot_pixel_is_no_stripe() -> None:
    image = noisy_picture(np.full(COLUMNS, np.nan), rng())
    image[40, 150] = 255
    image[60, 200] = 120
    assert not extract(image).found[0, [150, 200]].any()


@pytest.mark.parametrize("amplitude_dn", [0.0, 235.0])
def test_a_uniform_picture_has_no_stripe_and_no_complaint(amplitude_dn: float) -> None:
    assert not extract(np.full((96, 200), 20 + amplitude_dn, np.uint8)).found.any()


@pytest.mark.parametrize("shape", [(1, 1), (2, 300), (5, 7), (300, 1), (9, 300)])
def test_tiny_pictures_do_not_break_it(shape: tuple[int, int]) -> None:
    image = rng().integers(0, 60, shape).astype(np.uint8)
    for method in METHODS:
        profile = extract(image, ExtractionSettings(method=method))
        assert profile.centre_px.shape == (1, shape[1])


@pytest.mark.parametrize("method", METHODS)
def test_a_few_columns_are_enough(method: Method) -> None:
    profile = extract(noisy_picture(CENTRES[:5], rng()), ExtractionSettings(method=method))
    assert profile.found.all()


def test_a_stripe_in_a_fifth_of_the_columns_is_found_there() -> None:
    centres = np.where(np.arange(COLUMNS) < 60, CENTRES, np.nan)
    found = extract(noisy_picture(centres, rng())).found[0]
    assert found[:60].all()
    assert not found[61:].any()


def test_an_empty_band_finds_nothing_and_a_band_beyond_the_picture_is_cut() -> None:
    image = noisy_picture(CENTRES, rng())
    bands = np.zeros((2, COLUMNS, 2), np.int32)
    bands[0] = (30, 30)
    bands[1] = (-50, 5000)
    profile = extract(image, bands=bands)
    assert not profile.found[0].any()
    assert profile.found[1].all()


@pytest.mark.parametrize("shape", [(1, COLUMNS + 1, 2), (COLUMNS, 2), (1, COLUMNS, 3)])
def test_bands_of_the_wrong_shape_are_refused_with_the_right_one(shape: tuple[int, ...]) -> None:
    with pytest.raises(StripeError, match=rf"must have shape \(lasers, {COLUMNS}, 2\), not"):
        extract(noisy_picture(CENTRES, rng()), bands=np.zeros(shape, np.int32))


def test_tiles_take_the_hull_of_their_columns_bands() -> None:
    columns = TILE_COLUMNS + 10
    bands = np.zeros((1, columns, 2), np.int32)
    bands[0, :, 0], bands[0, :, 1] = np.arange(columns), 200 + np.arange(columns)
    tiles = tile_bands(bands)
    assert tiles[0].tolist() == [[0, 200 + TILE_COLUMNS - 1], [TILE_COLUMNS, 200 + columns - 1]]


def test_tiles_of_two_lasers_are_parted_where_they_overlap() -> None:
    bands = np.zeros((2, 50, 2), np.int32)
    bands[0], bands[1] = (40, 100), (0, 60)
    assert tile_bands(bands)[:, 0].tolist() == [[50, 100], [0, 50]]


@pytest.mark.parametrize("width_px", [1.0, 2.0, 5.0, 12.0])
def test_the_usual_width_is_told_from_the_mean_profile(width_px: float) -> None:
    image = noisy_picture(np.full(COLUMNS, 120.0), rng(), rows=240, width_px=width_px, contrast=0.2)
    light = take_light(image, "gray", along_v=False)
    columns = np.arange(COLUMNS, dtype=np.int32)
    assert usual_width(light, columns, np.full(COLUMNS, 120, np.int32)) == pytest.approx(width_px, rel=0.35)


def test_the_usual_width_of_a_single_flat_column_is_a_number() -> None:
    light = take_light(np.full((200, 3), 7, np.uint8), "gray", along_v=False)
    width = usual_width(light, np.array([1], np.int32), np.array([100], np.int32))
    assert np.isfinite(width)


def test_the_usual_width_of_pixels_darker_than_their_surroundings_is_a_number() -> None:
    image = np.full((200, 3), 90, np.uint8)
    image[100] = 20
    light = take_light(image, "gray", along_v=False)
    assert np.isfinite(usual_width(light, np.array([1], np.int32), np.array([100], np.int32)))


def test_the_same_picture_gives_the_same_answer_with_the_noise_given_or_found() -> None:
    image = noisy_picture(CENTRES, rng(), noise_dn=2.0)
    found, given = extract(image), extract(image, ExtractionSettings(noise=NoiseModel(2.02)))
    assert found.centre_px == pytest.approx(given.centre_px, abs=0.01)
    assert np.median(found.sd_px / given.sd_px) == pytest.approx(1.0, abs=0.08)
