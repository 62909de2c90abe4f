"""Two lasers and a ToF sensor become one cloud."""

from typing import Any

import numpy as np
import pytest

from tests.unit.fusion.scenes import Surface, cloud_of, flat, laser_cloud, ripples, step
from twinline.arrays import FloatArray
from twinline.fusion.cloud import PointCloud, Source
from twinline.fusion.fuse import Fused, Fusion, FusionSettings, fuse

SETTINGS = FusionSettings((1.02, 0.55), (1.53, 0.6))
NONE = PointCloud.empty()


def both(surface: Surface, **options: Any) -> PointCloud:
    """Points of both lasers, their frames interleaved by half a pitch."""
    first = laser_cloud(surface, Source.LASER_1, **options)
    second = laser_cloud(surface, Source.LASER_2, start_mm=0.5, seed=8, **options)
    return PointCloud.concatenate([first, second])


def inner(fused: Fused | PointCloud, half_mm: float = 13.0) -> PointCloud:
    cloud = fused.cloud if isinstance(fused, Fused) else fused
    return cloud.select(np.asarray((np.abs(cloud.points_mm[:, :2]) < half_mm).all(axis=1)))


def tof_cloud(surface: Surface, half_mm: float = 15.0) -> PointCloud:
    x, y = np.meshgrid(np.arange(-half_mm, half_mm, 1.5), np.arange(-half_mm, half_mm, 0.2), indexing="ij")
    return cloud_of(np.column_stack([x.ravel(), y.ravel(), surface(x, y).ravel()]), Source.TOF, 0.015, 0.0)


def test_two_lasers_together_are_better_than_each_alone_and_say_by_how_much() -> None:
    fused = fuse(both(flat), NONE, SETTINGS)
    cloud = inner(fused)
    assert (cloud.source == Source.BOTH_LASERS).mean() > 0.99
    error = float(cloud.points_mm[:, 2].std())
    # 0.05 mm each: together 0.035, and a little less for the neighbours that the other laser's height comes from.
    assert 0.015 < error < 0.034
    assert float(np.median(cloud.sigma_mm)) == pytest.approx(error, rel=0.2)
    assert fused.agreement.systematic_mm < 0.012
    assert abs(fused.agreement.offset_mm) < 0.005


def test_nothing_is_resampled() -> None:
    given = both(flat)
    fused = fuse(given, NONE, SETTINGS)
    places = {tuple(place) for place in given.points_mm[:, :2].tolist()}
    assert len(fused.cloud) > 0.998 * len(given)
    assert {tuple(place) for place in fused.cloud.points_mm[:, :2].tolist()} <= places


def test_a_texture_that_moves_the_lasers_apart_cancels_and_is_told() -> None:
    def texture(x: FloatArray, y: FloatArray) -> FloatArray:
        return np.asarray(0.15 * np.sin(2.0 * np.pi * x / 12.0) * np.cos(2.0 * np.pi * y / 9.0))

    def against(x: FloatArray, y: FloatArray) -> FloatArray:
        return -texture(x, y)

    given = PointCloud.concatenate(
        [
            laser_cloud(texture, Source.LASER_1, sigma_mm=0.02),
            laser_cloud(against, Source.LASER_2, sigma_mm=0.02, start_mm=0.5),
        ]
    )
    fused = fuse(given, NONE, SETTINGS)
    cloud = inner(fused)
    # A product of two sines with amplitude 0.15.
    assert 0.03 < fused.agreement.systematic_mm < 0.13
    before, after = (float(np.sqrt(np.mean(c.points_mm[:, 2] ** 2))) for c in (inner(given), cloud))
    assert after < 0.4 * before


def test_steps_stay_as_sharp_as_they_were_measured() -> None:
    cloud = inner(fuse(both(step), NONE, SETTINGS))
    beside = np.abs(np.abs(cloud.points_mm[:, 1]) - 8.0) < 1.0
    heights = cloud.points_mm[beside, 2]
    assert (np.minimum(np.abs(heights), np.abs(heights - 10.0)) < 0.3).all()
    upper = cloud.points_mm[cloud.points_mm[:, 2] > 5.0]
    assert np.abs(upper[:, 1]).max() < 8.0
    # Points at the edge stay, by themselves.
    assert np.abs(upper[:, 1]).max() > 7.5


def test_ripples_keep_four_fifths_of_their_amplitude() -> None:
    cloud = inner(fuse(both(ripples, sigma_mm=0.02, pitch_mm=0.5), NONE, FusionSettings((0.51, 0.55))))
    wave = np.sin(2.0 * np.pi * cloud.points_mm[:, 0] / 3.0)
    amplitude = float(cloud.points_mm[:, 2] @ wave / (wave @ wave))
    assert amplitude > 0.8 * 0.2


def test_a_ghost_of_one_laser_is_left_out_with_its_reason() -> None:
    given = both(flat)
    points, sigma = given.points_mm.copy(), given.sigma_mm.copy()
    ghost = (given.source == Source.LASER_1) & (np.hypot(points[:, 0] - 3.0, points[:, 1]) < 2.0)
    points[ghost, 2] += np.random.default_rng(4).uniform(2.0, 5.0, ghost.sum())
    sigma[ghost] = 0.3
    spoilt = PointCloud(points, sigma, given.intensity, given.colour, given.source)
    fused = fuse(spoilt, NONE, SETTINGS)
    assert np.abs(fused.cloud.points_mm[:, 2]).max() < 0.5
    assert fused.counts["interreflection"] == ghost.sum()
    saturated = PointCloud(points, sigma, np.where(ghost, 260.0, 100.0).astype(np.float32), given.colour, given.source)
    assert fuse(saturated, NONE, SETTINGS).counts["gloss"] == ghost.sum()


def lifted(given: PointCloud) -> tuple[PointCloud, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
    """Laser 1 sees a patch 3 mm too high, as steadily as laser 2 sees it in its place."""
    points = given.points_mm.copy()
    patch = (given.source == Source.LASER_1) & (np.abs(points[:, :2]) < 4.0).all(axis=1)
    points[patch, 2] += 3.0
    return PointCloud(points, given.sigma_mm, given.intensity, given.colour, given.source), patch


def test_lasers_that_contradict_each_other_steadily_are_both_left_out() -> None:
    spoilt, _ = lifted(both(flat))
    fused = fuse(spoilt, NONE, SETTINGS)
    middle = (np.abs(fused.cloud.points_mm[:, :2]) < 2.5).all(axis=1)
    assert not middle.any()
    assert fused.counts["lasers contradict each other"] > 100


def test_the_tof_sensor_tells_which_laser_is_right() -> None:
    spoilt, patch = lifted(both(flat))
    fused = fuse(spoilt, tof_cloud(flat), SETTINGS)
    middle = (np.abs(fused.cloud.points_mm[:, :2]) < 2.5).all(axis=1)
    assert middle.sum() > 30
    assert np.abs(fused.cloud.points_mm[middle, 2]).max() < 0.3
    assert fused.counts["interreflection"] > 0.6 * patch.sum()
    assert "lasers contradict each other" not in fused.counts


def test_tof_fills_what_the_lasers_leave_and_only_that() -> None:
    given = both(flat)
    shadow = (np.abs(given.points_mm[:, :2]) < 5.0).all(axis=1)
    fused = fuse(given.select(np.logical_not(shadow)), tof_cloud(flat), SETTINGS)
    tof = fused.cloud.select(fused.cloud.source == Source.TOF)
    assert len(tof) > 200
    assert (np.abs(tof.points_mm[:, :2]) < 5.5).all(axis=1).mean() > 0.98
    assert (tof.colour == 90).all()


def test_lasers_far_apart_are_not_fused_and_nothing_is_lost() -> None:
    given = both(flat)
    points = given.points_mm.copy()
    points[given.source == Source.LASER_1, 2] += 2.0
    fused = fuse(PointCloud(points, given.sigma_mm, given.intensity, given.colour, given.source), NONE, SETTINGS)
    assert len(fused.cloud) == len(given)
    assert set(np.unique(fused.cloud.source)) == {1, 2}
    assert "2.00 mm apart" in fused.warnings[0]


def test_a_tof_sensor_far_off_is_left_out_and_said() -> None:
    fused = fuse(both(flat), tof_cloud(lambda x, y: flat(x, y) + 1.5), SETTINGS)
    assert not (fused.cloud.source == Source.TOF).any()
    assert "+1.50 mm from the lasers" in fused.warnings[0]
    assert np.abs(inner(fused).points_mm[:, 2]).max() < 0.3


def test_frame_by_frame_ends_in_the_same_bits_as_all_at_once() -> None:
    given = both(step)
    order = np.argsort(given.points_mm[:, 0], kind="stable")
    given = given.select(order)
    tof = tof_cloud(step)
    at_once = fuse(given, tof, SETTINGS).cloud
    stream = Fusion(SETTINGS)
    for place, share in enumerate(np.array_split(np.arange(len(given)), 37)):
        stream.add(given.select(share))
        if place == 20:
            early = stream.result()
            assert 0 < len(early.cloud) < len(given)
    stream.add_tof(tof)
    for name in ("points_mm", "sigma_mm", "source", "colour", "intensity"):
        np.testing.assert_array_equal(getattr(stream.result().cloud, name), getattr(at_once, name))


@pytest.mark.parametrize("case", ["nothing", "one laser", "tof alone", "all NaN"])
def test_less_than_two_lasers_is_no_difficulty(case: str) -> None:
    lasers, tof = NONE, NONE
    if case == "one laser":
        lasers = laser_cloud(flat, Source.LASER_2)
    if case == "tof alone":
        tof = tof_cloud(flat)
    if case == "all NaN":
        lasers = cloud_of(np.full((5, 3), np.nan), Source.LASER_1)
    fused = fuse(lasers, tof, SETTINGS)
    assert len(fused.cloud) == (0 if case == "all NaN" else len(lasers) + len(tof))
    assert not fused.warnings
