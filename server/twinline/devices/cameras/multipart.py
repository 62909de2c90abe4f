"""The stream of pictures that MJPEG cameras send over HTTP, taken apart without any input or output.

The format is multipart/x-mixed-replace: RFC 2046, section 5.1, without an end. What cameras make of it differs:
boundaries announced with and without dashes, other ones sent than announced, lengths that are missing or wrong. So a
stated length is believed only as far as a whole picture of that length is there, and the delimiter is learnt from the
stream itself.
"""

import re
from dataclasses import dataclass

from twinline.devices.cameras.jpeg import END, START, is_whole_jpeg

# A part's head ends with an empty line; some cameras end their lines with LF alone.
_HEAD_END = re.compile(rb"\r?\n\r?\n")
_FIRST_DELIMITER = re.compile(rb"(?:^|\n)(--[^\r\n]{1,200}?)[ \t]*\r?\n")
_MAX_HEAD_BYTES = 16 * 1024
_PADDING = b"\r\n\0 "
MAX_PICTURE_BYTES = 64 * 1024 * 1024
"""No picture is longer; a stream that has no delimiter for so long is none."""


@dataclass(frozen=True, slots=True)
class Part:
    """One picture.

    Attributes
    ----------
    headers
        Its head, names in small letters.
    body
        The picture, exactly as sent.
    arrival_s
        When its first byte came.
    """

    headers: dict[str, str]
    body: bytes
    arrival_s: float


@dataclass(frozen=True, slots=True)
class BrokenPart:
    """A picture that was sent and cannot be used."""

    reason: str


class MultipartParser:
    """Finds the pictures in a stream that comes in pieces of any size.

    Parameters
    ----------
    boundary
        As announced, or None; used if the stream begins with it without the dashes.
    """

    def __init__(self, boundary: str | None) -> None:
        self._announced = (boundary or "").strip().strip('"').encode("latin-1", "replace")
        self._delimiter = b""
        self._buffer = bytearray()
        # The head of the part whose body stands at the beginning of the buffer; None between parts.
        self._headers: dict[str, str] | None = None
        self._arrival_s: float | None = None
        # So much of the buffer holds no delimiter.
        self._searched = 0

    def feed(self, data: bytes, now_s: float) -> list[Part | BrokenPart]:
        """Take the next piece.

        Parameters
        ----------
        now_s
            When the piece came.

        Returns
        -------
        list
            The pictures, whole or broken, that are complete now.
        """
        self._buffer += data
        found: list[Part | BrokenPart] = []
        while True:
            if self._headers is None and not self._take_head(found):
                return found
            if self._arrival_s is None and self._buffer:
                self._arrival_s = now_s
            if not self._take_body(found):
                return found

    @property
    def waiting_bytes(self) -> int:
        """Bytes kept because the part that they belong to is not complete."""
        return len(self._buffer)

    # ----------------------------------------------------------------------------------------------------------- heads

    def _take_head(self, found: list[Part | BrokenPart]) -> bool:
        """Move behind the next delimiter and the head that follows; False if they are not complete."""
        if not self._delimiter and not self._learn_delimiter():
            return False
        at = self._find_delimiter()
        if at is None:
            return False
        skipped = self._buffer[:at].strip(_PADDING)
        if skipped:
            found.append(BrokenPart(f"{len(skipped)} bytes stand between two parts"))
        self._drop(at)
        end_of_line = self._buffer.index(b"\n")
        match = _HEAD_END.search(self._buffer, end_of_line)
        if match is None:
            if len(self._buffer) > _MAX_HEAD_BYTES:
                found.append(BrokenPart(f"its head has no end within {_MAX_HEAD_BYTES} bytes"))
                self._drop(len(self._delimiter))
                return self._take_head(found)
            return False
        self._headers = _read_head(bytes(self._buffer[end_of_line : match.start()]))
        self._drop(match.end())
        self._arrival_s = None
        return True

    def _learn_delimiter(self) -> bool:
        start = bytes(self._buffer[:_MAX_HEAD_BYTES])
        match = _FIRST_DELIMITER.search(start)
        if match is not None:
            self._delimiter = match[1]
        elif self._announced and re.search(rb"(?:^|\n)" + re.escape(self._announced) + rb"[ \t]*\r?\n", start):
            self._delimiter = self._announced
        return bool(self._delimiter)

    def _find_delimiter(self) -> int | None:
        """Place of the next delimiter that stands in a line of its own or directly behind a picture."""
        at = self._buffer.find(self._delimiter, self._searched)
        while at >= 0:
            end = at + len(self._delimiter)
            rest = self._buffer[end : end + 200].lstrip(b" \t-")
            if not rest or rest == b"\r":
                self._searched = at
                return None
            before = self._buffer[max(0, at - 2) : at]
            if rest.startswith((b"\r\n", b"\n")) and (not before or before.endswith((b"\n", END))):
                self._searched = at
                return at
            at = self._buffer.find(self._delimiter, at + 1)
        self._searched = max(0, len(self._buffer) - len(self._delimiter))
        return None

    # ---------------------------------------------------------------------------------------------------------- bodies

    def _take_body(self, found: list[Part | BrokenPart]) -> bool:
        """Take the body that stands at the beginning of the buffer; False if it is not complete."""
        assert self._headers is not None
        length = _length(self._headers)
        if length is not None and len(self._buffer) >= length and self._ends_at(length):
            self._emit(found, length)
            return True
        at = self._find_delimiter()
        if at is not None:
            self._emit(found, at)
            return True
        # Without a length, the picture's own end saves waiting for the next one.
        if length is None and self._ends_at(len(self._buffer)) and is_whole_jpeg(self._buffer):
            self._emit(found, len(self._buffer))
            return True
        return False

    def _ends_at(self, length: int) -> bool:
        """Whether a picture may end there, by its first and last bytes."""
        return self._buffer.startswith(START) and self._buffer[max(0, length - 16) : length].rstrip(_PADDING).endswith(
            END
        )

    def _emit(self, found: list[Part | BrokenPart], length: int) -> None:
        assert self._headers is not None
        body = bytes(self._buffer[:length])
        if _length(self._headers) != length:
            body = body.rstrip(b"\r\n")
        if is_whole_jpeg(body):
            found.append(Part(self._headers, body, self._arrival_s or 0.0))
        else:
            found.append(BrokenPart(f"{len(body)} bytes that are truncated or no JPEG" if body else "it is empty"))
        self._drop(length)
        self._headers = None

    def _drop(self, length: int) -> None:
        del self._buffer[:length]
        self._searched = 0


def _read_head(head: bytes) -> dict[str, str]:
    lines = head.decode("latin-1").splitlines()
    pairs = (line.partition(":") for line in lines if ":" in line)
    return {name.strip().lower(): value.strip() for name, _, value in pairs}


def _length(headers: dict[str, str]) -> int | None:
    text = headers.get("content-length", "")
    return int(text) if text.isascii() and text.isdigit() and 0 < int(text) <= MAX_PICTURE_BYTES else None
