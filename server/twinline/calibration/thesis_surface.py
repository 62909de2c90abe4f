"""Clouds of the two passes, and one cloud as a surface that another one is compared with."""

from dataclasses import dataclass

import numpy as np

from twinline.arrays import FloatArray, IntArray
from twinline.calibration.observations import StripePoints, TofReadings
from twinline.errors import CalibrationError
from twinline.geometry.rig import Rig
from twinline.geometry.triangulation import stripe_points

_STEEPEST = 1.0
# Frames fall at equal distances along x. On a grid that lay along x all of them would have the same place in their
# cells, so interpolation would average away more of the noise at some shifts than at others and draw a search there.
_TURN = np.array([[np.cos(0.55), np.sin(0.55)], [-np.sin(0.55), np.cos(0.55)]])
_MOST_CELLS = 16_000_000


def laser_cloud(rig: Rig, laser: int, stripes: StripePoints) -> FloatArray:
    """Points (n, 3) in the bed frame of one laser's stripes over a whole pass; NaN where a ray misses the sheet."""
    points, _ = stripe_points(rig, laser, stripes.pixels, stripes.sd_px, 0.0)
    return np.asarray(points + np.asarray(stripes.cart_mm)[:, None] * rig.travel)


def tof_cloud(rig: Rig, readings: TofReadings) -> FloatArray:
    """Points (n, 3) in the bed frame of ToF readings, taken as they are, without the sensor's lag.

    NaN where there is no reading, or its distance is outside the sensor's range.

    Raises
    ------
    CalibrationError
        ``no-tof`` if the rig has no ToF sensor.
    """
    mount = rig.tof
    if mount is None:
        raise CalibrationError(
            "The rig has no ToF sensor, and this method measures against one: describe it under tof in capture.json, "
            "or use the joint method.",
            code="no-tof",
        )
    distance = mount.offset_mm + mount.gain_mm_per_unit * np.asarray(readings.reading, dtype=np.float64)
    valid = (distance >= mount.range_mm[0]) & (distance <= mount.range_mm[1])
    distance = np.where(valid, distance, np.nan)
    return np.asarray(
        mount.position_mm
        + np.asarray(readings.cart_mm)[:, None] * rig.travel
        + np.asarray(readings.slide_mm)[:, None] * mount.slide
        + distance[:, None] * mount.beam
    )


def finite_points(points_mm: FloatArray, what: str) -> FloatArray:
    """The rows without NaN, as float64.

    Raises
    ------
    CalibrationError
        ``no-points`` if there are none.
    """
    points = np.asarray(points_mm, dtype=np.float64).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        raise CalibrationError(
            f"{what} holds no measurement at all, every value is missing or out of range: check its recording and "
            "range, then repeat the pass.",
            code="no-points",
        )
    return points


def cell_means(points_mm: FloatArray, cell_mm: float, low: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Mean x, y, z of the points of each cell, (rows, columns, 3); NaN in cells without points."""
    index = np.floor((points_mm[:, :2] - low) / cell_mm).astype(np.int64)
    key = index[:, 0] * shape[1] + index[:, 1]
    total = shape[0] * shape[1]
    counts = np.bincount(key, minlength=total)
    filled = counts > 0
    means = np.full((total, 3), np.nan)
    for axis in range(3):
        sums = np.bincount(key, weights=points_mm[:, axis], minlength=total)
        means[filled, axis] = sums[filled] / counts[filled]
    return means.reshape(*shape, 3)


def extent(points_mm: FloatArray, cell_mm: float) -> tuple[FloatArray, tuple[int, int]]:
    """Low corner and numbers of cells of a grid over all points.

    Raises
    ------
    CalibrationError
        ``cloud-too-wide`` if the grid would be too large to be true.
    """
    low = np.floor(points_mm[:, :2].min(axis=0) / cell_mm) * cell_mm
    rows, columns = (int(n) + 1 for n in np.floor((points_mm[:, :2].max(axis=0) - low) / cell_mm))
    if rows * columns > _MOST_CELLS:
        raise CalibrationError(
            f"The cloud spans {rows * cell_mm:.0f} x {columns * cell_mm:.0f} mm: start from a rig nearer to the truth, "
            "or leave out the stray points.",
            code="cloud-too-wide",
        )
    return low, (rows, columns)


@dataclass(frozen=True, eq=False)
class Surface:
    """Heights at the centres of the cells of a grid that is turned against the travel.

    Attributes
    ----------
    heights_mm : (rows, columns) array
        NaN where nothing was measured, which no interpolation bridges.
    low_mm : (2,) array
        Corner of the grid, in its own axes.
    """

    heights_mm: FloatArray
    low_mm: FloatArray
    cell_mm: float

    @classmethod
    def of_points(cls, points_mm: FloatArray, cell_mm: float) -> "Surface":
        """Surface of finite points (n, 3) in the bed frame.

        A cell's mean height belongs to the mean place of its points. Frames that fall always on the same side of the
        cells would move the whole surface by a part of a cell, so it is carried to the centre along the local slope.
        """
        points_mm = np.column_stack([points_mm[:, :2] @ _TURN.T, points_mm[:, 2]])
        low, shape = extent(points_mm, cell_mm)
        means = cell_means(points_mm, cell_mm, low, shape)
        heights = means[..., 2].copy()
        if min(shape) >= 3:
            rows, columns = (low[axis] + (np.arange(shape[axis]) + 0.5) * cell_mm for axis in (0, 1))
            centres = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1)
            slope = _slopes(means)
            gentle = np.abs(slope).max(axis=-1) <= _STEEPEST
            heights += np.where(gentle, (slope * (centres - means[..., :2])).sum(axis=-1), 0.0)
        return cls(heights, low, cell_mm)

    def at(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Bilinear height; NaN where one of the four cells around has none."""
        turned = np.stack([x_mm, y_mm], axis=-1) @ _TURN.T
        fx = (turned[..., 0] - self.low_mm[0]) / self.cell_mm - 0.5
        fy = (turned[..., 1] - self.low_mm[1]) / self.cell_mm - 0.5
        i, j = np.floor(fx).astype(np.int64), np.floor(fy).astype(np.int64)
        rows, columns = self.heights_mm.shape
        inside = (i >= 0) & (j >= 0) & (i < rows - 1) & (j < columns - 1)
        if rows < 2 or columns < 2:
            return np.full(np.shape(x_mm), np.nan)
        i, j = np.where(inside, i, 0), np.where(inside, j, 0)
        s, t, h = fx - i, fy - j, self.heights_mm
        near = h[i, j] * (1 - t) + h[i, j + 1] * t
        far = h[i + 1, j] * (1 - t) + h[i + 1, j + 1] * t
        return np.asarray(np.where(inside, near * (1 - s) + far * s, np.nan))


def _slopes(means: FloatArray) -> FloatArray:
    """Gradient (rows, columns, 2) of mean points (rows, columns, 3); NaN at the borders and beside gaps."""
    down, right = np.full(means.shape, np.nan), np.full(means.shape, np.nan)
    down[1:-1] = means[2:] - means[:-2]
    right[:, 1:-1] = means[:, 2:] - means[:, :-2]
    (a, b, p), (c, d, q) = np.moveaxis(down, -1, 0), np.moveaxis(right, -1, 0)
    # Neighbouring means are at least a cell apart on average; nearly coincident ones tell no slope.
    determinant = a * d - b * c
    determinant = np.where(np.abs(determinant) > 1e-9, determinant, np.nan)
    return np.stack([(d * p - b * q) / determinant, (a * q - c * p) / determinant], axis=-1)


def middle_of_cells(points_mm: FloatArray, cell_mm: float) -> IntArray:
    """Of each cell that holds points, the row of the one whose height is the median."""
    low, shape = extent(points_mm, cell_mm)
    index = np.floor((points_mm[:, :2] - low) / cell_mm).astype(np.int64)
    key = index[:, 0] * shape[1] + index[:, 1]
    order = np.lexsort((points_mm[:, 2], key))
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    last = np.append(first[1:], len(order))
    return np.asarray(order[(first + last - 1) // 2])
