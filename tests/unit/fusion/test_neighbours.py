"""Surfaces around places, and the nearest point."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from twinline.fusion.neighbours import PointGrid

RNG = np.random.default_rng(20260110)


def test_a_plane_is_found_exactly_whatever_the_points_and_weights() -> None:
    xy = RNG.uniform(-10.0, 10.0, (4000, 2))
    points = np.column_stack([xy, 2.0 + 0.7 * xy[:, 0] - 0.3 * xy[:, 1]])
    places = RNG.uniform(-8.0, 8.0, (300, 2))
    surface = PointGrid(points, RNG.uniform(0.02, 0.2, 4000), 1.0).surface(places, (1.3, 0.9))
    np.testing.assert_allclose(surface.height_mm, 2.0 + 0.7 * places[:, 0] - 0.3 * places[:, 1], atol=1e-9)
    np.testing.assert_allclose(surface.slope_x, 0.7, atol=1e-8)
    np.testing.assert_allclose(surface.slope_y, -0.3, atol=1e-8)
    assert float(surface.misfit.max()) < 1e-9


def test_the_reported_variance_is_the_real_one() -> None:
    x, y = (g.ravel() for g in np.meshgrid(np.arange(-20.0, 20.0, 0.5), np.arange(-20.0, 20.0, 0.4)))
    points = np.column_stack([x, y, RNG.normal(0.0, 0.1, len(x))])
    places = np.stack(np.meshgrid(np.arange(-18.0, 18.0, 2.5), np.arange(-18.0, 18.0, 2.5)), axis=-1).reshape(-1, 2)
    surface = PointGrid(points, np.full(len(x), 0.1), 1.0).surface(places, (1.0, 1.0))
    assert float(np.std(surface.height_mm)) == pytest.approx(float(np.sqrt(np.mean(surface.variance_mm2))), rel=0.2)
    assert float(np.mean(surface.misfit)) == pytest.approx(1.0, rel=0.3)


def test_beyond_the_points_there_is_no_surface_and_at_their_end_it_leans() -> None:
    x, y = (g.ravel() for g in np.meshgrid(np.arange(0.0, 10.0, 0.4), np.arange(0.0, 10.0, 0.4)))
    grid = PointGrid(np.column_stack([x, y, 0 * x]), np.full(len(x), 0.1), 1.0)
    surface = grid.surface(np.array([[5.0, 5.0], [9.9, 5.0], [30.0, 5.0], [-30.0, -30.0], [np.nan, 1.0]]), (1.0, 1.0))
    assert surface.lean[0] < 0.2
    assert surface.lean[1] > 0.4
    assert not np.isfinite(surface.height_mm[2:]).any()


def test_the_nearest_point_is_the_nearest() -> None:
    points = RNG.uniform(-10.0, 10.0, (3000, 3))
    points[7] = np.nan
    wanted = RNG.uniform(-12.0, 12.0, (500, 3))
    gap, row = PointGrid(points, np.full(3000, 0.1), 0.7).nearest(wanted, 1.0)
    good = np.delete(np.arange(3000), 7)
    right, place = (np.asarray(found) for found in cKDTree(points[good]).query(wanted, distance_upper_bound=1.0))
    np.testing.assert_allclose(gap, right, atol=1e-12)
    found = np.isfinite(gap)
    assert 100 < found.sum() < 500
    np.testing.assert_array_equal(row[found], good[place[found]])
    assert (row[~found] == -1).all()


def test_no_points_and_one_stray_point_far_away_ask_for_no_memory() -> None:
    empty = PointGrid(np.empty((0, 3)), np.empty(0), 1.0)
    assert len(empty) == 0
    assert not np.isfinite(empty.nearest(np.zeros((2, 3)), 1.0)[0]).any()
    far = PointGrid(np.array([[0.0, 0.0, 0.0], [1e7, 1e7, 0.0]]), np.full(2, 0.1), 0.5)
    assert far.nearest(np.array([[1e7, 1e7, 0.1]]), 0.5)[1][0] == 1
