"""The edge filter: what it drops, what it keeps, and that a stream gives what the whole pass gives."""

import weakref
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from twinline.fusion.cloud import PointCloud, Source
from twinline.fusion.edges import (
    LEAST_JUMP_PX,
    MOST_REACH_FRAMES,
    PARTIAL_SHARE,
    SPOT_COLUMNS,
    EdgeFilter,
    EdgeLimits,
    FramePoints,
)

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

LIMITS = EdgeLimits(reach=2, jump_px=1.5)
COLUMNS = 12


def frame(place: int, centre: Floats, amplitude: Floats, lit: Sequence[bool] = (True,)) -> FramePoints:
    """A frame whose points tell where they come from: x is the frame, y the column, z the laser."""
    laser, column = np.nonzero(np.isfinite(centre) & np.array(lit)[:, None])
    n = len(laser)
    points = np.column_stack([np.full(n, place), column, laser]).astype(np.float32)
    cloud = PointCloud(
        points,
        np.ones(n, np.float32),
        amplitude[laser, column].astype(np.float32),
        np.zeros((n, 3), np.uint8),
        np.full(n, Source.LASER_1, np.uint8),
    )
    return FramePoints(
        cloud, laser, column, centre.astype(np.float32), amplitude.astype(np.float32), np.array(lit, bool)
    )


def filtered(frames: Sequence[FramePoints], limits: EdgeLimits = LIMITS, lasers: int = 1) -> tuple[Floats, int]:
    """Points left of a whole pass, and how many were dropped."""
    edges = EdgeFilter(limits, lasers)
    clouds = [cloud for f in frames for cloud in edges.add(f)] + edges.finish()
    return PointCloud.concatenate(clouds).points_mm.astype(float), edges.rejected


def plain(count: int, centre: float = 50.0, amplitude: float = 100.0) -> tuple[Floats, Floats]:
    """A flat surface: centres and amplitudes, (frames, columns)."""
    return np.full((count, COLUMNS), centre), np.full((count, COLUMNS), amplitude)


def single(centre: Floats, amplitude: Floats) -> list[FramePoints]:
    return [frame(i, c[None], a[None]) for i, (c, a) in enumerate(zip(centre, amplitude, strict=True))]


def kept_map(centre: Floats, amplitude: Floats, limits: EdgeLimits = LIMITS) -> Bools:
    """Which points of a one-laser pass are kept, (frames, columns)."""
    points, rejected = filtered(single(centre, amplitude), limits)
    kept = np.zeros(centre.shape, bool)
    kept[points[:, 0].astype(int), points[:, 1].astype(int)] = True
    assert rejected == int(np.isfinite(centre).sum() - kept.sum())
    return kept


def expected(centre: Floats, amplitude: Floats, limits: EdgeLimits) -> Bools:
    """The rule for a whole pass at once, point by point: the yardstick of the streaming filter."""
    frames = len(centre)
    kept = np.isfinite(centre)
    for i, k in np.argwhere(kept):
        near = amplitude[
            max(i - limits.reach, 0) : i + limits.reach + 1, max(k - SPOT_COLUMNS, 0) : k + SPOT_COLUMNS + 1
        ]
        kept[i, k] = amplitude[i, k] >= np.float32(PARTIAL_SHARE) * np.nanmax(near)
        if limits.reach:
            for j in (i - 1, i + 1):
                if 0 <= j < frames and not abs(centre[j, k] - centre[i, k]) <= limits.jump_px:
                    kept[i, k] = False
    return kept


def random_pass(seed: int, frames: int) -> tuple[Floats, Floats]:
    """Slopes, steps, gaps and dark patches."""
    rng = np.random.default_rng(seed)
    centre = np.cumsum(rng.choice([0.0, 0.5, 1.0, 6.0], (frames, COLUMNS), p=[0.5, 0.3, 0.1, 0.1]), axis=0)
    amplitude = np.round(rng.choice([40.0, 59.0, 61.0, 100.0], (frames, COLUMNS), p=[0.1, 0.1, 0.2, 0.6]))
    gone = rng.random((frames, COLUMNS)) < 0.1
    return np.where(gone, np.nan, centre), np.where(gone, np.nan, amplitude)


@given(seed=st.integers(0, 10_000), frames=st.integers(1, 12), reach=st.integers(0, 4))
def test_a_stream_of_frames_gives_what_the_whole_pass_gives(seed: int, frames: int, reach: int) -> None:
    centre, amplitude = random_pass(seed, frames)
    limits = EdgeLimits(reach, 1.5)
    np.testing.assert_array_equal(kept_map(centre, amplitude, limits), expected(centre, amplitude, limits))


def test_a_frame_comes_out_as_soon_as_its_neighbours_are_known_and_in_order() -> None:
    edges = EdgeFilter(LIMITS, 1)
    out: list[int] = []
    for i, f in enumerate(single(*plain(9))):
        out += [int(cloud.points_mm[0, 0]) for cloud in edges.add(f)]
        assert out == list(range(max(i + 1 - LIMITS.reach, 0)))
    out += [int(cloud.points_mm[0, 0]) for cloud in edges.finish()]
    assert out == list(range(9))


def test_a_flat_surface_keeps_every_point_to_its_last_frame() -> None:
    assert kept_map(*plain(7)).all()


@pytest.mark.parametrize("per_frame_px", [-1.4, -0.3, 0.9, 1.4])
def test_a_smooth_slope_is_kept(per_frame_px: float) -> None:
    centre, amplitude = plain(8)
    assert kept_map(centre + per_frame_px * np.arange(8)[:, None], amplitude).all()


def test_both_sides_of_a_step_are_dropped_and_the_rest_is_kept() -> None:
    centre, amplitude = plain(8)
    centre[4:] += 5.0
    kept = kept_map(centre, amplitude)
    assert not kept[3:5].any()
    assert kept[[0, 1, 2, 5, 6, 7]].all()


def test_a_step_in_some_columns_leaves_the_others_alone() -> None:
    centre, amplitude = plain(8)
    centre[4:, :5] += 5.0
    kept = kept_map(centre, amplitude)
    assert not kept[3:5, :5].any()
    assert kept[:, 5:].all()


def test_points_beside_the_end_of_a_stripe_are_dropped() -> None:
    centre, amplitude = plain(8)
    centre[4], amplitude[4] = np.nan, np.nan
    kept = kept_map(centre, amplitude)
    assert not kept[[3, 5]].any()
    assert kept[[0, 1, 2, 6, 7]].all()


def test_a_dim_spot_beside_a_bright_one_is_dropped_as_far_as_spots_reach() -> None:
    centre, amplitude = plain(9)
    amplitude[4, 6] = 200.0
    kept = kept_map(centre, amplitude)
    dropped = ~kept
    assert dropped[2:7, 4:9].sum() == 24
    assert dropped.sum() == 24
    assert kept[4, 6]


def test_a_moderately_dimmer_spot_is_kept() -> None:
    centre, amplitude = plain(9)
    amplitude[4] = 100.0 / PARTIAL_SHARE - 1.0
    assert kept_map(centre, amplitude).all()


def test_the_first_and_the_last_frame_are_judged_by_the_one_neighbour_they_have() -> None:
    centre, amplitude = plain(6)
    centre[0] += 5.0
    centre[5, :3] -= 5.0
    kept = kept_map(centre, amplitude)
    assert not kept[:2].any()
    assert not kept[4:, :3].any()
    assert kept[2:, 3:].all()


def test_a_pass_of_one_frame_is_kept_and_an_empty_pass_gives_nothing() -> None:
    assert kept_map(*plain(1)).all()
    points, rejected = filtered([])
    assert (len(points), rejected) == (0, 0)


def test_alternating_lasers_are_judged_by_their_own_frames() -> None:
    # Laser 1 steps between its third and fourth frame, laser 2 never; each sees only every other frame.
    frames = []
    for i in range(12):
        lit = (i % 2 == 0, i % 2 == 1)
        centre = np.array([np.full(COLUMNS, 50.0 + 9.0 * (i >= 6)), np.full(COLUMNS, 20.0)])
        amplitude = np.array([np.full(COLUMNS, 100.0), np.full(COLUMNS, 30.0)])
        frames.append(frame(i, centre, amplitude, lit))
    points, rejected = filtered(frames, lasers=2)
    first, second = (set(points[points[:, 2] == laser, 0].astype(int)) for laser in (0, 1))
    assert first == {0, 2, 8, 10}
    assert second == {1, 3, 5, 7, 9, 11}
    assert rejected == 2 * COLUMNS


def test_a_frame_with_both_lasers_off_passes_without_points() -> None:
    frames = single(*plain(5))
    centre, amplitude = plain(1)
    dark = frame(2, centre, amplitude, lit=(False,))
    points, rejected = filtered([*frames[:2], dark, *frames[3:]])
    assert set(points[:, 0].astype(int)) == {0, 1, 3, 4}
    assert rejected == 0


def test_frames_are_forgotten_once_nobody_needs_them() -> None:
    edges = EdgeFilter(LIMITS, 1)
    alive = []
    for i in range(60):
        centre, amplitude = plain(1)
        fresh = frame(i, centre, amplitude)
        alive.append(weakref.ref(fresh))
        edges.add(fresh)
        del fresh
        assert sum(ref() is not None for ref in alive) <= LIMITS.reach + 1


class TestLimits:
    def test_the_reach_is_how_many_frames_two_spots_of_two_deviations_overlap(self) -> None:
        limits = EdgeLimits.for_scan(pitch_mm=0.2, spot_sd_mm=0.8, px_per_mm_height=2.0)
        assert limits.reach == 8
        assert limits.jump_px == pytest.approx(LEAST_JUMP_PX + 2.2 * 0.2 * 2.0)

    def test_frames_further_apart_than_spots_are_wide_tell_nothing_of_each_other(self) -> None:
        limits = EdgeLimits.for_scan(pitch_mm=1.0, spot_sd_mm=0.19, px_per_mm_height=5.0)
        assert limits.reach == 0
        centre, amplitude = plain(8)
        centre[4:] += 30.0
        assert kept_map(centre, amplitude, limits).all()

    def test_a_cart_that_stands_still_does_not_look_for_ever(self) -> None:
        limits = EdgeLimits.for_scan(pitch_mm=0.0, spot_sd_mm=0.8, px_per_mm_height=2.0)
        assert limits == EdgeLimits(MOST_REACH_FRAMES, LEAST_JUMP_PX)
