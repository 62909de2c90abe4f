"""Small gaps are closed, large ones and edges are not."""

import numpy as np
from scipy.spatial import cKDTree

from tests.unit.fusion.scenes import cloud_of, flat, laser_cloud, step
from twinline.fusion.cloud import PointCloud, Source
from twinline.fusion.fill import filled_gaps


def test_lines_that_lie_far_apart_are_joined_so_that_no_place_is_far_from_a_point() -> None:
    cloud = laser_cloud(flat, Source.LASER_1, pitch_mm=1.5, sigma_mm=0.03)
    filled = filled_gaps(cloud, (1.53, 0.9))
    assert (filled.source == Source.FILLED).all()
    assert np.abs(filled.points_mm[:, 2]).max() < 0.12
    assert (filled.colour == 90).all()
    x, y = (g.ravel() for g in np.meshgrid(np.arange(-12.0, 12.0, 0.2), np.arange(-12.0, 12.0, 0.2)))
    gap = np.asarray(
        cKDTree(PointCloud.concatenate([cloud, filled]).points_mm).query(np.column_stack([x, y, 0 * x]))[0]
    )
    assert gap.max() < 0.6
    assert np.mean(gap < 0.5) > 0.99
    assert filled.sigma_mm.min() >= np.float32(0.03)


def test_a_wide_gap_stays_open() -> None:
    cloud = laser_cloud(flat, Source.LASER_1)
    gap = np.hypot(cloud.points_mm[:, 0], cloud.points_mm[:, 1]) < 5.0
    filled = filled_gaps(cloud.select(~gap), (1.02, 1.02))
    assert not (np.hypot(filled.points_mm[:, 0], filled.points_mm[:, 1]) < 4.3).any()


def test_no_point_hangs_on_a_step() -> None:
    cloud = laser_cloud(step, Source.LASER_1, pitch_mm=1.5)
    filled = filled_gaps(cloud, (1.53, 0.9))
    off = np.minimum(np.abs(filled.points_mm[:, 2]), np.abs(filled.points_mm[:, 2] - 10.0))
    assert off.max() < 0.3
    assert len(filled) > 200


def test_a_steep_flank_is_filled_along_the_flank() -> None:
    cloud = laser_cloud(lambda x, y: 2.0 * x + 0.0 * y, Source.LASER_1)
    filled = filled_gaps(cloud, (1.02, 0.9))
    points = filled.points_mm
    assert np.abs(points[:, 2] - 2.0 * points[:, 0]).max() < 0.3
    x, y = (g.ravel() for g in np.meshgrid(np.arange(-8.0, 8.0, 0.3), np.arange(-8.0, 8.0, 0.3)))
    gap = np.asarray(
        cKDTree(PointCloud.concatenate([cloud, filled]).points_mm).query(np.column_stack([x, y, 2.0 * x]))[0]
    )
    assert np.mean(gap < 0.5) > 0.97


def test_nothing_comes_of_nothing() -> None:
    assert len(filled_gaps(PointCloud.empty(), (1.0, 1.0))) == 0
    assert len(filled_gaps(cloud_of(np.zeros((3, 3)), Source.TOF), (1.0, 1.0))) == 0
