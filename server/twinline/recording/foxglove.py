"""Pictures as other tools read them: ``foxglove.CompressedImage`` and ``foxglove.RawImage`` in protobuf's wire format.

Field numbers are those of the published schemas (foxglove-sdk, schemas/proto/foxglove). Only what these two messages
need of the wire format is here: varints, fixed 32-bit numbers, and fields with a length.
"""

import struct
from typing import NamedTuple

COMPRESSED = "foxglove.CompressedImage"
RAW = "foxglove.RawImage"

HEAD_BYTES = 128
"""So many bytes of a message hold everything before the picture's own bytes."""

_VARINT, _LENGTH, _FIXED32 = 0, 2, 5
_TYPE_INT64, _TYPE_INT32, _TYPE_FIXED32, _TYPE_STRING, _TYPE_MESSAGE, _TYPE_BYTES = 3, 5, 7, 9, 11, 12
_NS = 1_000_000_000
_DATA_FIELD = {COMPRESSED: 2, RAW: 6}
_TIMESTAMP = ".google.protobuf.Timestamp"
_FIELDS = {
    COMPRESSED: (
        ("timestamp", 1, _TYPE_MESSAGE, _TIMESTAMP),
        ("data", 2, _TYPE_BYTES, ""),
        ("format", 3, _TYPE_STRING, ""),
        ("frame_id", 4, _TYPE_STRING, ""),
    ),
    RAW: (
        ("timestamp", 1, _TYPE_MESSAGE, _TIMESTAMP),
        ("width", 2, _TYPE_FIXED32, ""),
        ("height", 3, _TYPE_FIXED32, ""),
        ("encoding", 4, _TYPE_STRING, ""),
        ("step", 5, _TYPE_FIXED32, ""),
        ("data", 6, _TYPE_BYTES, ""),
        ("frame_id", 7, _TYPE_STRING, ""),
    ),
}


class Extent(NamedTuple):
    """Where the picture's own bytes lie in a message."""

    offset: int
    length: int


def compressed_image(time_ns: int, data: bytes, kind: str, frame_id: str) -> bytes:
    """A ``CompressedImage``; ``kind`` is ``jpeg`` or ``png``."""
    return b"".join((_timestamp(time_ns), _head(2, len(data)), data, _text(3, kind), _text(4, frame_id)))


def raw_image(time_ns: int, data: bytes, size: tuple[int, int], encoding: str, frame_id: str) -> bytes:
    """A ``RawImage`` of rows without padding; ``encoding`` is ``mono8`` or ``bgr8``."""
    width, height = size
    numbers = (_fixed(2, width), _fixed(3, height), _text(4, encoding), _fixed(5, len(data) // height))
    return b"".join((_timestamp(time_ns), *numbers, _head(6, len(data)), data, _text(7, frame_id)))


def find_data(schema: str, head: bytes) -> Extent | None:
    """Where the picture's bytes lie, from the first `HEAD_BYTES` of a message; None if they do not say.

    Parameters
    ----------
    schema
        `COMPRESSED` or `RAW`.
    """
    position = 0
    try:
        while position < len(head):
            tag, position = _read_varint(head, position)
            field, kind = tag >> 3, tag & 7
            if kind == _FIXED32:
                position += 4
            elif kind == _VARINT:
                _, position = _read_varint(head, position)
            elif kind == _LENGTH:
                length, position = _read_varint(head, position)
                if field == _DATA_FIELD[schema]:
                    return Extent(position, length)
                position += length
            else:
                return None
    except IndexError:
        return None
    return None


def schema_of(name: str) -> bytes:
    """The schema as a ``FileDescriptorSet``, with the one of the time stamp that it needs."""
    file = name.replace(".", "/") + ".proto"
    stamp_file = "google/protobuf/timestamp.proto"
    stamp = _file(
        stamp_file,
        "google.protobuf",
        _message("Timestamp", (("seconds", 1, _TYPE_INT64, ""), ("nanos", 2, _TYPE_INT32, ""))),
    )
    package, message = name.rsplit(".", 1)
    return _bytes(1, stamp) + _bytes(1, _file(file, package, _message(message, _FIELDS[name]), stamp_file))


def _timestamp(time_ns: int) -> bytes:
    seconds, nanos = divmod(time_ns, _NS)
    # Zero is what a missing number means, and is not written.
    body = (b"\x08" + _varint(seconds) if seconds else b"") + (b"\x10" + _varint(nanos) if nanos else b"")
    return _bytes(1, body)


def _message(name: str, fields: tuple[tuple[str, int, int, str], ...]) -> bytes:
    """A ``DescriptorProto`` with optional fields."""
    parts = [_text(1, name)]
    for field, number, kind, type_name in fields:
        body = _text(1, field) + _number(3, number) + _number(4, 1) + _number(5, kind)
        parts.append(_bytes(2, body + (_text(6, type_name) if type_name else b"")))
    return b"".join(parts)


def _file(name: str, package: str, message: bytes, *dependencies: str) -> bytes:
    """A ``FileDescriptorProto`` in the third version of the language."""
    needs = b"".join(_text(3, dependency) for dependency in dependencies)
    return _text(1, name) + _text(2, package) + needs + _bytes(4, message) + _text(12, "proto3")


def _bytes(field: int, data: bytes) -> bytes:
    return _head(field, len(data)) + data


def _text(field: int, text: str) -> bytes:
    return _bytes(field, text.encode())


def _head(field: int, length: int) -> bytes:
    return _varint(field << 3 | _LENGTH) + _varint(length)


def _number(field: int, value: int) -> bytes:
    return _varint(field << 3 | _VARINT) + _varint(value)


def _fixed(field: int, value: int) -> bytes:
    return _varint(field << 3 | _FIXED32) + struct.pack("<I", value)


def _varint(value: int) -> bytes:
    parts = bytearray()
    while value > 0x7F:
        parts.append(value & 0x7F | 0x80)
        value >>= 7
    parts.append(value)
    return bytes(parts)


def _read_varint(data: bytes, position: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[position]
        value |= (byte & 0x7F) << shift
        position, shift = position + 1, shift + 7
        if byte < 0x80:
            return value, position
        if shift > 63:
            raise IndexError("a number of more than 64 bits")
