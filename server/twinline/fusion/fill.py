"""Small gaps closed where the points around them leave no doubt of the surface: between the lines of the ToF raster.

A filled point is no measurement and says so by its source. It stands only where measured points lie on all sides, on
one smooth surface; a step, a hole at the edge, or a wide shadow stays open.
"""

import numpy as np

from twinline.arrays import BoolArray, FloatArray
from twinline.fusion.cloud import PointCloud, Source
from twinline.fusion.neighbours import LocalSurface, PointGrid

NEAR_MM = 0.45
"""A place is covered where a point lies within this distance of it."""

_LEANING = 0.5
_STEADY = 9.0
_STEEPEST = 3.0
_STEEP = 0.7
_STEP = 0.7
_LENDING = 4.0
_LEAST_COUNT = 5
_MOST_PLACES = 30_000_000


def filled_gaps(cloud: PointCloud, reach_mm: tuple[float, float], *, near_mm: float = NEAR_MM) -> PointCloud:
    """Points on the places of a grid that have none near in space, source 5.

    Parameters
    ----------
    reach_mm : (float, float)
        Width of the gaps to be closed along x and y: distance of the lines between which they lie.
    near_mm
        How far a measured point counts as near.
    """
    if len(cloud) < _LEAST_COUNT:
        return PointCloud.empty()
    grid = PointGrid(cloud.points_mm, cloud.sigma_mm, max(reach_mm))
    step_mm = _STEP * near_mm
    places = _empty_places(cloud.points_mm, step_mm)
    surface = grid.surface(places, reach_mm)
    with np.errstate(invalid="ignore"):
        steep = places[_certain(surface) & (surface.steepness > _STEEP)]
    quarter = 0.25 * step_mm
    finer = (steep[:, None] + quarter * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])).reshape(-1, 2)
    parts = [_fill(cloud, grid, p, s, near_mm) for p, s in ((places, surface), (finer, grid.surface(finer, reach_mm)))]
    return PointCloud.concatenate(parts)


def _fill(
    cloud: PointCloud, grid: PointGrid, places: FloatArray, surface: LocalSurface, near_mm: float
) -> PointCloud:  # fmt: skip
    good = np.flatnonzero(_certain(surface))
    points = np.column_stack([places[good], surface.height_mm[good]])
    alone = ~np.isfinite(grid.nearest(points, near_mm)[0])
    points, good = points[alone], good[alone]
    # Nothing is known better for being guessed from its surroundings.
    _, nearest = grid.nearest(points, _LENDING * near_mm)
    points, good, nearest = points[nearest >= 0], good[nearest >= 0], nearest[nearest >= 0]
    sigma = np.sqrt(surface.variance_mm2[good] * np.maximum(surface.misfit[good], 1.0)).astype(np.float32)
    return PointCloud(
        points.astype(np.float32),
        np.maximum(sigma, cloud.sigma_mm[nearest]),
        np.zeros(len(points), np.float32),
        cloud.colour[nearest],
        np.full(len(points), Source.FILLED, np.uint8),
    )


def _certain(surface: LocalSurface) -> BoolArray:
    with np.errstate(invalid="ignore"):
        return np.asarray(
            np.isfinite(surface.height_mm)
            & (surface.lean < _LEANING)
            & (surface.misfit < _STEADY)
            & (surface.steepness < _STEEPEST)
            & (surface.count >= _LEAST_COUNT)
        )


def _empty_places(points_mm: FloatArray, step_mm: float) -> FloatArray:
    """Middles of the cells that hold no point, (k, 2)."""
    flat = points_mm[:, :2].astype(np.float64)
    low, high = flat.min(axis=0), flat.max(axis=0)
    while np.prod((high - low) / step_mm + 1.0) > _MOST_PLACES:
        step_mm *= 2.0
    shape = np.floor((high - low) / step_mm).astype(int) + 1
    cell = np.minimum(((flat - low) / step_mm).astype(np.int64), shape - 1)
    held = np.zeros(shape, bool)
    held[cell[:, 0], cell[:, 1]] = True
    rows, columns = np.nonzero(~held)
    return np.asarray(low + (np.column_stack([rows, columns]) + 0.5) * step_mm)
