"""The simulated board's time: ticks of its timer, by a quartz that is a little off."""

import asyncio
from collections.abc import Callable

from twinline.devices.serial.codec import TIME_WRAP_US
from twinline.devices.serial.protocol_gen import TIMER_HZ

_TICKS_PER_US = TIMER_HZ // 1_000_000


class SimulatedClock:
    """Translates between the loop's time and the board's.

    Parameters
    ----------
    drift_ppm
        How much faster than the host's clock it runs, in parts per million.
    start_us
        What it shows when the board starts; near 2^32 the wrap comes soon.
    """

    def __init__(self, drift_ppm: float, start_us: int) -> None:
        self._loop = asyncio.get_running_loop()
        self._epoch_s = self._loop.time()
        self._ticks_per_s = TIMER_HZ * (1.0 + drift_ppm * 1e-6)
        self._start_us = start_us
        self._boot_ticks = 0

    def now(self) -> int:
        """Present time in ticks; these run on over restarts of the board."""
        return self.ticks_at(self._loop.time())

    def ticks_at(self, host_time_s: float) -> int:
        """Ticks of a host time."""
        return round((host_time_s - self._epoch_s) * self._ticks_per_s)

    def host_time_s(self, ticks: int) -> float:
        """Host time of ticks."""
        return self._epoch_s + ticks / self._ticks_per_s

    def shown_us(self, ticks: int) -> int:
        """What the board tells as the time, microseconds modulo 2^32."""
        return ((ticks - self._boot_ticks) // _TICKS_PER_US + self._start_us) % TIME_WRAP_US

    def restart(self) -> None:
        """The board starts again, and its time with it."""
        self._boot_ticks = self.now()

    def call_at(self, ticks: int, callback: Callable[[], None]) -> asyncio.TimerHandle:
        """Have something called when the time has come; `now` is then no less than ``ticks``."""
        # Rounding must not let the call come a tick too early.
        return self._loop.call_at(self.host_time_s(ticks + 1), callback)
