"""Readings of the point distance sensor: ``tof/samples.csv``."""

from array import array
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twinline.arrays import FloatArray
from twinline.errors import CaptureError
from twinline.geometry.nominal import TofUnit
from twinline.recording.capture_json import TofNominal
from twinline.recording.csv_table import Row, parse_number, read_table

_UNITS: tuple[TofUnit, ...] = ("adc", "volts", "distance_mm")
# A reading at the very end of the range may come out of the conversion a rounding error beyond it.
_ROUNDING_MM = 1e-6


@dataclass(frozen=True, eq=False)
class TofSamples:
    """A ToF pass.

    Attributes
    ----------
    time_s, cart_mm, slide_mm : (n,) arrays
        Time and commanded positions.
    reading : (n,) array
        As recorded, in ``unit``; NaN where there was no valid reading.
    unit
        What ``reading`` holds: ADC counts, volts or millimetres.
    distance_mm : (n,) array
        Distance by the nominal characteristic of ``capture.json``; NaN where the reading is absent or out of range.
    """

    time_s: FloatArray
    cart_mm: FloatArray
    slide_mm: FloatArray
    reading: FloatArray
    unit: TofUnit
    distance_mm: FloatArray

    def __len__(self) -> int:
        return len(self.time_s)


def tof_line(nominal: TofNominal, unit: TofUnit) -> tuple[float, float]:
    """Gain and offset of ``distance_mm = offset + gain * reading``.

    The shortest distance belongs to code 0 and to the first of ``volts``, the longest to the last code and to the
    second of ``volts``; the volts may descend.

    Raises
    ------
    CaptureError
        If ``capture.json`` lacks the field that this unit needs.
    """
    if unit == "distance_mm":
        return 1.0, 0.0
    if unit == "volts":
        if nominal.volts is None:
            raise CaptureError("The ToF readings are in volts, but capture.json has no tof.volts; add [volts, volts].")
        low, high = nominal.volts
    else:
        if nominal.adc_counts is None:
            raise CaptureError("The ToF readings are ADC counts, but capture.json has no tof.adc_counts; add it.")
        low, high = 0.0, nominal.adc_counts - 1.0
    shortest, longest = nominal.range_mm
    gain = (longest - shortest) / (high - low)
    return gain, shortest - gain * low


def reading_unit(path: Path) -> TofUnit:
    """Which of ``adc``, ``volts`` and ``distance_mm`` a ``samples.csv`` holds, from its first line.

    Raises
    ------
    CaptureError
        If the file cannot be read, or holds none or several of them.
    """
    try:
        with path.open(encoding="utf-8-sig") as stream:
            header = [cell.strip() for cell in stream.readline(10_000).split(",")]
    except (OSError, UnicodeDecodeError) as error:
        raise CaptureError(f"{path} cannot be read as a text file: {error}.") from error
    units = [unit for unit in _UNITS if unit in header]
    if len(units) != 1:
        found = " and ".join(units) if units else "none"
        raise CaptureError(f"{path} must have exactly one of the columns {', '.join(_UNITS)}; it has {found}.")
    return units[0]


@dataclass(frozen=True, eq=False)
class TofTable:
    """Readings as they stand in the table, valid or not; NaN only where there is none. Arrays are (n,)."""

    time_s: FloatArray
    cart_mm: FloatArray
    slide_mm: FloatArray
    reading: FloatArray
    unit: TofUnit

    def samples(self, nominal: TofNominal) -> TofSamples:
        """The readings with their distances; those outside the sensor's range become NaN, their rows stay.

        Raises
        ------
        CaptureError
            If ``capture.json`` lacks the field that the unit needs.
        """
        gain, offset = tof_line(nominal, self.unit)
        reading = self.reading.copy()
        distance = offset + gain * reading
        shortest, longest = nominal.range_mm
        invalid = ~((distance >= shortest - _ROUNDING_MM) & (distance <= longest + _ROUNDING_MM))
        reading[invalid] = np.nan
        distance[invalid] = np.nan
        return TofSamples(self.time_s, self.cart_mm, self.slide_mm, reading, self.unit, distance)


def read_tof(path: Path, nominal: TofNominal) -> TofSamples:
    """Read a ToF pass.

    Empty and NaN readings, and readings outside the sensor's range, become NaN; their rows stay.

    Raises
    ------
    CaptureError
        If the table is malformed, empty, or runs backwards in time; names the file and the line.
    """
    unit = reading_unit(path)
    # A description that lacks what the unit needs is said before a long table is read.
    tof_line(nominal, unit)
    return read_tof_table(path).samples(nominal)


def read_tof_table(path: Path) -> TofTable:
    """Read a ToF pass as it stands in the file.

    Raises
    ------
    CaptureError
        As `read_tof`.
    """
    unit = reading_unit(path)
    columns = [array("d") for _ in range(4)]
    for row in read_table(path, ("time_s", "cart_mm", "slide_mm", unit)):
        time_s = row.number("time_s")
        if columns[0] and time_s < columns[0][-1]:
            raise row.error(f"time_s runs backwards, from {columns[0][-1]:g} s to {time_s:g} s.")
        values = (time_s, row.number("cart_mm"), row.number("slide_mm"), _reading(row, unit))
        for column, value in zip(columns, values, strict=True):
            column.append(value)
    if not columns[0]:
        raise CaptureError(f"{path} holds no samples; write one line per reading below the header.")
    time, cart, slide, reading = (np.array(column, dtype=np.float64) for column in columns)
    return TofTable(time, cart, slide, reading, unit)


def _reading(row: Row, unit: TofUnit) -> float:
    text = row.cells[unit]
    if not text or text.lower() == "nan":
        return float("nan")
    number = parse_number(text)
    if number is None:
        raise row.error(f"{unit} must be a number, empty or NaN, not {text[:40]!r}.")
    return number
