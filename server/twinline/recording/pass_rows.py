"""Rows of a recording from the messages of its container; a message that makes no sense raises.

Errors are ValueError, KeyError, TypeError or OverflowError: whoever reads a recording counts such messages.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import cast, get_args

from twinline.geometry.nominal import TofUnit
from twinline.recording import foxglove
from twinline.recording.container_walk import Located
from twinline.recording.stored import StoredAt, StoredEncoding, StoredPicture
from twinline.recording.telemetry_table import TelemetryLine
from twinline.recording.topics import PartName

_ENCODINGS: tuple[StoredEncoding, ...] = get_args(StoredEncoding)
_UNITS: tuple[TofUnit, ...] = get_args(TofUnit)


@dataclass(frozen=True, slots=True)
class RecordedFrame:
    """A frame of a recording; ``picture`` says where its bytes are, the rest is as in `pass_messages.Picture`."""

    sequence: int
    host_time_s: float
    exposure_s: float | None
    dropped: int
    lasers: frozenset[int] | None
    cart_mm: float | None
    height_mm: float | None
    off: str | None
    picture: StoredPicture


@dataclass(frozen=True, slots=True)
class RecordedEvent:
    """An event of the board; ``kind`` is the name of its kind."""

    n: int
    host_time_s: float
    board_time_s: float
    kind: str
    cart_mm: float
    slide_mm: float
    a: int
    b: int


@dataclass(frozen=True, slots=True)
class RecordedLink:
    """The connection to the board came up or went down."""

    host_time_s: float
    state: str
    reason: str


@dataclass(frozen=True, slots=True)
class RecordedNote:
    """A note."""

    host_time_s: float
    about: str
    text: str


@dataclass(frozen=True, slots=True)
class RecordedTof:
    """A reading of the distance sensor that came with its own position; NaN where there was none."""

    time_s: float
    cart_mm: float
    slide_mm: float
    reading: float
    unit: TofUnit


def message_fields(message: Located) -> dict[str, object]:
    """The fields of a message in JSON; TypeError or ValueError if it has none."""
    value = json.loads(message.data)
    if not isinstance(value, dict):
        raise TypeError("no object")
    return cast("dict[str, object]", value)


def picture_extent(message: Located) -> foxglove.Extent | None:
    """Where in the file the picture's own bytes lie; None if the message does not say."""
    if message.schema not in {foxglove.COMPRESSED, foxglove.RAW}:
        return None
    extent = foxglove.find_data(message.schema, message.data)
    if extent is None or extent.offset + extent.length > message.length:
        return None
    return foxglove.Extent(message.offset + extent.offset, extent.length)


def parse_frame(path: Path, part: PartName, row: dict[str, object], extent: foxglove.Extent) -> RecordedFrame:
    """What is known of a frame whose picture lies at ``extent``."""
    encoding = next(e for e in _ENCODINGS if e == row["encoding"]) if row["encoding"] in _ENCODINGS else None
    name = _text(row, "name")
    if encoding is None or _whole(row, "bytes") != extent.length or "/" in name or "\\" in name or name in {"", ".."}:
        raise ValueError("no usable frame")
    size = (_whole(row, "width"), _whole(row, "height"))
    at = StoredAt(extent.offset, extent.length, _whole(row, "crc32"), encoding, size)
    lasers = row["lasers"]
    time_s = _maybe(row, "host_time_s")
    return RecordedFrame(
        _whole(row, "sequence"),
        math.nan if time_s is None else time_s,
        _maybe(row, "exposure_s"),
        _whole(row, "dropped"),
        None if lasers is None else frozenset(int(number) for number in cast("list[int]", lasers)),
        _maybe(row, "cart_mm"),
        _maybe(row, "height_mm"),
        None if row["off"] is None else _text(row, "off"),
        StoredPicture(path, part, name, at),
    )


def parse_telemetry(row: dict[str, object]) -> TelemetryLine:
    """A line of telemetry."""
    earlier = tuple(int(value) for value in cast("list[int]", row["earlier_adc"]))
    times = (_number(row, "host_time_s"), _number(row, "board_time_s"))
    places = (_number(row, "cart_mm"), _number(row, "slide_mm"))
    return TelemetryLine(_whole(row, "n"), *times, *places, _whole(row, "adc"), _whole(row, "flags"), earlier)


def parse_event(row: dict[str, object]) -> RecordedEvent:
    """An event of the board."""
    times = (_number(row, "host_time_s"), _number(row, "board_time_s"))
    places = (_number(row, "cart_mm"), _number(row, "slide_mm"))
    return RecordedEvent(_whole(row, "n"), *times, _text(row, "kind"), *places, _whole(row, "a"), _whole(row, "b"))


def parse_link(row: dict[str, object]) -> RecordedLink:
    """A change of the connection."""
    return RecordedLink(_number(row, "host_time_s"), _text(row, "state"), _text(row, "reason"))


def parse_note(row: dict[str, object]) -> RecordedNote:
    """A note."""
    return RecordedNote(_number(row, "host_time_s"), _text(row, "about"), _text(row, "text"))


def parse_tof(row: dict[str, object]) -> RecordedTof:
    """A reading of the distance sensor."""
    unit = next(u for u in _UNITS if u == row["unit"]) if row["unit"] in _UNITS else None
    if unit is None:
        raise ValueError("no usable unit")
    reading = _maybe(row, "reading")
    places = (_number(row, "cart_mm"), _number(row, "slide_mm"))
    return RecordedTof(_number(row, "time_s"), *places, math.nan if reading is None else reading, unit)


def _number(row: dict[str, object], name: str) -> float:
    value = row[name]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ValueError(name)
    return float(value)


def _maybe(row: dict[str, object], name: str) -> float | None:
    return None if row[name] is None else _number(row, name)


def _whole(row: dict[str, object], name: str) -> int:
    value = row[name]
    if isinstance(value, bool) or not isinstance(value, int):
        raise TypeError(name)
    return value


def _text(row: dict[str, object], name: str) -> str:
    value = row[name]
    if not isinstance(value, str):
        raise TypeError(name)
    return value
