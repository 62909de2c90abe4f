"""The usual width of a stripe, from the mean profile of a sample of its columns."""

import numpy as np
import pytest

from twinline.stripe.light import take_light
from twinline.stripe.width import SAMPLED_COLUMNS, sample_places, usual_width


@pytest.mark.parametrize("count", [1, 2, SAMPLED_COLUMNS - 1, SAMPLED_COLUMNS, SAMPLED_COLUMNS + 1, 1280])
def test_the_sample_is_spread_over_all_columns_without_repeats(count: int) -> None:
    places = sample_places(count)
    assert len(places) == min(count, SAMPLED_COLUMNS)
    assert places[-1] == count - 1
    assert places[0] == (0 if count > 1 else count - 1)
    assert (np.diff(places) > 0).all()


@pytest.mark.parametrize("width_px", [1.5, 3.0, 6.0])
@pytest.mark.parametrize("slope_dn", [0.0, 0.4])
@pytest.mark.parametrize("channel", ["gray", "red-blue"])
def test_the_width_is_that_of_the_stripe_to_a_pixel_of_its_half_height(
    width_px: float, slope_dn: float, channel: str
) -> None:
    rng = np.random.default_rng(8)
    rows = np.arange(160)[:, None]
    stripe = 120.0 * np.exp(-0.5 * ((rows - 80.2) / width_px) ** 2) * np.ones(200)
    room = 30.0 + slope_dn * rows
    picture = stripe + room + rng.normal(0, 1.5, stripe.shape)
    if channel == "red-blue":
        picture = np.stack([room + rng.normal(0, 1.5, stripe.shape), picture, picture], axis=-1)
    light = take_light(np.clip(np.rint(picture), 0, 255).astype(np.uint8), channel, along_v=False)  # type: ignore[arg-type]
    columns = np.arange(200, dtype=np.int32)
    assert usual_width(light, columns, np.full(200, 80, np.int32)) == pytest.approx(width_px, abs=1.2 / 2.355)


def test_a_picture_without_light_gives_a_usual_width() -> None:
    light = take_light(np.full((120, 20), 9, np.uint8), "gray", along_v=False)
    assert usual_width(light, np.arange(20, dtype=np.int32), np.full(20, 60, np.int32)) == 2.0
