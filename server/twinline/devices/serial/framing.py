"""Lines with checksums, out of and into bytes; no input or output of its own.

References
----------
firmware/protocol/PROTOCOL.md, Lines.
"""

import binascii
from dataclasses import dataclass

from twinline.devices.serial.protocol_gen import LINE_BYTES, BadLine

_HEX = frozenset(b"0123456789ABCDEF")
_MARK_BYTES = len("*CCCC")


@dataclass(frozen=True)
class Noise:
    """A line that was not taken.

    Attributes
    ----------
    why
        What is wrong with it.
    """

    why: BadLine


def checksum(body: bytes) -> bytes:
    """CRC-16/CCITT-FALSE of a line's body, as four capital hexadecimal digits."""
    return b"%04X" % binascii.crc_hqx(body, 0xFFFF)


def framed(body: str) -> bytes:
    """A whole line with checksum and newline.

    Raises
    ------
    ValueError
        The body is not printable ASCII, or the line would be longer than the protocol permits.
    """
    data = body.encode("ascii")
    if not _is_printable(data) or len(data) + _MARK_BYTES > LINE_BYTES:
        raise ValueError(f"{body!r} cannot be a line: printable ASCII of at most {LINE_BYTES - _MARK_BYTES} bytes only")
    return data + b"*" + checksum(data) + b"\n"


class LineReader:
    """Cuts a stream of bytes, however it is chopped, into bodies and reports of noise."""

    def __init__(self) -> None:
        self._pending = bytearray()
        self._too_long = False

    def feed(self, data: bytes) -> list[str | Noise]:
        """Take the next bytes.

        Parameters
        ----------
        data
            Any number of bytes, of which lines may be any part.

        Returns
        -------
        list of str or Noise
            Bodies of the lines that ended, without checksum, and what was wrong with the others; in order. Empty lines
            give nothing.
        """
        *ended, rest = data.split(b"\n")
        found: list[str | Noise] = []
        for part in ended:
            self._append(part)
            line = self._take()
            if line is not None:
                found.append(line)
        self._append(rest)
        return found

    def _append(self, part: bytes) -> None:
        if self._too_long:
            return
        self._pending += part
        # A carriage return may still follow a line of full length.
        if len(self._pending) > LINE_BYTES + 1:
            self._too_long = True
            self._pending.clear()

    def _take(self) -> str | Noise | None:
        line = bytes(self._pending).removesuffix(b"\r")
        too_long = self._too_long or len(line) > LINE_BYTES
        self._pending.clear()
        self._too_long = False
        if too_long:
            return Noise(BadLine.LONG)
        return _body_of(line) if line else None


def _body_of(line: bytes) -> str | Noise:
    body, mark, digits = line[:-_MARK_BYTES], line[-_MARK_BYTES:-4], line[-4:]
    if mark != b"*" or not _HEX.issuperset(digits) or not _is_printable(body):
        return Noise(BadLine.FORM)
    if checksum(body) != digits:
        return Noise(BadLine.CRC)
    return body.decode("ascii")


def _is_printable(data: bytes) -> bool:
    return b"*" not in data and all(0x20 <= byte <= 0x7E for byte in data)
