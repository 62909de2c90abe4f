"""As much of JPEG as is needed to hand pictures on without decoding them."""

import re

START = b"\xff\xd8"
END = b"\xff\xd9"
# Inside the coded data FF is followed by 00 (a plain FF), by a restart marker, or by fill bytes.
_MARKER = re.compile(rb"\xff[^\x00\x01\xd0-\xd7\xff]")
_FRAME_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_START_OF_ANOTHER = 0xD8
_END_MARKERS = frozenset({0xD9})


def jpeg_size(data: bytes | bytearray) -> tuple[int, int] | None:
    """Width and height in pixels that the header states; None if this is no JPEG or the header is cut off."""
    found = _walk(data, _FRAME_MARKERS)
    if found is None or len(data) < found + 7:
        return None
    height, width = data[found + 3 : found + 5], data[found + 5 : found + 7]
    size = int.from_bytes(width, "big"), int.from_bytes(height, "big")
    return size if min(size) > 0 else None


def is_whole_jpeg(data: bytes | bytearray) -> bool:
    """Whether size and end of the picture are there, also if a camera appended something to it."""
    return jpeg_size(data) is not None and _walk(data, _END_MARKERS) is not None


def _walk(data: bytes | bytearray, wanted: frozenset[int]) -> int | None:
    """Place after the first of the wanted markers of the picture itself, not of a preview embedded in it."""
    if not data.startswith(START):
        return None
    position = len(START)
    while match := _MARKER.search(data, position):
        after = match.end()
        if data[after - 1] in wanted:
            return after
        if data[after - 1] == _START_OF_ANOTHER:
            return None
        position = after + max(int.from_bytes(data[after : after + 2], "big"), 2)
    return None
