"""Points at which the thesis's calibration compares a laser with the ToF sensor.

The thesis picks them by hand on a rectangular prism. Here they are found: on flat places away from edges, on the bed
and on every level above it.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter, uniform_filter
from scipy.spatial import cKDTree
from scipy.stats import theilslopes

from twinline.arrays import BoolArray, FloatArray, IntArray
from twinline.calibration.observations import StripePoints
from twinline.calibration.thesis_surface import cell_means, extent, finite_points, middle_of_cells
from twinline.errors import CalibrationError
from twinline.geometry.rig import Rig

_LANES = 300
_FEWEST_IN_LANE = 8
_BED_QUANTILE = 0.25
_MOST_CANDIDATES = 6000
_RAISED_MM = 3.0
_FEWEST_READINGS = 6
_FULL = 0.9
_LEVEL_MM = 2.0
_FEWEST_IN_LEVEL = 3
_AGREE_MM = 3.0


@dataclass(frozen=True, eq=False)
class PickedPoints:
    """Stripe centres whose depth the ToF sensor measured.

    Attributes
    ----------
    pixels : (n, 2) array
        u, v of the stripe.
    depth_mm : (n,) array
        Z_ToF from the camera, along the optical axis of a camera that looks exactly down: its height above the bed less
        the height by ToF. NaN where the sensor has no reading.
    """

    pixels: FloatArray
    depth_mm: FloatArray

    def __post_init__(self) -> None:
        pixels = np.asarray(self.pixels, dtype=np.float64).reshape(-1, 2)
        depth = np.asarray(self.depth_mm, dtype=np.float64).ravel()
        if len(pixels) != len(depth):
            raise CalibrationError(
                f"{len(pixels)} picked pixels have {len(depth)} ToF depths: give one depth for each.", code="bad-picks"
            )
        object.__setattr__(self, "pixels", pixels)
        object.__setattr__(self, "depth_mm", depth)

    def __len__(self) -> int:
        return len(self.depth_mm)

    @classmethod
    def from_heights(cls, pixels: FloatArray, height_mm: FloatArray, camera_height_mm: float) -> "PickedPoints":
        """Points of given pixels (n, 2) and heights (n,) above the bed."""
        return cls(pixels, camera_height_mm - np.asarray(height_mm, dtype=np.float64))


def pick_points(
    rig: Rig,
    laser: int,
    stripes: StripePoints,
    tof_points_mm: FloatArray,
    *,
    per_level: int = 20,
    margin_mm: float = 4.0,
    flat_mm: float = 0.5,
    cell_mm: float = 1.0,
) -> PickedPoints:
    """Points on flat places of the bed and of what stands on it.

    A place is flat if neither the laser's nor the ToF sensor's heights differ by more than ``flat_mm`` within
    ``margin_mm``, and both saw all of it. Of each level of height the same number of points is taken, so the bed does
    not outvote the objects.

    Where a stripe lies cannot be told from the nominal sheet: one degree of the laser is 17 mm of depth. Most of each
    lane shows the bed, whose depth is known, and from there ``1/Z = 1/Z_bed + (tan(alpha) - tan(alpha_bed)) / d`` is
    wrong by the relative error of d alone. This serves to find places; the depth of a point is the ToF sensor's.

    Parameters
    ----------
    rig
        Nominal rig: camera, height, travel, side and baseline of the laser.
    stripes
        The laser's stripes over the whole pass.
    tof_points_mm : (m, 3) array
        ToF readings in the bed frame; NaN rows are ignored.
    per_level
        Most points of each level; 1 with two levels is the thesis's choice.
    cell_mm
        Size of the cells that must be filled all around; not below the distance of frames and pixels on the bed.

    Raises
    ------
    CalibrationError
        ``no-points``, ``no-overlap`` or ``too-few-points``.
    """
    usable = np.isfinite(stripes.pixels).all(axis=1) & np.isfinite(stripes.cart_mm)
    stripes = stripes.take(usable)
    tof = finite_points(tof_points_mm, "The ToF raster")
    if not len(stripes):
        raise CalibrationError(
            f"Laser {laser + 1} has no stripe at all: check that it was on during the laser pass.", code="no-points"
        )
    height_mm = float(rig.bed_from_camera.translation_mm[2])
    cloud = _provisional_cloud(rig, laser, stripes, height_mm)
    rows: IntArray = np.flatnonzero(np.isfinite(cloud).all(axis=1))
    rows = rows[middle_of_cells(cloud[rows], cell_mm)] if len(rows) else rows
    _require_overlap(cloud[rows], tof, margin_mm)
    rows = rows[_flat(cloud[rows], margin_mm, flat_mm, cell_mm)]
    rows = _thinned(rows, cloud[rows, 2])
    heights = _tof_heights(cloud[rows], tof, margin_mm, flat_mm)
    agree = np.abs(cloud[rows, 2] - (heights - _level_of_bed(tof))) <= _AGREE_MM + 0.1 * np.abs(cloud[rows, 2])
    rows, heights = rows[agree], heights[agree]
    chosen = _spread_over_levels(cloud[rows], heights, per_level)
    if len(chosen) < 2:
        raise CalibrationError(
            f"Laser {laser + 1} and the ToF raster share {len(chosen)} flat places of {2 * margin_mm:g} mm width: scan "
            "a flat-topped object, at least 20 mm wide, on the bare bed in both passes.",
            code="too-few-points",
        )
    return PickedPoints.from_heights(stripes.pixels[rows[chosen]], heights[chosen], height_mm)


def _level_of_bed(tof: FloatArray) -> float:
    """Height of the lowest place at which many readings agree."""
    heights = tof[:, 2]
    counts, edges = np.histogram(heights, bins=np.arange(heights.min(), heights.max() + 1.0, 0.5))
    if not len(counts):
        return float(np.median(heights))
    lowest = int(np.argmax(counts >= 0.3 * counts.max()))
    near = np.abs(heights - (edges[lowest] + 0.25)) <= 0.75
    return float(np.median(heights[near]))


def _provisional_cloud(rig: Rig, laser: int, stripes: StripePoints, height_mm: float) -> FloatArray:
    """Bed points of a camera that looks exactly down, with heights above each lane's own bed."""
    sheet = rig.sheets[laser]
    across = 1 if sheet.side[1] == "v" else 0
    rays = rig.camera.rays(stripes.pixels)
    sign = 1.0 if sheet.side[0] == "+" else -1.0
    tangent, lane = sign * rays[:, across], stripes.pixels[:, 1 - across]
    rise = tangent - _bed_tangent(tangent, lane, laser)
    inverse = 1.0 / height_mm + rise / abs(sheet.baseline_mm)
    with np.errstate(divide="ignore"):
        depth = np.where(inverse > 0, 1.0 / inverse, np.nan)
    return np.asarray(rig.bed_from_camera.apply(rays * depth[:, None]) + stripes.cart_mm[:, None] * rig.travel)


def _bed_tangent(tangent: FloatArray, lane: FloatArray, laser: int) -> FloatArray:
    """tan(alpha) of the bed at each point's lane: a straight line over the lanes' low quantiles."""
    lanes, low = [], []
    order = np.argsort(lane, kind="stable")
    values, first = np.unique(np.round(lane[order]), return_index=True)
    parts = np.split(tangent[order], first[1:])
    for k in range(0, len(values), max(1, len(values) // _LANES)):
        part = parts[k][np.isfinite(parts[k])]
        if len(part) >= _FEWEST_IN_LANE:
            lanes.append(values[k])
            low.append(np.quantile(part, _BED_QUANTILE))
    if len(lanes) < 2:
        raise CalibrationError(
            f"Laser {laser + 1} has no lane with {_FEWEST_IN_LANE} stripes, so the bed cannot be told from the "
            "objects: record a longer laser pass.",
            code="too-few-points",
        )
    fit = theilslopes(low, lanes)
    return np.asarray(fit.intercept + fit.slope * lane)


def _thinned(rows: IntArray, height_mm: FloatArray) -> IntArray:
    """An even choice of the bed's rows and of the raised ones, each by itself: most of a pass is bare bed."""
    raised = height_mm > _RAISED_MM
    parts = [part[:: max(1, 2 * len(part) // _MOST_CANDIDATES)] for part in (rows[~raised], rows[raised])]
    return np.concatenate(parts)


def _require_overlap(points: FloatArray, tof: FloatArray, margin_mm: float) -> None:
    if len(points) and len(tof):
        near, _ = cKDTree(tof[:, :2]).query(points[:, :2], distance_upper_bound=margin_mm)
        if np.isfinite(near).any():
            return
    raise CalibrationError(
        f"The ToF raster ({_span(tof)}) and the laser pass ({_span(points)}) saw no place in common: scan the same "
        "objects in both passes with one cart origin, or correct tof.mount_mm in capture.json.",
        code="no-overlap",
    )


def _span(points: FloatArray) -> str:
    if not len(points):
        return "nothing"
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    return f"x {low[0]:.0f} to {high[0]:.0f}, y {low[1]:.0f} to {high[1]:.0f} mm"


def _flat(points: FloatArray, margin_mm: float, flat_mm: float, cell_mm: float) -> BoolArray:
    """Whether the cells around each point, at most one point to a cell, are there and of one height."""
    low, shape = extent(points, cell_mm)
    heights = cell_means(points, cell_mm, low, shape)[..., 2]
    found = np.isfinite(heights)
    size = 2 * int(np.ceil(margin_mm / cell_mm)) + 1
    highest = maximum_filter(np.where(found, heights, -np.inf), size, mode="nearest")
    lowest = minimum_filter(np.where(found, heights, np.inf), size, mode="nearest")
    full = uniform_filter(found.astype(np.float64), size, mode="constant") >= _FULL
    index = np.floor((points[:, :2] - low) / cell_mm).astype(np.int64)
    cell = (index[:, 0], index[:, 1])
    return np.asarray(full[cell] & (highest[cell] - lowest[cell] <= flat_mm))


def _tof_heights(points: FloatArray, tof: FloatArray, margin_mm: float, flat_mm: float) -> FloatArray:
    """Median ToF height around each point; NaN where the readings are few, to one side, or not of one height."""
    heights = np.full(len(points), np.nan)
    if not len(points):
        return heights
    for k, near in enumerate(cKDTree(tof[:, :2]).query_ball_point(points[:, :2], margin_mm)):
        around = tof[np.asarray(near, dtype=np.int64)]
        if len(around) < _FEWEST_READINGS:
            continue
        one_sided = np.abs(around[:, :2].mean(axis=0) - points[k, :2]).max() > margin_mm / 3.0
        if not one_sided and np.ptp(around[:, 2]) <= flat_mm:
            heights[k] = np.median(around[:, 2])
    return heights


def _spread_over_levels(points: FloatArray, heights: FloatArray, per_level: int) -> IntArray:
    """Rows spread evenly over each level of height."""
    if not len(heights):
        return np.empty(0, np.int64)
    order = np.argsort(heights, kind="stable")
    level = np.floor((heights - heights.min()) / _LEVEL_MM + 0.25).astype(np.int64)
    chosen: list[IntArray] = []
    for value in np.unique(level[order]):
        members = np.flatnonzero(level == value)
        if len(members) < _FEWEST_IN_LEVEL:
            continue
        members = members[np.lexsort((points[members, 1], points[members, 0]))]
        count = min(per_level, len(members))
        chosen.append(members[((np.arange(count) + 0.5) * len(members) / count).astype(np.int64)])
    return np.concatenate(chosen) if chosen else np.empty(0, np.int64)
