"""What is taken from a finished cloud: the bed, stray points, all but an area, all but a fair share."""

from dataclasses import dataclass

import numpy as np

from twinline.arrays import BoolArray, FloatArray
from twinline.errors import InputError
from twinline.fusion.cloud import PointCloud
from twinline.fusion.neighbours import PointGrid

BED_MM = 1.0

_BED_ROUNDS = 6
_BED_BAND_MM = 3.0
_FEWEST_BED = 50
_FEWEST_AROUND = 3


@dataclass(frozen=True)
class Box:
    """An area, and perhaps heights, to keep; None is no limit. Bed frame, mm."""

    low_mm: tuple[float | None, float | None, float | None] = (None, None, None)
    high_mm: tuple[float | None, float | None, float | None] = (None, None, None)

    def __post_init__(self) -> None:
        for axis, low, high in zip("xyz", self.low_mm, self.high_mm, strict=True):
            if low is not None and high is not None and not low < high:
                raise InputError(f"The area to keep ends at {axis} = {high:g} mm, before it begins at {low:g} mm.")


def crop(cloud: PointCloud, box: Box) -> PointCloud:
    """The points within a box; its faces belong to it."""
    inside = np.asarray(np.isfinite(cloud.points_mm).all(axis=1))
    for axis in range(3):
        low, high = box.low_mm[axis], box.high_mm[axis]
        with np.errstate(invalid="ignore"):
            if low is not None:
                inside = inside & (cloud.points_mm[:, axis] >= low)
            if high is not None:
                inside = inside & (cloud.points_mm[:, axis] <= high)
    return cloud.select(inside)


def bed_plane(cloud: PointCloud) -> FloatArray:
    """Plane z = a + b x + c y of the bed, (3,), from the points near z = 0.

    A calibrated rig has its bed at z = 0, but a table sags and a sheet of paper is a bed too.

    Raises
    ------
    InputError
        Too few points lie near z = 0.
    """
    points = cloud.points_mm[np.isfinite(cloud.points_mm).all(axis=1)].astype(np.float64)
    plane = np.zeros(3)
    band = _BED_BAND_MM
    for _ in range(_BED_ROUNDS):
        off = points[:, 2] - plane[0] - points[:, :2] @ plane[1:]
        near = points[np.abs(off) < band]
        if len(near) < _FEWEST_BED:
            raise InputError(
                f"Only {len(near)} points lie within {_BED_BAND_MM:g} mm of the bed, and {_FEWEST_BED} are needed to "
                "find it: crop by height instead."
            )
        middle = near.mean(axis=0)
        slope, *_ = np.linalg.lstsq(near[:, :2] - middle[:2], near[:, 2] - middle[2], rcond=1e-6)
        plane = np.array([middle[2] - middle[:2] @ slope, *slope])
        band = max(0.6 * band, 0.3)
    return plane


def without_bed(cloud: PointCloud, *, above_mm: float = BED_MM) -> PointCloud:
    """The points more than ``above_mm`` above the bed's plane.

    Raises
    ------
    InputError
        As `bed_plane`.
    """
    plane = bed_plane(cloud)
    points = cloud.points_mm
    with np.errstate(invalid="ignore"):
        above = points[:, 2] - plane[0] - points[:, :2] @ plane[1:].astype(np.float32) > above_mm
    return cloud.select(np.asarray(above))


def strays(cloud: PointCloud, reach_mm: float = 1.5) -> BoolArray:
    """Points (n,) with hardly another one near them in space: off their surface by more than the reach, or alone.

    Nearness in space spares edges and walls, which a comparison of heights would not.

    Parameters
    ----------
    reach_mm
        How near; some times the distance of the points.
    """
    near = PointGrid(cloud.points_mm, cloud.sigma_mm, reach_mm).crowd(cloud.points_mm, reach_mm)
    # The point itself is one of them.
    return np.asarray(near < _FEWEST_AROUND + 1)


def thinned(cloud: PointCloud, spacing_mm: float) -> PointCloud:
    """Of each cube of so many mm the point with the smallest deviation, in the order of the cloud.

    Points are chosen, not averaged, so that each keeps its source, its colour and its place.

    Raises
    ------
    InputError
        The spacing is not positive.
    """
    if not (np.isfinite(spacing_mm) and spacing_mm > 0):
        raise InputError(f"Points are thinned to a spacing larger than 0 mm, not {spacing_mm:g} mm.")
    good = np.flatnonzero(np.isfinite(cloud.points_mm).all(axis=1))
    if not len(good):
        return PointCloud.empty()
    points = cloud.points_mm[good].astype(np.float64)
    cell = np.floor((points - points.min(axis=0)) / spacing_mm).astype(np.int64)
    sizes = cell.max(axis=0) + 1
    if float(np.prod(sizes.astype(np.float64))) > 9e18:
        raise InputError(f"A spacing of {spacing_mm:g} mm is too fine for a cloud of this size: take a larger one.")
    key = (cell[:, 0] * sizes[1] + cell[:, 1]) * sizes[2] + cell[:, 2]
    order = np.lexsort((cloud.sigma_mm[good], key))
    first = np.ones(len(order), bool)
    first[1:] = key[order][1:] != key[order][:-1]
    return cloud.select(np.sort(good[order[first]]))
