"""Points of the ToF sensor: its lag undone, what it cannot have followed left out, its noise averaged along the sweep.

The sensor follows a distance like a first-order filter: of readings m taken dt apart, ``z_k = (m_k - a m_(k-1)) / (1 -
a)`` with ``a = exp(-dt/tau)`` is the distance itself. That is exact for a distance that stays between two readings, and
it multiplies noise by ``sqrt(1 + a^2) / (1 - a)``; so the freed distances are averaged by a line over a few readings of
the same sweep. Where the distance changes so fast that the lag's correction would be more than a few hundredths of a
millimetre, an error of the lag shows: such readings are no measurements.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numba import njit
from scipy.ndimage import median_filter

from twinline.arrays import BoolArray, ByteArray, FloatArray, IntArray
from twinline.geometry.rig import TofMount

LARGEST_CORRECTION_MM = 0.05
"""A reading whose distance changes by more than this in one lag is left out."""

REACH_MM = 0.6
"""Readings so far to either side along the sweep are averaged; a jump within that distance leaves a reading out."""

REPEATABILITY_MM = 0.01
"""No average is better than this: the sensor's own repeatability."""

_LAG_DOUBT = 0.2
_SPIKE_WINDOW = 5
_SPIKE_SCALES = 8.0
_SPIKE_LEAST_MM = 1.0
_MOST_STEPS = 2.5
_FEWEST_AVERAGED = 5
_JUMP_SCALES = 2.5


class TofReason(IntEnum):
    """What became of a reading."""

    KEPT = 0
    NO_READING = 1
    OUT_OF_RANGE = 2
    SPIKE = 3
    NO_NEIGHBOURS = 4
    """The reading before it is missing, or too few of the same sweep are near."""
    TOO_FAST = 5
    """The distance changes faster than the sensor can be trusted to follow: a steep flank."""
    EDGE = 6
    """The readings around it do not lie on one line: a step."""


@dataclass(frozen=True, eq=False)
class TofSweeps:
    """Points of a ToF raster, one row per reading.

    Attributes
    ----------
    points_mm : (n, 3) array
        In the bed frame; NaN where ``reason`` is not `TofReason.KEPT`.
    sigma_mm : (n,) array
        Standard deviation of the distance; NaN as above.
    reason : (n,) uint8 array
        One of `TofReason`.
    line : (n,) int array
        Number of the sweep that each reading belongs to.
    """

    points_mm: FloatArray
    sigma_mm: FloatArray
    reason: ByteArray
    line: IntArray

    @property
    def kept(self) -> BoolArray:
        """Rows with a measurement."""
        return np.asarray(self.reason == TofReason.KEPT)


@dataclass(frozen=True, eq=False)
class TofRaster:
    """Readings in the order of time, arrays of (n,).

    Attributes
    ----------
    time_s, cart_mm, slide_mm
        Time and commanded positions.
    reading
        In the unit that the mount's gain belongs to; NaN where there is none.
    """

    time_s: FloatArray
    cart_mm: FloatArray
    slide_mm: FloatArray
    reading: FloatArray

    def __len__(self) -> int:
        return len(self.time_s)

    def sweeps(self) -> IntArray:
        """Number of the sweep of each reading: a new one begins where the cart moves, the slide turns or time jumps."""
        if len(self) == 0:
            return np.empty(0, np.int64)
        step, slid = np.diff(self.time_s), np.diff(self.slide_mm)
        usual = float(np.median(step[step > 0])) if (step > 0).any() else 1.0
        moved = np.abs(np.diff(self.cart_mm)) > 1e-9
        late = (step <= 0) | (step > _MOST_STEPS * usual)
        turned = np.zeros(len(step), bool)
        turned[1:] = slid[1:] * slid[:-1] < 0
        return np.concatenate([[0], np.cumsum(moved | late | turned)])


def freed_distances(raster: TofRaster, mount: TofMount, lag_s: float) -> tuple[FloatArray, ByteArray]:
    """Distances without the lag, (n,) in mm with NaN where there is none, and why not, (n,) of `TofReason`."""
    measured = mount.offset_mm + mount.gain_mm_per_unit * np.asarray(raster.reading, np.float64)
    reason = np.zeros(len(raster), np.uint8)
    low, high = mount.range_mm
    reason[~np.isfinite(measured)] = TofReason.NO_READING
    with np.errstate(invalid="ignore"):
        reason[(measured < low - 1e-6) | (measured > high + 1e-6)] = TofReason.OUT_OF_RANGE
    measured[reason != TofReason.KEPT] = np.nan
    spike = _spikes(measured)
    measured[spike] = np.nan
    reason[spike] = TofReason.SPIKE
    if lag_s <= 0 or len(raster) == 0:
        return measured, reason
    line = raster.sweeps()
    step = np.diff(raster.time_s, prepend=raster.time_s[0])
    # The lag does not care whether the cart moved meanwhile, only whether the reading before is known.
    before = np.concatenate([[np.nan], measured[:-1]])
    usual = float(np.median(step[step > 0])) if (step > 0).any() else 1.0
    before[(step <= 0) | (step > _MOST_STEPS * usual) | (line != np.concatenate([[-1], line[:-1]]))] = np.nan
    with np.errstate(over="ignore"):
        a = np.exp(-np.maximum(step, 1e-9) / lag_s)
    freed = (measured - a * before) / (1.0 - a)
    reason[np.isfinite(measured) & ~np.isfinite(freed)] = TofReason.NO_NEIGHBOURS
    return freed, reason


def _spikes(distance: FloatArray) -> BoolArray:
    """Readings far off both their neighbours in time, (n,)."""
    spike = np.zeros(len(distance), bool)
    valid = np.flatnonzero(np.isfinite(distance))
    if len(valid) < _SPIKE_WINDOW:
        return spike
    values = distance[valid]
    off = np.abs(values - median_filter(values, size=_SPIKE_WINDOW, mode="nearest"))
    spike[valid] = off > max(_SPIKE_SCALES * 1.4826 * float(np.median(off)), _SPIKE_LEAST_MM)
    return spike


def tof_sweeps(raster: TofRaster, mount: TofMount, travel: FloatArray, *, lag_s: float | None = None) -> TofSweeps:
    """Points of a raster in the bed frame.

    Parameters
    ----------
    travel : (3,) array
        Bed millimetres per commanded millimetre of the cart.
    lag_s
        Time constant of the sensor; None takes the mount's.
    """
    lag = mount.lag_s if lag_s is None else lag_s
    freed, reason = freed_distances(raster, mount, lag)
    line = raster.sweeps()
    n = len(raster)
    smooth, rate, sigma, scatter = np.full((4, n), np.nan)
    along = raster.slide_mm * float(np.linalg.norm(mount.slide))
    noise = _noise_of(freed, line)
    if n:
        _average(
            line, raster.time_s, along, freed, REACH_MM, _FEWEST_AVERAGED, _JUMP_SCALES * noise, smooth, rate,
            sigma, scatter,
        )  # fmt: skip
    kept = reason == TofReason.KEPT
    reason[kept & ~np.isfinite(smooth)] = TofReason.NO_NEIGHBOURS
    with np.errstate(invalid="ignore"):
        reason[(reason == TofReason.KEPT) & (scatter > _JUMP_SCALES * noise)] = TofReason.EDGE
        # Readings at rest have no lag to speak of, whatever the rate that noise alone gives.
        moves = np.abs(rate) * lag
        reason[(reason == TofReason.KEPT) & (moves > LARGEST_CORRECTION_MM)] = TofReason.TOO_FAST
    wanted = reason == TofReason.KEPT
    distance = np.where(wanted, smooth, np.nan)
    points = (
        mount.position_mm
        + raster.cart_mm[:, None] * np.asarray(travel)
        + raster.slide_mm[:, None] * mount.slide
        + distance[:, None] * mount.beam
    )
    deviation = np.hypot(_averaged_noise(raster, mount, line, lag, sigma), _LAG_DOUBT * moves)
    return TofSweeps(points, np.where(wanted, deviation, np.nan), reason, line)


def _averaged_noise(
    raster: TofRaster, mount: TofMount, line: IntArray, lag_s: float, share: FloatArray
) -> FloatArray:  # fmt: skip
    """Standard deviation (n,) of averages of freed distances.

    Freeing makes the noise of successive distances cancel in part: of N of them in a row all but the first and the
    last reading nearly drop out, ``var = n^2 (1/N + 2 a / (N (1 - a))^2)`` with the readings' own noise n.
    """
    step = np.diff(raster.time_s)
    usual = float(np.median(step[step > 0])) if (step > 0).any() else 1.0
    a = float(np.exp(-usual / lag_s)) if lag_s > 0 else 0.0
    own = _noise_of(mount.gain_mm_per_unit * np.asarray(raster.reading, np.float64), line)
    averaged = own * np.sqrt(share**2 + share**4 * 2.0 * a / (1.0 - a) ** 2)
    return np.asarray(np.hypot(averaged, REPEATABILITY_MM))


def _noise_of(distance: FloatArray, line: IntArray) -> float:
    """Standard deviation of single distances, from second differences within sweeps."""
    if len(distance) < 3:
        return REPEATABILITY_MM
    second = distance[2:] - 2.0 * distance[1:-1] + distance[:-2]
    second = second[np.isfinite(second) & (line[2:] == line[:-2])]
    if not len(second):
        return REPEATABILITY_MM
    return max(1.4826 * float(np.median(np.abs(second))) / float(np.sqrt(6.0)), REPEATABILITY_MM)


@njit(cache=True, error_model="numpy")
def _average(
    line: IntArray, time_s: FloatArray, along_mm: FloatArray, distance: FloatArray, reach_mm: float, fewest: int,
    most_scatter: float, smooth: FloatArray, rate: FloatArray, share: FloatArray, scatter: FloatArray,
) -> None:  # fmt: skip  # pragma: no cover - compiled
    """Line through the readings of the same sweep around each: value, change per second, noise left, rms about it.

    Where the readings to both sides are not on one line, those to the one side that are serve: beside a step.
    """
    n = line.size
    found = np.empty(4)
    for i in range(n):
        if not np.isfinite(distance[i]):
            continue
        for before, after in ((True, True), (True, False), (False, True)):
            if not _line_around(
                i, before, after, line, time_s, along_mm, distance, reach_mm if before and after else 1.5 * reach_mm,
                fewest if before and after else fewest - 1, found,
            ):  # fmt: skip
                continue
            if not found[3] >= scatter[i]:
                smooth[i], rate[i], share[i], scatter[i] = found
            if scatter[i] <= most_scatter:
                break


@njit(cache=True, error_model="numpy")
def _line_around(
    i: int, before: bool, after: bool, line: IntArray, time_s: FloatArray, along_mm: FloatArray, distance: FloatArray,
    reach_mm: float, fewest: int, found: FloatArray,
) -> bool:  # fmt: skip  # pragma: no cover - compiled
    n = line.size
    w, t1, t2, d1, td, dd = 1.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for direction in (-1, 1):
        if not (before if direction == -1 else after):
            continue
        j = i + direction
        while 0 <= j < n and line[j] == line[i] and abs(along_mm[j] - along_mm[i]) <= reach_mm:
            if not np.isfinite(distance[j]):
                break
            t, d = time_s[j] - time_s[i], distance[j] - distance[i]
            w += 1.0
            t1 += t
            t2 += t * t
            d1 += d
            td += t * d
            dd += d * d
            j += direction
    if w < fewest or w < 3.0:
        return False
    spread = t2 - t1 * t1 / w
    slope = (td - t1 * d1 / w) / spread if spread > 0.0 else 0.0
    left = dd - d1 * d1 / w - slope * (td - t1 * d1 / w)
    found[0] = distance[i] + d1 / w - slope * t1 / w
    found[1] = slope
    found[2] = np.sqrt(1.0 / w + (t1 / w) ** 2 / spread) if spread > 0.0 else np.sqrt(1.0 / w)
    found[3] = np.sqrt(max(left, 0.0) / (w - 2.0))
    return True
