"""The pictures that are measured on hold the two stripes that they claim to hold."""

import numpy as np
import pytest

from twinline.bench.pictures import NOISE_DN, Brush
from twinline.geometry.noise import NoiseModel
from twinline.stripe import Channel, ExtractionSettings, extract


@pytest.mark.parametrize(("colour", "channel"), [(False, "gray"), (True, "red"), (True, "red-blue")])
def test_both_stripes_are_found_where_they_were_drawn(colour: bool, channel: Channel) -> None:
    brush = Brush(320, 180, np.random.default_rng(5))
    centres = brush.waves(0.2)
    picture = brush.colour(centres) if colour else brush.gray(centres)
    profile = extract(picture, ExtractionSettings(channel=channel, noise=NoiseModel(NOISE_DN)), bands=brush.halves())
    assert profile.found.mean() > 0.95
    assert np.nanmedian(np.abs(profile.centre_px - centres)) < 0.1


def test_pictures_of_one_brush_differ_in_their_noise_only() -> None:
    brush = Brush(320, 180, np.random.default_rng(6))
    first, second = (brush.gray(brush.waves()).astype(np.float64) for _ in range(2))
    assert np.std(first - second) == pytest.approx(np.sqrt(2) * np.hypot(NOISE_DN, np.sqrt(1 / 12)), rel=0.05)


def test_a_stripe_that_leaves_the_picture_is_cut_off_and_not_piled_up_at_its_border() -> None:
    brush = Brush(64, 48, np.random.default_rng(7))
    outside = np.stack([np.full(64, 60.0), np.full(64, -12.0)])
    assert brush.gray(outside).max() < 60
