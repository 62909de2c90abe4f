"""Small recordings that tests make, cut off and damage."""

import json
import math
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tests.unit.recording.sample_captures import SIZE, description, picture
from twinline.recording.pass_header import PassHeader, PassKind
from twinline.recording.pass_writer import PassWriter
from twinline.recording.stored import StoredEncoding
from twinline.recording.telemetry_table import TelemetryLine

FRAME_S = 0.04
LINE_S = 0.01
SPEED_MM_S = 25.0
START_S = 100.0
OFFSET_S = 7.25
"""Host time less board time."""


@dataclass(frozen=True)
class Shot:
    """A frame as a camera delivers it."""

    sequence: int
    host_time_s: float
    exposure_s: float | None
    encoding: StoredEncoding
    data: bytes
    image_size: tuple[int, int]
    dropped: int = 0


class Kind(StrEnum):
    """Kinds of events."""

    SCAN_START = "scan-start"
    MOTION_END = "motion-end"


@dataclass(frozen=True)
class Happening:
    """An event as a board tells it."""

    n: int
    host_time_s: float
    board_time_s: float
    kind: Kind
    cart_mm: float
    slide_mm: float
    a: int = 0
    b: int = 0


@dataclass(frozen=True)
class Link:
    """A connection that came or went."""

    host_time_s: float
    state: str
    reason: str


def header(kind: PassKind = "laser", **changes: Any) -> PassHeader:
    """The head of a recording of the scanner that `description` describes."""
    given: dict[str, Any] = {
        "kind": kind,
        "capture": json.dumps(description()),
        "scan_id": "s-1",
        "host_time_s": START_S,
    }
    return PassHeader(**(given | changes))


def jpeg(number: int) -> bytes:
    """A numbered picture, as a camera encodes it."""
    encoded, data = cv2.imencode(".jpg", picture(number))
    assert encoded
    return bytes(data.tobytes())


def shot(number: int, encoding: StoredEncoding = "jpeg") -> Shot:
    """A numbered frame, `FRAME_S` after the one before."""
    pixels = picture(number)
    if encoding == "gray8":
        data = pixels[:, :, 0].tobytes()
    elif encoding == "bgr8":
        # Three different channels, so that an exchange of two is noticed.
        data = np.stack([pixels[:, :, 0], pixels[:, :, 0] // 2, pixels[:, :, 0] // 4], axis=2).tobytes()
    else:
        data = jpeg(number)
    return Shot(number, START_S + FRAME_S * number, 0.004, encoding, data, SIZE)


def line(number: int, **changes: Any) -> TelemetryLine:
    """A line of telemetry of a cart at `SPEED_MM_S`, `LINE_S` after the one before."""
    time_s = LINE_S * number
    given: dict[str, Any] = {
        "n": number, "host_time_s": START_S + time_s, "board_time_s": START_S + time_s - OFFSET_S,
        "cart_mm": SPEED_MM_S * time_s, "slide_mm": 0.5 * time_s, "adc": 100 + number, "flags": 3,
    }  # fmt: skip
    return TelemetryLine(**(given | changes))


def write_recording(path: Path, frames: int = 10, **changes: Any) -> Path:
    """Write a laser pass of numbered frames with telemetry around them."""
    with PassWriter(path, header(**changes)) as writer:
        writer.link(Link(START_S, "up", ""))
        writer.event(Happening(0, START_S, START_S - OFFSET_S, Kind.SCAN_START, 0.0, 0.0, a=1))
        for number in range(math.ceil(frames * FRAME_S / LINE_S) + 3):
            writer.telemetry(line(number))
            if number % 4 == 0 and number // 4 < frames:
                writer.frame(shot(number // 4))
        end_s = START_S + frames * FRAME_S
        writer.event(Happening(1, end_s, end_s - OFFSET_S, Kind.MOTION_END, 1.0, 0.0, a=1, b=0))
    return path
