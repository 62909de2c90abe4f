"""What a pass writes down: frames, telemetry, events; each as the bytes that go into the container."""

import json
import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath

from twinline.recording import foxglove
from twinline.recording.delivered import BoardHappening, BoardSample, LinkReport
from twinline.recording.stored import StoredEncoding
from twinline.recording.topics import (
    EVENT,
    LINK,
    NOTE,
    TELEMETRY,
    TOF,
    PartName,
    frame_topic,
    image_topic,
    raw_topic,
)

_NS = 1_000_000_000
_RAW_ENCODINGS = {"gray8": "mono8", "bgr8": "bgr8"}
_BYTES_PER_PIXEL = {"gray8": 1, "bgr8": 3}
_MOST_NS = 2**63


@dataclass(frozen=True, slots=True)
class Message:
    """One message, ready to be written."""

    topic: str
    time_ns: int
    sequence: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture and what is known about it.

    Attributes
    ----------
    number
        Place in its part, from 0.
    name
        File name; plain, without folders.
    host_time_s
        Host time of the middle of the exposure; NaN where unknown.
    lasers
        Lasers that were on; None means all.
    cart_mm
        Position of the cart, where it is known otherwise than from telemetry.
    height_mm, off
        For blocks of known height: the height, and the name of the same view with the lasers off.
    """

    part: PartName
    number: int
    name: str
    encoding: StoredEncoding
    data: bytes
    image_size: tuple[int, int]
    host_time_s: float
    sequence: int
    exposure_s: float | None = None
    dropped: int = 0
    lasers: frozenset[int] | None = None
    cart_mm: float | None = None
    height_mm: float | None = None
    off: str | None = None

    def messages(self) -> tuple[Message, Message]:
        """The picture for other tools to show, then what is known about it: where the second is, the first is whole."""
        time_ns = to_ns(self.host_time_s)
        if self.encoding in _RAW_ENCODINGS:
            topic, encoding = raw_topic(self.part), _RAW_ENCODINGS[self.encoding]
            image = foxglove.raw_image(time_ns, self.data, self.image_size, encoding, "camera")
        else:
            topic, image = (
                image_topic(self.part),
                foxglove.compressed_image(time_ns, self.data, self.encoding, "camera"),
            )
        return (
            Message(topic, time_ns, self.number, image),
            Message(frame_topic(self.part), time_ns, self.number, _json(self._fields())),
        )

    def _fields(self) -> dict[str, object]:
        return {
            "name": self.name,
            "sequence": self.sequence,
            "host_time_s": self.host_time_s if math.isfinite(self.host_time_s) else None,
            "exposure_s": self.exposure_s,
            "encoding": self.encoding,
            "width": self.image_size[0],
            "height": self.image_size[1],
            "dropped": self.dropped,
            "lasers": None if self.lasers is None else sorted(self.lasers),
            "cart_mm": self.cart_mm,
            "height_mm": self.height_mm,
            "off": self.off,
            "bytes": len(self.data),
            "crc32": zlib.crc32(self.data),
        }

    def check(self) -> None:
        """Make sure that the picture can be read again.

        Raises
        ------
        ValueError
            If there are more or fewer pixels than the size says, or the name is no plain file name.
        """
        width, height = self.image_size
        per_pixel = _BYTES_PER_PIXEL.get(self.encoding)
        if per_pixel and (len(self.data) != per_pixel * width * height or not self.data):
            raise ValueError(f"{len(self.data)} bytes are not {width} x {height} pixels of {self.encoding}")
        if PurePosixPath(self.name).name != self.name or not self.name or "\\" in self.name:
            raise ValueError(f"{self.name!r} is no plain file name")


def suffix_of(encoding: StoredEncoding) -> str:
    """Ending of the name of such a picture; plain pixels leave a recording as PNG."""
    return ".jpg" if encoding == "jpeg" else ".png"


def telemetry_message(sample: BoardSample) -> Message:
    """A line of telemetry."""
    fields = {
        "n": sample.n,
        "host_time_s": float(sample.host_time_s),
        "board_time_s": float(sample.board_time_s),
        "cart_mm": float(sample.cart_mm),
        "slide_mm": float(sample.slide_mm),
        "adc": int(sample.adc),
        "flags": int(sample.flags),
        "earlier_adc": list(sample.earlier_adc),
    }
    return Message(TELEMETRY, to_ns(sample.host_time_s), sample.n & 0xFFFFFFFF, _json(fields))


def event_message(event: BoardHappening) -> Message:
    """An event of the board."""
    fields = {
        "n": event.n,
        "host_time_s": float(event.host_time_s),
        "board_time_s": float(event.board_time_s),
        "kind": str(event.kind.value),
        "cart_mm": float(event.cart_mm),
        "slide_mm": float(event.slide_mm),
        "a": event.a,
        "b": event.b,
    }
    return Message(EVENT, to_ns(event.host_time_s), event.n & 0xFFFFFFFF, _json(fields))


def link_message(change: LinkReport) -> Message:
    """A change of the connection to the board."""
    fields = {"host_time_s": float(change.host_time_s), "state": change.state, "reason": change.reason}
    return Message(LINK, to_ns(change.host_time_s), 0, _json(fields))


def note_message(host_time_s: float, about: str, text: str) -> Message:
    """A note."""
    return Message(NOTE, to_ns(host_time_s), 0, _json({"host_time_s": host_time_s, "about": about, "text": text}))


def tof_message(time_s: float, cart_mm: float, slide_mm: float, reading: float | None, unit: str) -> Message:
    """A reading of the distance sensor that came with its own position."""
    fields = {"time_s": time_s, "cart_mm": cart_mm, "slide_mm": slide_mm, "reading": reading, "unit": unit}
    return Message(TOF, to_ns(time_s), 0, _json(fields))


def to_ns(time_s: float) -> int:
    """Seconds as the container's whole nanoseconds; 0 for what is no time."""
    return min(round(time_s * _NS), _MOST_NS) if math.isfinite(time_s) and time_s > 0 else 0


def _json(fields: Mapping[str, object]) -> bytes:
    return json.dumps(fields, separators=(",", ":"), allow_nan=False).encode()
