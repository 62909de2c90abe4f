"""Reading pictures as measurements: as stored, complete, in 8 bits."""

import re
from pathlib import Path, PurePath
from typing import NamedTuple, Protocol

import cv2
import numpy as np
import simplejpeg

from twinline.arrays import ByteArray
from twinline.errors import FrameError

PICTURE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg"})
"""Names (in small letters) by which pictures in a folder are recognised."""

_PNG_START = b"\x89PNG\r\n\x1a\n"
_PNG_END = b"IEND\xaeB`\x82"
_JPEG_START = b"\xff\xd8"
_JPEG_END = b"\xff\xd9"
# Inside the coded data of a JPEG, FF is followed by 00 (a plain FF), by a restart marker, or by fill bytes.
_JPEG_MARKER = re.compile(rb"\xff[^\x00\x01\xd0-\xd7\xff]")
_JPEG_FRAME_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_HEADER_BYTES = 4096
_COLOURS = {1: "GRAY", 3: "BGR"}
"""What a JPEG of so many components is decoded to."""


class PictureFile(Protocol):
    """A picture that can be read as a whole: the path of a file, or a picture in a recording."""

    @property
    def name(self) -> str:
        """Name of the file."""
        ...

    @property
    def stem(self) -> str:
        """The name without its ending."""
        ...

    @property
    def parent(self) -> PurePath:
        """The folder, or the part of the capture, that it is in."""
        ...

    def read_bytes(self) -> bytes:
        """The whole file; OSError where that is not possible."""
        ...

    def __hash__(self) -> int: ...


def read_image(path: PictureFile, expected_size: tuple[int, int] | None = None) -> ByteArray:
    """Read a picture as the camera stored it.

    Rotation hints in the file (EXIF) are not applied, since lens and stripes belong to the sensor's own axes. Pictures
    of 16 bits are reduced to 8 by dividing full scale by full scale (65535 becomes 255), the same for every picture.

    Parameters
    ----------
    expected_size
        Width and height in pixels that the picture must have; any where not given.

    Returns
    -------
    (h, w) or (h, w, 3) uint8 array
        Grey pictures stay grey; colour is blue, green, red; transparency is dropped.

    Raises
    ------
    FrameError
        If the file is missing, no picture, truncated or damaged, of another size, or does not hold 8 or 16 bits per
        channel.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise FrameError(f"{path} cannot be read: {error.strerror or error}.") from error
    # Looked at before decoding: a header may claim any number of pixels.
    header = _header_of(data)
    _require_size(path, header and header.size, expected_size)
    reason = _incomplete(data)
    if reason:
        raise FrameError(f"{path} {reason}.")
    image = _decode_jpeg(data, header)
    if image is None:
        image = _decode(data, path)
    _require_size(path, (image.shape[1], image.shape[0]), expected_size)
    return image


def _require_size(path: PictureFile, size: tuple[int, int] | None, expected: tuple[int, int] | None) -> None:
    if size and expected and size != expected:
        raise FrameError(f"{path} is {size[0]} x {size[1]} px, not {expected[0]} x {expected[1]} px.")


def _decode_jpeg(data: bytes, header: "_Header | None") -> ByteArray | None:
    """Pixels of a sound JPEG of one or three components; None for everything else.

    The same library and the same pixels as OpenCV's decoder, in less than half its time for colour.
    """
    colorspace = _COLOURS.get(header.components) if header else None
    if colorspace is None:
        return None
    try:
        image = simplejpeg.decode_jpeg(data, colorspace)
    except ValueError:
        # It takes offence at whatever departs from the standard; whether that hurts is for the other to say.
        return None
    return np.asarray(image[:, :, 0] if image.shape[2] == 1 else image, dtype=np.uint8)


def _decode(data: bytes, path: PictureFile) -> ByteArray:
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise FrameError(f"{path} is not a picture that can be decoded ({error.err}).") from error
    if image is None:
        raise FrameError(f"{path} is not a picture, or its data are damaged.")
    if image.dtype == np.uint16:
        image = ((image.astype(np.uint32) + 128) // 257).astype(np.uint8)
    if image.dtype != np.uint8:
        raise FrameError(f"{path} holds {image.dtype} values; save it with 8 or 16 bits per channel.")
    if image.ndim == 3 and image.shape[2] == 4:
        image = np.ascontiguousarray(image[:, :, :3])
    if image.ndim == 3 and image.shape[2] != 3:
        raise FrameError(f"{path} has {image.shape[2]} channels; save it as a grey or a colour picture.")
    return np.asarray(image, dtype=np.uint8)


def picture_size(path: Path) -> tuple[int, int]:
    """Width and height of a picture in pixels, from its first few bytes for PNG and JPEG.

    Raises
    ------
    FrameError
        If the file cannot be read or no size is found in it.
    """
    try:
        with path.open("rb", buffering=0) as stream:
            data = stream.read(_HEADER_BYTES)
            header = _header_of(data)
            if header is None and len(data) == _HEADER_BYTES and data.startswith(_JPEG_START):
                # Embedded previews and colour profiles can push the frame header far back.
                data += stream.read()
                header = _header_of(data)
    except OSError as error:
        raise FrameError(f"{path} cannot be read: {error.strerror or error}.") from error
    if header is None and data.startswith((_JPEG_START, _PNG_START)):
        raise FrameError(f"{path} is truncated: it ends before its size is given.")
    if header is None:
        image = read_image(path)
        return image.shape[1], image.shape[0]
    return header.size


def _incomplete(data: bytes) -> str | None:
    """What is missing of a PNG or JPEG, in words; None if nothing is, or for another kind of file.

    Decoders fill what is missing with grey, which is a measurement of nothing.
    """
    if not data:
        return "is empty (0 bytes)"
    truncated = f"is truncated: its data end after {len(data)} bytes, before the end of the picture"
    if data.startswith(_PNG_START):
        return None if data.endswith(_PNG_END) or _PNG_END in data else truncated
    if data.startswith(_JPEG_START):
        return None if data.endswith(_JPEG_END) or _jpeg_has_end(data) else truncated
    return None


def _jpeg_has_end(data: bytes) -> bool:
    """Whether the end marker of the picture itself is there, also if a camera appended something to it."""
    position = 2
    while match := _JPEG_MARKER.search(data, position):
        marker = data[match.end() - 1]
        if marker == 0xD9:
            return True
        length = int.from_bytes(data[match.end() : match.end() + 2], "big")
        position = match.end() + max(length, 2)
    return False


class _Header(NamedTuple):
    """Width and height in pixels, and how many components a JPEG has (0 for PNG)."""

    size: tuple[int, int]
    components: int


def _header_of(data: bytes) -> _Header | None:
    if data.startswith(_PNG_START):
        if len(data) < 24:
            return None
        return _Header((int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")), 0)
    if not data.startswith(_JPEG_START):
        return None
    position = 2
    while match := _JPEG_MARKER.search(data, position):
        marker, start = data[match.end() - 1], match.end()
        if marker in _JPEG_FRAME_MARKERS:
            if len(data) < start + 8:
                return None
            height, width = data[start + 3 : start + 5], data[start + 5 : start + 7]
            return _Header((int.from_bytes(width, "big"), int.from_bytes(height, "big")), data[start + 7])
        position = start + max(int.from_bytes(data[start : start + 2], "big"), 2)
    return None
