"""Stripes sorted into clean and stray, bed and objects, before anything is known of the laser."""

import numpy as np
import pytest

from twinline.arrays import BoolArray, FloatArray
from twinline.calibration.bed_line import bed_groups, find_bed_line
from twinline.calibration.observations import clean_stripes, stripe_points
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
