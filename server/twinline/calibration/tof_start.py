"""A first place for the ToF sensor: its readings laid over the lasers' height map by search, not by descent.

A mount is known to some millimetres at first, which is more than the width of an object's edge. What a search over
shifts and lags minimises is a truncated difference of heights, so edges count without any of them dominating.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter

from twinline.arrays import FloatArray, IntArray
from twinline.calibration.joint_model import Scanner, TofPoints, TofState, tof_points
from twinline.calibration.observations import TofReadings
from twinline.errors import CalibrationError

REACH_MM = 10.0
"""How far off a mount measured with a ruler may be."""
FIRST_CUT_MM = 4.0
LAST_CUT_MM = 1.0
"""Height differences count up to this much: first more than uncalibrated sheets are wrong by, at last about an edge."""

_RAISED_MM = 1.0
MAP_MM = 1.0
_SPIKE_WINDOW = 5
_SPIKE_SCALES = 8.0
_SPIKE_SHARE = 0.02
_BIN_MM = 0.1
_MOST_POINTS = 4000
_LONGEST_LAG_S = 0.08
_LAGS = 9
_GROUP_MM = 20.0
_FEWEST_IN_GROUP = 20


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Heights over the bed on a grid; NaN where nothing was seen."""

    heights: FloatArray
    low: FloatArray
    size_mm: float

    def at(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Bilinear; NaN where one of the four neighbours is missing."""
        fx = (x - self.low[0]) / self.size_mm - 0.5
        fy = (y - self.low[1]) / self.size_mm - 0.5
        ix, iy = np.floor(fx).astype(np.int64), np.floor(fy).astype(np.int64)
        inside = (ix >= 0) & (iy >= 0) & (ix < self.heights.shape[0] - 1) & (iy < self.heights.shape[1] - 1)
        ix, iy = np.where(inside, ix, 0), np.where(inside, iy, 0)
        tx, ty = fx - ix, fy - iy
        h = self.heights
        value = (h[ix, iy] * (1 - tx) + h[ix + 1, iy] * tx) * (1 - ty) + (
            h[ix, iy + 1] * (1 - tx) + h[ix + 1, iy + 1] * tx
        ) * ty
        return np.where(inside, value, np.nan)


def height_map(clouds: list[FloatArray], bed_clouds: list[FloatArray], size_mm: float = MAP_MM) -> HeightMap:
    """Mean height per cell of points (n, 3) in the bed frame; bed points fill cells that no object covers."""
    objects = np.concatenate(clouds) if clouds else np.empty((0, 3))
    bed = np.concatenate(bed_clouds) if bed_clouds else np.empty((0, 3))
    both = np.concatenate([objects, bed])
    both = both[np.isfinite(both).all(axis=1)]
    low = np.percentile(both[:, :2], 0.05, axis=0) - size_mm
    high = np.percentile(both[:, :2], 99.95, axis=0) + size_mm
    shape = np.minimum(np.ceil((high - low) / size_mm).astype(int) + 1, 4000)

    def means(points: FloatArray) -> FloatArray:
        points = points[np.isfinite(points).all(axis=1)]
        index = np.floor((points[:, :2] - low) / size_mm).astype(np.int64)
        inside = (index >= 0).all(axis=1) & (index < shape).all(axis=1)
        key = index[inside, 0] * shape[1] + index[inside, 1]
        total = int(shape[0] * shape[1])
        counts = np.bincount(key, minlength=total)
        sums = np.bincount(key, weights=points[inside, 2], minlength=total)
        with np.errstate(invalid="ignore", divide="ignore"):
            return (sums / counts).reshape(shape)

    top, ground = means(objects), means(bed)
    return HeightMap(np.where(np.isfinite(top), top, ground), low, size_mm)


def without_spikes(reading: FloatArray) -> FloatArray:
    """Readings (n,) in the order of time with those made NaN that lie far off both their neighbours in time."""
    valid = np.flatnonzero(np.isfinite(reading))
    out = np.array(reading, dtype=np.float64)
    if len(valid) < _SPIKE_WINDOW:
        return out
    values = out[valid]
    off = np.abs(values - median_filter(values, size=_SPIKE_WINDOW, mode="nearest"))
    span = float(np.subtract(*np.percentile(values, [99, 1])))
    limit = max(_SPIKE_SCALES * 1.4826 * float(np.median(off)), _SPIKE_SHARE * span)
    out[valid[off > limit]] = np.nan
    return out


def follow_on(readings: TofReadings) -> TofPoints:
    """Readings that follow closely on another one in the same sweep."""
    if len(readings) < 2:
        none = np.empty(0)
        return TofPoints(none, none, none, none, none)
    value = without_spikes(readings.reading)
    step = np.diff(readings.time_s)
    usual = float(np.median(step[step > 0])) if (step > 0).any() else 1.0
    ok = (
        np.isfinite(value[1:])
        & np.isfinite(value[:-1])
        & (step > 0)
        & (step < 2.5 * usual)
        & (np.abs(np.diff(readings.cart_mm)) < 1e-9)
    )
    rows = np.flatnonzero(ok) + 1
    return TofPoints(
        readings.cart_mm[rows],
        readings.slide_mm[rows],
        value[rows],
        value[rows] - value[rows - 1],
        step[rows - 1],
    )


def start_tof(
    scanner: Scanner, tof: TofPoints, surface: HeightMap, *, cut_mm: float, reach_mm: float = REACH_MM
) -> tuple[Scanner, float]:
    """Place the sensor on the lasers' height map.

    Parameters
    ----------
    cut_mm
        Largest difference of heights that counts: `FIRST_CUT_MM` or `LAST_CUT_MM`.
    reach_mm
        How far off the present place may be, along the travel and across it.

    Returns
    -------
    Scanner
        With position and lag set; everything else of the sensor as it was.
    float
        Mean truncated difference of heights at the best place, mm.

    Raises
    ------
    CalibrationError
        ``no-overlap`` if ToF raster and laser pass did not see the same place.
    """
    assert scanner.tof is not None
    scanner = _on_bed(scanner, tof)
    points = tof_points(scanner, tof) @ scanner.axes().T + np.array([0.0, 0.0, scanner.height_mm()])
    _require_overlap(points, surface)
    interesting = _interesting(points, surface)
    if len(interesting) < 50:
        return scanner, float("nan")
    tof = tof.take(interesting)
    state, axes = scanner.tof, scanner.axes()
    assert state is not None
    best = (np.inf, 0.0, 0.0, state.lag_s)
    span, step = reach_mm, min(2.0, reach_mm)
    lags = np.linspace(0.0, _LONGEST_LAG_S, _LAGS)
    for _ in range(4):
        x0, y0 = best[1:3]
        shifts = np.arange(-span, span + 1e-9, step)
        for lag in lags:
            points = _placed(scanner, state, tof, max(float(lag), 0.0), axes)
            for dx in x0 + shifts:
                for dy in y0 + shifts:
                    cost = _cost(points, surface, dx, dy, cut_mm)
                    if cost < best[0]:
                        best = (cost, dx, dy, max(float(lag), 0.0))
        width = (lags[1] - lags[0]) if len(lags) > 1 else 0.01
        span, step = step, step / 2.0
        lags = best[3] + width * np.linspace(-0.75, 0.75, 4)
    cost, dx, dy, lag = best
    moved = state.position + axes.T @ np.array([dx, dy, 0.0])
    return replace(scanner, tof=replace(state, position=moved, lag_s=lag)), float(cost)


def _placed(scanner: Scanner, state: TofState, tof: TofPoints, lag: float, axes: FloatArray) -> FloatArray:
    trial = replace(scanner, tof=replace(state, lag_s=lag))
    return np.asarray(tof_points(trial, tof) @ axes.T + np.array([0.0, 0.0, scanner.height_mm()]))


def _cost(points: FloatArray, surface: HeightMap, dx: float, dy: float, cut_mm: float) -> float:
    error = np.abs(points[:, 2] - surface.at(points[:, 0] + dx, points[:, 1] + dy))
    seen = np.isfinite(error)
    if seen.sum() < 0.3 * len(points):
        return float("inf")
    # What no laser saw says neither yes nor no; left out, it would draw the readings to where nothing is seen.
    return float((np.minimum(error[seen], cut_mm).sum() + 0.5 * cut_mm * (~seen).sum()) / len(points))


def _on_bed(scanner: Scanner, tof: TofPoints) -> Scanner:
    """Raise or lower the sensor until the lowest place at which many readings agree is the bed."""
    assert scanner.tof is not None
    axes = scanner.axes()
    heights = (tof_points(scanner, tof) @ axes.T)[:, 2] + scanner.height_mm()
    heights = heights[np.isfinite(heights)]
    bins = np.floor((heights - heights.min()) / _BIN_MM).astype(np.int64)
    counts = np.bincount(np.minimum(bins, 100_000))
    wide = np.convolve(counts, np.ones(15), mode="same")
    place = int(np.argmax(wide >= 0.5 * wide.max()))
    top = place + int(np.argmax(wide[place : place + 40]))
    near = heights[np.abs(heights - (heights.min() + (top + 0.5) * _BIN_MM)) < 1.0]
    shift = -float(np.median(near))
    state = scanner.tof
    return replace(scanner, tof=replace(state, position=state.position + axes.T @ np.array([0.0, 0.0, shift])))


def _require_overlap(points: FloatArray, surface: HeightMap) -> None:
    seen = np.isfinite(surface.at(points[:, 0], points[:, 1]))
    if seen.mean() >= 0.02:
        return
    size = np.array(surface.heights.shape) * surface.size_mm
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    end = surface.low + size
    raise CalibrationError(
        f"The ToF raster covers x {low[0]:.0f} to {high[0]:.0f} mm, y {low[1]:.0f} to {high[1]:.0f} mm, and the laser "
        f"pass x {surface.low[0]:.0f} to {end[0]:.0f} mm, y {surface.low[1]:.0f} to {end[1]:.0f} mm: they have "
        "nothing in common; scan the same objects in both passes with one cart origin, or correct tof.mount_mm in "
        "capture.json.",
        code="no-overlap",
    )


def _interesting(points: FloatArray, surface: HeightMap) -> IntArray:
    """Readings on or around objects: elsewhere every shift looks alike."""
    high = np.zeros(len(points), bool)
    for dx in (-REACH_MM, 0.0, REACH_MM):
        for dy in (-REACH_MM, 0.0, REACH_MM):
            with np.errstate(invalid="ignore"):
                high |= surface.at(points[:, 0] + dx, points[:, 1] + dy) > _RAISED_MM
    with np.errstate(invalid="ignore"):
        high |= points[:, 2] > _RAISED_MM
    rows = np.flatnonzero(high)
    return rows[:: max(1, len(rows) // _MOST_POINTS)]


def tof_bed_groups(tof: TofPoints, points: FloatArray, rows: IntArray) -> TofPoints:
    """Readings on the bed averaged over squares of it.

    Parameters
    ----------
    points : (n, 3) array
        Where they lie, in the bed frame.
    rows : (k,) int array
        Which of them are on the bed.
    """
    if not len(rows):
        return tof.take(rows)
    cell = np.floor(points[rows, :2] / _GROUP_MM).astype(np.int64)
    _, group, counts = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    group = group.ravel()
    kept = counts >= _FEWEST_IN_GROUP

    def mean(values: FloatArray) -> FloatArray:
        return (np.bincount(group, weights=values[rows], minlength=len(counts)) / counts)[kept]

    return TofPoints(mean(tof.cart_mm), mean(tof.slide_mm), mean(tof.reading), mean(tof.change), mean(tof.step_s))
