"""Stripes sorted into clean and stray, bed and objects, before anything is known of the laser."""

import numpy as np
import pytest

from twinline.arrays import BoolArray, FloatArray
from twinline.calibration.bed_line import bed_groups, find_bed_line
from twinline.calibration.observations import TofReadings, clean_stripes, median_of_repeats, stripe_points
from twinline.geometry.sheet import Side

FRAMES, LANES = 120, 640
CARTS = np.linspace(0.0, 119.0, FRAMES)


def scene(side: Side, *, drift_px: float = 0.0, seed: int = 1) -> tuple[FloatArray, BoolArray]:
    """Stripe centres over a bowed bed line with two objects; and which of them lie on the objects."""
    rng = np.random.default_rng(seed)
    up = 1.0 if side[0] == "+" else -1.0
    lane = np.arange(LANES)
    bed = 440.0 - 0.01 * lane + 2e-5 * (lane - 300) ** 2
    height = np.zeros((FRAMES, LANES))
    height[30:80, 100:220] = 40.0
    # This one hides the bed in all but a few frames.
    height[8:112, 400:480] = 25.0
    centre = bed[None, :] + drift_px * (CARTS / 119.0)[:, None] + up * height + rng.normal(0, 0.1, height.shape)
    return centre.astype(np.float32), height > 0


@pytest.mark.parametrize("side", ["+v", "-v"])
@pytest.mark.parametrize("drift_px", [0.0, 4.0])
def test_the_bed_is_told_from_objects(side: Side, drift_px: float) -> None:
    centre, raised = scene(side, drift_px=drift_px)
    line = find_bed_line(centre, CARTS, side)
    assert line is not None
    assert not line.on_bed[raised].any()
    assert line.on_bed[~raised].mean() > 0.98


def test_a_tenth_of_scattered_stripes_leaves_the_bed_where_it_is() -> None:
    centre, raised = scene("+v")
    rng = np.random.default_rng(2)
    wrong = rng.random(centre.shape) < 0.1
    centre[wrong] = rng.uniform(300, 600, int(wrong.sum()))
    clean, share = clean_stripes(centre)
    assert share == pytest.approx(0.1, abs=0.02)
    assert clean[wrong].mean() < 0.03
    line = find_bed_line(np.where(clean, centre, np.nan), CARTS, "+v")
    assert line is not None
    assert line.on_bed[~raised & ~wrong].mean() > 0.5
    assert not line.on_bed[raised & ~wrong].any()


def test_stripes_beside_a_step_are_left_out() -> None:
    centre, raised = scene("+v")
    clean, _ = clean_stripes(centre)
    edge = np.zeros_like(raised)
    edge[:, 1:] = raised[:, 1:] != raised[:, :-1]
    edge[1:] |= raised[1:] != raised[:-1]
    # The median rounds the corners off.
    assert clean[edge].mean() < 0.02
    assert clean[~edge].mean() > 0.9


def test_an_empty_picture_has_no_bed() -> None:
    centre = np.full((10, LANES), np.nan, np.float32)
    assert find_bed_line(centre, CARTS[:10], "+v") is None
    clean, share = clean_stripes(centre)
    assert not clean.any()
    assert share == 0.0


def test_groups_of_the_bed_hold_the_mean_of_their_stripes() -> None:
    centre, raised = scene("+v")
    points = stripe_points(centre, np.full_like(centre, 0.1), CARTS, ~raised, along_u=True)
    groups = bed_groups(points, points.pixels[:, 0], LANES)
    assert 50 <= len(groups) <= 72
    assert groups.pixels[:, 0].mean() == pytest.approx(LANES / 2, abs=15)
    assert (groups.sd_px < 0.01).all()
    lane = groups.pixels[:, 0]
    expected = 440.0 - 0.01 * lane + 2e-5 * (lane - 300) ** 2
    np.testing.assert_allclose(groups.pixels[:, 1], expected, atol=0.03)


class TestMedianOfRepeats:
    def readings(self, values: list[list[float]]) -> TofReadings:
        """Stays at slide 0, 1, 2, ... of the sensor."""
        slide = np.concatenate([np.full(len(stay), float(k)) for k, stay in enumerate(values)])
        reading = np.concatenate([np.array(stay) for stay in values])
        return TofReadings(0.1 * np.arange(len(reading)), np.full(len(reading), 7.0), slide, reading)

    def test_a_stay_becomes_the_median_of_its_valid_readings(self) -> None:
        nan = float("nan")
        found = median_of_repeats(self.readings([[43.0, 231.0, 230.0], [nan, 229.0, nan], [nan, nan, nan]]))
        np.testing.assert_array_equal(found.reading, [230.0, 229.0, nan])
        np.testing.assert_array_equal(found.slide_mm, [0.0, 1.0, 2.0])
        np.testing.assert_array_equal(found.cart_mm, [7.0, 7.0, 7.0])
        np.testing.assert_allclose(found.time_s, [0.1, 0.4, 0.7])

    def test_coming_back_to_a_place_is_another_stay(self) -> None:
        readings = self.readings([[1.0] * 3, [2.0] * 3])
        there_and_back = TofReadings(
            np.arange(9.0),
            np.zeros(9),
            np.repeat([0.0, 1.0, 0.0], 3),
            np.concatenate([readings.reading, np.full(3, 5.0)]),
        )
        np.testing.assert_array_equal(median_of_repeats(there_and_back).reading, [1.0, 2.0, 5.0])

    def test_readings_in_motion_stay_as_they_are(self) -> None:
        moving = self.readings([[1.0], [2.0], [3.0, 3.1], [4.0]])
        assert median_of_repeats(moving) is moving
        empty = self.readings([[1.0]])
        assert len(median_of_repeats(empty)) == 1
