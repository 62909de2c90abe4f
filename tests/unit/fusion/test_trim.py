"""Bed, strays, crop and thinning."""

import numpy as np
import pytest

from tests.unit.fusion.scenes import cloud_of, laser_cloud, step
from twinline.errors import InputError
from twinline.fusion.cloud import PointCloud, Source
from twinline.fusion.trim import Box, bed_plane, crop, strays, thinned, without_bed


def tilted_step() -> PointCloud:
    return laser_cloud(lambda x, y: step(x, y) + 0.3 + 0.01 * x - 0.02 * y, Source.LASER_1)


def test_a_tilted_bed_is_found_and_taken_away_and_the_object_stays() -> None:
    cloud = tilted_step()
    assert (np.abs(bed_plane(cloud) - [0.3, 0.01, -0.02]) < [0.02, 0.002, 0.002]).all()
    left = without_bed(cloud)
    inside = np.abs(cloud.points_mm[:, 1]) < 8.0
    assert len(left) == inside.sum()
    assert (np.abs(left.points_mm[:, 1]) < 8.0).all()


def test_without_a_bed_it_is_said_that_there_is_none() -> None:
    high = cloud_of(np.random.default_rng(1).uniform(20.0, 30.0, (500, 3)), 1)
    with pytest.raises(InputError, match="Only 0 points lie within 3 mm of the bed"):
        without_bed(high)


def test_strays_are_found_and_the_surface_and_its_edges_are_not() -> None:
    cloud = laser_cloud(step, Source.LASER_1)
    points = cloud.points_mm.copy()
    rng = np.random.default_rng(2)
    wild = rng.choice(np.flatnonzero((np.abs(points[:, :2]) < 13.0).all(axis=1)), 20, replace=False)
    points[wild, 2] += rng.choice([-1.0, 1.0], 20) * rng.uniform(1.8, 4.5, 20)
    lone = np.array([[40.0, 40.0, 5.0]], np.float32)
    spoilt = cloud_of(np.concatenate([points, lone]), 1)
    found = strays(spoilt)
    away = np.ones(len(spoilt), bool)
    away[:-1] = np.abs(np.abs(points[:, 1]) - 8.0) > 1.6
    rows = np.append(wild, len(points))
    assert found[rows[away[rows]]].all()
    good = np.setdiff1d(np.arange(len(spoilt)), rows)
    assert found[good].mean() < 0.01
    assert strays(PointCloud.empty()).shape == (0,)


def test_a_box_keeps_what_lies_in_it() -> None:
    cloud = laser_cloud(step, Source.LASER_1)
    kept = crop(cloud, Box((None, -8.0, 5.0), (0.0, 8.0, None)))
    points = cloud.points_mm
    wanted = (points[:, 0] <= 0) & (np.abs(points[:, 1]) <= 8) & (points[:, 2] >= 5)
    np.testing.assert_array_equal(kept.points_mm, points[wanted])
    with pytest.raises(InputError, match="ends at y = -3 mm, before it begins at 2 mm"):
        Box((None, 2.0, None), (None, -3.0, None))


def test_thinning_leaves_the_best_point_of_each_cube() -> None:
    rng = np.random.default_rng(5)
    cloud = cloud_of(rng.uniform(0.0, 20.0, (20_000, 3)), 1)
    sigma = rng.uniform(0.02, 0.2, len(cloud)).astype(np.float32)
    cloud = PointCloud(cloud.points_mm, sigma, cloud.intensity, cloud.colour, cloud.source)
    thin = thinned(cloud, 2.0)
    assert len(thin) == 1000
    assert float(np.median(thin.sigma_mm)) < 0.04
    rows = {tuple(p) for p in cloud.points_mm.tolist()}
    assert {tuple(p) for p in thin.points_mm.tolist()} <= rows
    assert len(thinned(thin, 0.001)) == len(thin)
    with pytest.raises(InputError, match="larger than 0"):
        thinned(cloud, 0.0)
