"""Where the lasers and the ToF sensor measured the same piece of surface.

The surface is cut into cells over the bed. In the cells around one, all sensors share one slope; each sensor's mean
point, moved along that slope to the middle of the cell, is its height there. Heights of two sensors in one cell are
then compared along the surface's normal, so that neither the sampling nor a first-order shift of the correspondence
enters (a point-to-plane distance: Y. Chen, G. Medioni, "Object modelling by registration of multiple range images",
1992).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinline.arrays import BoolArray, FloatArray, IntArray

_STEEPEST = 1.7
_LEVEL = 0.03
"""Slopes below this are noise: taken for real they would place a sensor on a flat top, which tells nothing of it."""
_FEWEST_IN_WINDOW = 12
_ROUGH_FLOOR_MM = 0.06
_ROUGH_SCALES = 4.0
_MOST_CELLS = 4_000_000


@dataclass(frozen=True, eq=False)
class CellEntries:
    """Sensors' shares in cells; one row per cell and sensor.

    Attributes
    ----------
    cell, sensor : (e,) int arrays
        Cell number (consecutive) and sensor (0, 1: lasers; 2: ToF).
    normal : (cells, 3) array
        Unit normal of the surface in each cell, on the axes of the points given.
    place : (cells, 2) array
        Middle of each cell on the bed.
    curvature : (cells,) array
        How fast the slope changes around each cell, per mm.
    points : tuple of int arrays
        For each sensor the indices of its points in cells, ordered by entry.
    entry : tuple of int arrays
        For each of those points its row of ``cell`` and ``sensor``.
    """

    cell: IntArray
    sensor: IntArray
    normal: FloatArray
    place: FloatArray
    curvature: FloatArray
    points: tuple[IntArray, ...]
    entry: tuple[IntArray, ...]

    @property
    def cells(self) -> int:
        """Number of cells."""
        return len(self.normal)


def find_cells(clouds: tuple[FloatArray, ...], size_mm: float) -> CellEntries:
    """Find the cells in which at least two sensors saw one smooth surface.

    Parameters
    ----------
    clouds
        For each sensor its points (n, 3) with x, y along the bed and z up; NaN rows are ignored.
    size_mm
        Side of a cell.
    """
    good = [np.isfinite(cloud).all(axis=1) for cloud in clouds]
    everything = np.concatenate([cloud[ok, :2] for cloud, ok in zip(clouds, good, strict=True)])
    if not len(everything):
        return _no_cells(len(clouds))
    low = np.percentile(everything, 0.1, axis=0) - 3 * size_mm
    high = np.percentile(everything, 99.9, axis=0) + 3 * size_mm
    shape = tuple(int(n) for n in np.ceil((high - low) / size_mm).astype(int) + 1)
    if shape[0] * shape[1] > _MOST_CELLS:
        return find_cells(clouds, 2 * size_mm)
    grids: list[tuple[FloatArray, ...]] = []
    keys: list[IntArray] = []
    for cloud, ok in zip(clouds, good, strict=True):
        index = np.floor((cloud[:, :2] - low) / size_mm)
        inside = ok & (index >= 1).all(axis=1) & (index < np.array(shape) - 1).all(axis=1)
        key = np.full(len(cloud), -1, np.int64)
        at = index[inside].astype(np.int64)
        key[inside] = at[:, 0] * shape[1] + at[:, 1]
        keys.append(key)
        grids.append(_moments(cloud[inside], key[inside], shape, low, size_mm))
    slope, rough, count = _slopes(grids)
    seen = np.stack([grid[0] >= 1 for grid in grids])
    limit = np.inf
    candidates = (seen.sum(axis=0) >= 2) & (count >= _FEWEST_IN_WINDOW) & np.isfinite(rough)
    if candidates.any():
        limit = max(_ROUGH_SCALES * float(np.median(rough[candidates])), _ROUGH_FLOOR_MM)
    wanted = candidates & (rough < limit) & (np.hypot(slope[0], slope[1]) < _STEEPEST)
    return _collect(keys, wanted, slope, _curvature(slope, size_mm), low, size_mm)


def _no_cells(sensors: int) -> CellEntries:
    none = np.empty(0, np.int64)
    return CellEntries(
        none, none, np.empty((0, 3)), np.empty((0, 2)), np.empty(0), (none,) * sensors, (none,) * sensors
    )


def _moments(
    cloud: FloatArray, key: IntArray, shape: tuple[int, ...], low: FloatArray, size_mm: float
) -> tuple[FloatArray, ...]:
    """Per cell the count and the sums of x, y, z, xx, xy, yy, xz, yz, zz about the corner of the grid's middle."""
    middle = low + 0.5 * np.array(shape) * size_mm
    x, y = (cloud[:, :2] - middle).T
    z = cloud[:, 2]
    total = shape[0] * shape[1]
    columns: tuple[FloatArray, ...] = (np.ones(len(key)), x, y, z, x * x, x * y, y * y, x * z, y * z, z * z)
    sums = [np.asarray(np.bincount(key, weights=c, minlength=total), dtype=np.float64) for c in columns]
    return tuple(s.reshape(shape) for s in sums)


def _window(values: FloatArray) -> FloatArray:
    """Sum over each cell and its eight neighbours."""
    padded = np.pad(values, 1)
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    return np.asarray(rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:])


def _slopes(grids: list[tuple[FloatArray, ...]]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Slopes common to all sensors (2, ...), root mean square distance to the sensors' own planes, and point count."""
    scatter = np.zeros((6, *grids[0][0].shape))
    points = np.zeros(grids[0][0].shape)
    sensors = np.zeros(grids[0][0].shape)
    for grid in grids:
        n, x, y, z, xx, xy, yy, xz, yz, zz = (_window(g) for g in grid)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = np.where(n >= 3, 1.0 / n, 0.0)
        use = n >= 3
        centred = (
            xx - x * x * inverse,
            xy - x * y * inverse,
            yy - y * y * inverse,
            xz - x * z * inverse,
            yz - y * z * inverse,
            zz - z * z * inverse,
        )
        scatter += np.where(use, np.stack(centred), 0.0)
        points += np.where(use, n, 0.0)
        sensors += use
    sxx, sxy, syy, sxz, syz, szz = scatter
    determinant = sxx * syy - sxy * sxy
    with np.errstate(divide="ignore", invalid="ignore"):
        solid = determinant > 1e-3 * (sxx + syy) ** 2
        gx = np.where(solid, (syy * sxz - sxy * syz) / determinant, np.nan)
        gy = np.where(solid, (sxx * syz - sxy * sxz) / determinant, np.nan)
        left = np.maximum(szz - gx * sxz - gy * syz, 0.0)
        freedom = np.maximum(points - sensors - 2, 1)
        rough = np.sqrt(left / freedom / (1 + gx**2 + gy**2))
    return np.stack([gx, gy]), rough, points


def _curvature(slope: FloatArray, size_mm: float) -> FloatArray:
    """Largest change of the slope per mm between the cells on either side; 0 where they are not known."""
    most = np.zeros(slope.shape[1:])
    for component, axis in ((0, 0), (1, 1), (0, 1)):
        values = np.swapaxes(slope[component], 0, axis)
        bend = np.zeros_like(values)
        bend[1:-1] = np.abs(values[2:] - values[:-2]) / (2.0 * size_mm)
        most = np.fmax(most, np.swapaxes(bend, 0, axis))
    return np.nan_to_num(most)


def _collect(
    keys: Sequence[IntArray],
    wanted: BoolArray,
    slope: FloatArray,
    curvature: FloatArray,
    low: FloatArray,
    size_mm: float,
) -> CellEntries:
    flat = np.flatnonzero(wanted.ravel())
    number = np.full(wanted.size, -1, np.int64)
    number[flat] = np.arange(len(flat))
    gx, gy = slope[0].ravel()[flat], slope[1].ravel()[flat]
    level = np.hypot(gx, gy) < _LEVEL
    gx, gy = np.where(level, 0.0, gx), np.where(level, 0.0, gy)
    normal = np.column_stack([-gx, -gy, np.ones(len(flat))])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    row, column = np.unravel_index(flat, wanted.shape)
    place = np.column_stack([row, column]) * size_mm + low + 0.5 * size_mm
    cells, sensors, points, entries = [], [], [], []
    start = 0
    for sensor, key in enumerate(keys):
        here = np.flatnonzero((key >= 0) & (number[np.maximum(key, 0)] >= 0))
        cell = number[key[here]]
        order = np.argsort(cell, kind="stable")
        here, cell = here[order], cell[order]
        own, entry = np.unique(cell, return_inverse=True)
        cells.append(own)
        sensors.append(np.full(len(own), sensor))
        points.append(here)
        entries.append(entry + start)
        start += len(own)
    return CellEntries(
        np.concatenate(cells), np.concatenate(sensors), normal, place, curvature.ravel()[flat], tuple(points),
        tuple(entries),
    )  # fmt: skip
