"""The simulated board's laser outputs, now and in the recent past."""

from collections import deque
from dataclasses import dataclass

from twinline.devices.serial.protocol_gen import TIMER_HZ

_REMEMBERED_TICKS = 15 * TIMER_HZ


@dataclass(frozen=True)
class _Light:
    begin_ticks: int
    masks: tuple[int, ...]
    phase_ticks: int

    def mask(self, ticks: int) -> int:
        if len(self.masks) == 1:
            return self.masks[0]
        return self.masks[(ticks - self.begin_ticks) // self.phase_ticks % len(self.masks)]


class LaserOutputs:
    """What the board switches on; masks have bit 0 for laser 1 and bit 1 for laser 2."""

    def __init__(self) -> None:
        self._lights: deque[_Light] = deque([_Light(0, (0,), 1)])

    def mask(self, ticks: int) -> int:
        """Outputs at a time."""
        for light in reversed(self._lights):
            if light.begin_ticks <= ticks:
                return light.mask(ticks)
        return self._lights[0].mask(ticks)

    @property
    def dark(self) -> bool:
        """Whether nothing shines, nor will in a later phase."""
        return not any(self._lights[-1].masks)

    def switch(self, mask: int, ticks: int) -> None:
        """Switch to steady light."""
        self.alternate((mask,), 1, ticks)

    def alternate(self, masks: tuple[int, ...], phase_ticks: int, ticks: int) -> None:
        """Let several states take turns."""
        self._lights.append(_Light(ticks, masks, phase_ticks))
        while len(self._lights) > 1 and self._lights[1].begin_ticks < ticks - _REMEMBERED_TICKS:
            self._lights.popleft()
