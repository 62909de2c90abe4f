"""The channels of a recording, and the schemas of those that hold JSON."""

import json
from typing import Literal, TypeAlias

PartName: TypeAlias = Literal[
    "laser", "laser/off", "reference", "camera", "motion", "sheets/on", "sheets/off", "heights", "heights/off"
]
"""The parts of a capture that hold pictures, named as the folders of a capture folder."""

PARTS: tuple[PartName, ...] = (
    "laser", "laser/off", "reference", "camera", "motion", "sheets/on", "sheets/off", "heights", "heights/off",
)  # fmt: skip

TELEMETRY, EVENT, LINK, TOF, NOTE = "/board/telemetry", "/board/event", "/board/link", "/tof/sample", "/note"


def image_topic(part: PartName) -> str:
    """Channel of pictures that the camera has encoded."""
    return f"/{part}/image"


def raw_topic(part: PartName) -> str:
    """Channel of pictures as plain pixels."""
    return f"/{part}/raw"


def frame_topic(part: PartName) -> str:
    """Channel of what is known about each picture."""
    return f"/{part}/frame"


def json_schema(topic: str) -> tuple[str, bytes]:
    """Name and JSON Schema of the messages on a channel.

    Parameters
    ----------
    topic
        One of the constants above, or a `frame_topic`.
    """
    kind = topic.strip("/").replace("/", "_") if topic in _FIELDS else "frame"
    fields = _FIELDS.get(topic, _FRAME)
    properties = {name: {"type": list(types), "description": text} for name, (types, text) in fields.items()}
    schema = {"type": "object", "title": f"twinline.{kind}", "properties": properties, "required": list(fields)}
    return f"twinline.{kind}", json.dumps(schema).encode()


_Fields: TypeAlias = dict[str, tuple[tuple[str, ...], str]]

_NUMBER, _WHOLE, _TEXT = ("number",), ("integer",), ("string",)
_HOST = (_NUMBER, "host time, seconds of the host's monotonic clock")
_BOARD = (_NUMBER, "the same by the board's own clock, seconds since its start")
_CART = (_NUMBER, "counted position of the cart, mm")
_SLIDE = (_NUMBER, "counted position of the slide, mm")

_FRAME: _Fields = {
    "name": (_TEXT, "file name of the picture"),
    "sequence": (_WHOLE, "the camera's number of the frame"),
    "host_time_s": (("number", "null"), "host time of the middle of the exposure, seconds"),
    "exposure_s": (("number", "null"), "length of the exposure, seconds; null if unknown"),
    "encoding": (_TEXT, "jpeg, png, gray8 or bgr8"),
    "width": (_WHOLE, "pixels; 0 if unknown"),
    "height": (_WHOLE, "pixels; 0 if unknown"),
    "dropped": (_WHOLE, "frames known to be lost so far"),
    "lasers": (("array", "null"), "numbers of the lasers that were on; null means all"),
    "cart_mm": (("number", "null"), "position of the cart where it is known otherwise than from telemetry, mm"),
    "height_mm": (("number", "null"), "height of the block in the picture, mm"),
    "off": (("string", "null"), "file name of the same view with the lasers off"),
    "bytes": (_WHOLE, "length of the picture's data"),
    "crc32": (_WHOLE, "CRC-32 of the picture's data"),
}
_FIELDS: dict[str, _Fields] = {
    TELEMETRY: {
        "n": (_WHOLE, "counts up by one from line to line"),
        "host_time_s": _HOST,
        "board_time_s": _BOARD,
        "cart_mm": _CART,
        "slide_mm": _SLIDE,
        "adc": (_WHOLE, "distance sensor, as the board sent it"),
        "flags": (_WHOLE, "lasers, movement, switches, latch"),
        "earlier_adc": (("array",), "samples between the line before and this one, oldest first"),
    },
    EVENT: {
        "n": (_WHOLE, "number of the event since the board's start"),
        "host_time_s": _HOST,
        "board_time_s": _BOARD,
        "kind": (_TEXT, "name of the event"),
        "cart_mm": _CART,
        "slide_mm": _SLIDE,
        "a": (_WHOLE, "detail, by kind"),
        "b": (_WHOLE, "detail, by kind"),
    },
    LINK: {
        "host_time_s": _HOST,
        "state": (_TEXT, "up, down or closed"),
        "reason": (_TEXT, "one sentence, or empty"),
    },
    TOF: {
        "time_s": (_NUMBER, "time of the reading, seconds"),
        "cart_mm": (_NUMBER, "commanded position of the cart, mm"),
        "slide_mm": (_NUMBER, "commanded position of the slide, mm"),
        "reading": (("number", "null"), "the reading; null where there was none"),
        "unit": (_TEXT, "adc, volts or distance_mm"),
    },
    NOTE: {
        "host_time_s": _HOST,
        "about": (_TEXT, "what the note is about"),
        "text": (_TEXT, "the note"),
    },
}
