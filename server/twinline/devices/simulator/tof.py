"""The point distance sensor and the converter that reads it: from true distances to ADC counts.

The sensor answers with a first-order lag, ``tau dy/dt = x - y``. Between two samples the true distance x is taken to
change evenly, and over such a piece the lag is solved exactly, so that the answer does not depend on how often the
board looks, only on how finely the path is given.
"""

from dataclasses import dataclass, field

import numba
import numpy as np

from twinline.arrays import BoolArray, FloatArray, IntArray
from twinline.errors import SettingsError


@dataclass(frozen=True)
class TofSensor:
    """The sensor itself, by default a Keyence LB-70.

    Attributes
    ----------
    range_mm, volts
        Shortest and longest distance, and the voltages that stand for them.
    lag_s
        Time constant; a response of 40 ms from 10 to 90 % is 18 ms.
    noise_mm
        Standard deviation of the reading at rest. It is as slow as the sensor itself.
    too_near_volts, nothing_volts
        Output while something is nearer than the range, and while nothing is in it.
    """

    range_mm: tuple[float, float] = (60.0, 140.0)
    volts: tuple[float, float] = (-4.0, 4.0)
    lag_s: float = 0.018
    noise_mm: float = 0.008
    too_near_volts: float = -4.4
    nothing_volts: float = 4.4

    def __post_init__(self) -> None:
        if not (self.range_mm[0] < self.range_mm[1] and self.lag_s >= 0 and self.noise_mm >= 0):
            raise SettingsError(
                f"The simulated ToF sensor needs a range that ascends and no negative lag or noise, not {self.range_mm}"
                f" mm, {self.lag_s} s and {self.noise_mm} mm."
            )

    @property
    def volts_per_mm(self) -> float:
        """Slope of the output."""
        return (self.volts[1] - self.volts[0]) / (self.range_mm[1] - self.range_mm[0])


@dataclass(frozen=True)
class FrontEnd:
    """Resistors and converter between the sensor's output and a count.

    The default has room beyond both ends of the sensor's range, so that "nothing there" can be told from "at the end".

    Attributes
    ----------
    gain, offset_volts
        Voltage at the converter = offset + gain * sensor's voltage.
    reference_volts, counts
        Voltage of the count above the last, and number of counts.
    open_volts
        Voltage at the converter with the sensor's wire off.
    noise_counts
        Standard deviation of one conversion, before rounding.
    """

    gain: float = 0.36
    offset_volts: float = 1.65
    reference_volts: float = 3.3
    counts: int = 4096
    open_volts: float = 0.0
    noise_counts: float = 0.9

    def count_of(self, distance_mm: float, sensor: TofSensor) -> float:
        """Count, not rounded, that a distance within the range gives at rest."""
        volts = sensor.volts[0] + (distance_mm - sensor.range_mm[0]) * sensor.volts_per_mm
        return (self.offset_volts + self.gain * volts) / self.reference_volts * (self.counts - 1)

    def line_of(self, sensor: TofSensor) -> tuple[float, float]:
        """Gain and offset of ``distance_mm = offset + gain * count``."""
        at_zero, at_ten = (self.count_of(mm, sensor) for mm in (0.0, 10.0))
        gain = 10.0 / (at_ten - at_zero)
        return gain, -gain * at_zero


def full_scale_front_end(sensor: TofSensor, *, noise_counts: float = 0.9) -> FrontEnd:
    """A front end whose first and last count are the ends of the sensor's range, as capture folders state it."""
    low, high = sensor.volts
    gain = FrontEnd.reference_volts / (high - low)
    return FrontEnd(gain, -gain * low, noise_counts=noise_counts)


@dataclass(frozen=True)
class TofFaults:
    """What is wrong with the sensor now.

    Attributes
    ----------
    dropout_share
        Share of the time in which the sensor sees nothing, in pieces of ``dropout_s``: a dark or glossy surface.
    saturated
        Too much light comes back: the output stands at its near end.
    unplugged
        The wire is off.
    """

    dropout_share: float = 0.0
    dropout_s: float = 0.03
    saturated: bool = False
    unplugged: bool = False

    def __post_init__(self) -> None:
        if not (0.0 <= self.dropout_share <= 1.0 and self.dropout_s > 0):
            raise SettingsError(
                f"A simulated ToF dropout needs a share between 0 and 1 and a length above 0 s, not "
                f"{self.dropout_share} and {self.dropout_s} s."
            )


@dataclass
class TofReader:
    """Sensor and converter in time; it remembers what the lag and the noise remember, and nothing else.

    ``faults`` may be replaced at any time. Times given to it must not run backwards. The same seed and the same calls
    give the same counts.
    """

    sensor: TofSensor = field(default_factory=TofSensor)
    front_end: FrontEnd = field(default_factory=FrontEnd)
    seed: int = 0
    faults: TofFaults = field(default_factory=TofFaults)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng([self.seed, 7])
        self._time_s = -np.inf
        self._last_mm = np.nan
        self._lagged_mm = np.nan
        self._noise = 0.0

    def sample(self, time_s: FloatArray, distance_mm: FloatArray) -> IntArray:
        """Convert at the given times.

        Parameters
        ----------
        time_s : (n,) array
            Ascending, and after those of the call before.
        distance_mm : (n,) array
            True distance at those times; infinity where there is nothing.

        Returns
        -------
        (n,) array of int
            Counts from 0 to ``front_end.counts - 1``.

        Raises
        ------
        SettingsError
            Time runs backwards.
        """
        time = np.ascontiguousarray(time_s, dtype=np.float64)
        distance = np.ascontiguousarray(distance_mm, dtype=np.float64)
        if len(time) == 0:
            return np.empty(0, dtype=np.int64)
        step_s = np.diff(time, prepend=max(self._time_s, -1e12))
        if (step_s < 0).any():
            raise SettingsError(
                f"The simulated ToF sensor cannot go back in time, from {self._time_s:g} s to {time.min():g} s."
            )
        seen = np.empty(len(time))
        random = self._rng.standard_normal((2, len(time)))
        low, high = self.sensor.range_mm
        self._last_mm, self._lagged_mm, self._noise = _answer(
            step_s, distance, random[0], self.sensor.lag_s, self.sensor.noise_mm, low, high,
            self._last_mm, self._lagged_mm, self._noise, seen,
        )  # fmt: skip
        self._time_s = float(time[-1])
        return self._convert(time, seen, random[1])

    def _convert(self, time_s: FloatArray, seen: FloatArray, noise: FloatArray) -> IntArray:
        """Counts of lagged distances (NaN: too near; infinity: nothing)."""
        sensor, front = self.sensor, self.front_end
        low = sensor.range_mm[0]
        volts = sensor.volts[0] + (np.nan_to_num(seen, posinf=0.0) - low) * sensor.volts_per_mm
        volts[np.isnan(seen)] = sensor.too_near_volts
        volts[np.isposinf(seen)] = sensor.nothing_volts
        if self.faults.dropout_share > 0:
            volts[self._dropped(time_s)] = sensor.nothing_volts
        if self.faults.saturated:
            volts[:] = sensor.too_near_volts
        at_pin = front.offset_volts + front.gain * volts
        if self.faults.unplugged:
            at_pin[:] = front.open_volts
        counts = np.rint(at_pin / front.reference_volts * (front.counts - 1) + front.noise_counts * noise)
        return np.clip(counts, 0, front.counts - 1).astype(np.int64)

    def _dropped(self, time_s: FloatArray) -> BoolArray:
        """Which times fall into a dropout; the pieces are fixed by seed and time, not by the calls."""
        pieces = np.floor(time_s / self.faults.dropout_s).astype(np.int64)
        share = {
            int(piece): np.random.default_rng([self.seed, 8, int(piece) & 0xFFFFFFFF]).random()
            for piece in np.unique(pieces)
        }
        return np.array([share[int(piece)] < self.faults.dropout_share for piece in pieces], dtype=np.bool_)


@numba.njit(cache=True, nogil=True)
def _answer(
    step_s: FloatArray,
    distance_mm: FloatArray,
    random: FloatArray,
    lag_s: float,
    noise_mm: float,
    low: float,
    high: float,
    last_mm: float,
    lagged_mm: float,
    noise: float,
    seen: FloatArray,
) -> tuple[float, float, float]:  # pragma: no cover - compiled
    """Solve the lag over each step, with noise of the same memory.

    Over a step of length h in which x goes evenly from x0 to x1 with slope s, ``y1 = x1 - s tau + (y0 - x0 + s tau)
    exp(-h / tau)``. Outside its range the sensor has nothing to follow: the lag begins anew when the range is entered.
    """
    for i in range(step_s.size):
        x, h = distance_mm[i], step_s[i]
        keep = np.exp(-h / lag_s) if lag_s > 0.0 else 0.0
        noise = keep * noise + np.sqrt(1.0 - keep * keep) * random[i]
        if x < low:
            lagged_mm, last_mm, seen[i] = np.nan, np.nan, np.nan
            continue
        if x > high or x != x:
            lagged_mm, last_mm, seen[i] = np.nan, np.nan, np.inf
            continue
        if lagged_mm != lagged_mm or lag_s <= 0.0:
            lagged_mm = x
        elif h > 0.0:
            behind = (x - last_mm) / h * lag_s
            lagged_mm = x - behind + (lagged_mm - last_mm + behind) * keep
        last_mm = x
        seen[i] = lagged_mm + noise_mm * noise
    return last_mm, lagged_mm, noise
