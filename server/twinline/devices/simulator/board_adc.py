"""The simulated board's converter: a thousand conversions a second, averaged for each reading."""

import numpy as np

from twinline.devices.serial.protocol_gen import (
    ADC_BROKEN_HIGH,
    ADC_BROKEN_LOW,
    ADC_CLIP_HIGH,
    ADC_CLIP_LOW,
    ADC_FULL_SCALE,
    TIMER_HZ,
    Flag,
)
from twinline.devices.simulator.axis import SimulatedAxis
from twinline.devices.simulator.board_clock import SimulatedClock
from twinline.devices.simulator.machine_state import AdcModel

_CONVERSION_TICKS = TIMER_HZ // 1000
_PER_COUNT = 16


class BoardAdc:
    """Readings of the distance sensor.

    Parameters
    ----------
    clock
        The board's time.
    cart, slide
        The axes that carry the sensor.
    model
        The sensor; without one the input reads as an open wire.
    """

    def __init__(
        self, clock: SimulatedClock, cart: SimulatedAxis, slide: SimulatedAxis, model: AdcModel | None
    ) -> None:
        self._clock = clock
        self._cart = cart
        self._slide = slide
        self._model = model
        self._read_ticks = -1
        self._last = ADC_FULL_SCALE

    def readings(self, ticks: int, samples: int, period_ticks: int) -> tuple[int, ...]:
        """Readings that divide the time since the line before, oldest first.

        Parameters
        ----------
        ticks
            Time of the last one.
        samples
            How many.
        period_ticks
            Time since the line before.
        """
        each = max(1, period_ticks // samples // _CONVERSION_TICKS)
        times = ticks - np.arange(each * samples)[::-1] * (period_ticks // (each * samples))
        values = self._convert(times)
        return tuple(self._mean(part) for part in np.split(values, samples))

    def now(self) -> int:
        """One reading of the present."""
        return self._mean(self._convert(np.array([self._clock.now()])))

    def flags(self) -> Flag:
        """What the last reading tells."""
        flags = Flag(0)
        if not ADC_CLIP_LOW <= self._last <= ADC_CLIP_HIGH:
            flags |= Flag.ADC_CLIPPED
        if not ADC_BROKEN_LOW <= self._last <= ADC_BROKEN_HIGH:
            flags |= Flag.ADC_BROKEN
        return flags

    def _convert(
        self, ticks: np.ndarray[tuple[int, ...], np.dtype[np.int64]]
    ) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        """(n,) counts of the 12-bit converter; NaN where the model was already asked about a later time."""
        values = np.full(len(ticks), np.nan)
        fresh = ticks > self._read_ticks
        if self._model is not None and fresh.any():
            times = [int(time) for time in ticks[fresh]]
            values[fresh] = self._model(
                np.array([self._cart.place_mm(time) for time in times]),
                np.array([self._slide.place_mm(time) for time in times]),
                np.array([self._clock.host_time_s(time) for time in times]),
            )
            self._read_ticks = times[-1]
        return values

    def _mean(self, counts: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> int:
        fresh = counts[~np.isnan(counts)]
        if len(fresh):
            self._last = min(max(round(float(fresh.mean()) * _PER_COUNT), 0), ADC_FULL_SCALE)
        return self._last
