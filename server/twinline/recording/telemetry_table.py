"""The board's telemetry of a recording, as columns."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinline.arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class TelemetryLine:
    """One line, exactly as it was recorded; ``earlier_adc`` came with it, oldest first."""

    n: int
    host_time_s: float
    board_time_s: float
    cart_mm: float
    slide_mm: float
    adc: int
    flags: int
    earlier_adc: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class TelemetryTable:
    """Telemetry in the order in which it was recorded.

    Attributes
    ----------
    n, adc, flags : (k,) int arrays
    host_time_s, board_time_s : (k,) arrays
    cart_mm, slide_mm : (k,) arrays
    earlier_adc
        Samples between the line before and each line, oldest first.
    """

    n: IntArray
    host_time_s: FloatArray
    board_time_s: FloatArray
    cart_mm: FloatArray
    slide_mm: FloatArray
    adc: IntArray
    flags: IntArray
    earlier_adc: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, lines: Sequence[TelemetryLine]) -> "TelemetryTable":
        """Columns of lines."""
        return cls(
            np.array([line.n for line in lines], np.int64),
            np.array([line.host_time_s for line in lines], np.float64),
            np.array([line.board_time_s for line in lines], np.float64),
            np.array([line.cart_mm for line in lines], np.float64),
            np.array([line.slide_mm for line in lines], np.float64),
            np.array([line.adc for line in lines], np.int64),
            np.array([line.flags for line in lines], np.int64),
            tuple(line.earlier_adc for line in lines),
        )

    def __len__(self) -> int:
        return len(self.n)

    def line(self, index: int) -> TelemetryLine:
        """One line."""
        return TelemetryLine(
            int(self.n[index]),
            float(self.host_time_s[index]),
            float(self.board_time_s[index]),
            float(self.cart_mm[index]),
            float(self.slide_mm[index]),
            int(self.adc[index]),
            int(self.flags[index]),
            self.earlier_adc[index],
        )
