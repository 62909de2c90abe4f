"""What the parts of a simulated machine tell each other: where everything truly is, and what the converter reads."""

from collections.abc import Callable
from typing import Protocol, TypeAlias

from twinline.arrays import FloatArray

AdcModel: TypeAlias = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""Distance sensor and converter: ``adc(cart_mm, slide_mm, host_time_s)`` with (n,) arrays gives (n,) counts.

The positions are the true ones at the times, which ascend, also from call to call. The board calls it for each line of
telemetry with its conversions since the last one, at 1 kHz, and averages. Counts are those of a 12-bit converter, 0 to
4095, and may have fractions.
"""


class MachineState(Protocol):
    """Where a machine truly is; the simulated camera and the distance sensor look at it.

    Answers hold for the present and for at least the 10 s before; earlier times give what was 10 s ago.
    """

    def cart_mm(self, host_time_s: float) -> float:
        """True position of the cart along its travel, mm, with the drive's errors."""
        ...

    def slide_mm(self, host_time_s: float) -> float:
        """True position of the slide, mm."""
        ...

    def lasers(self, host_time_s: float) -> frozenset[int]:
        """Numbers of the lasers that truly shine."""
        ...
