"""Reading the container of a recording record by record, whole or not.

The index at the end of the file is not used: walking over the records costs a few microseconds a message, and gives
the same answer for a recording that was cut off before its index was written. What a message says is read at once;
pictures are only located.
"""

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, NamedTuple

from twinline.errors import CaptureError
from twinline.recording.foxglove import HEAD_BYTES

MAGIC = b"\x89MCAP0\r\n"
_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _ATTACHMENT, _METADATA = 1, 2, 3, 4, 5, 6, 9, 12
_BUFFER_BYTES = 8192
_RECORD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQI")
# Length, times, sizes, checksum, an empty name of a compression, length of the data.
_CHUNK_FIXED_BYTES = 40
_MOST_SMALL_BYTES = 64 << 20
_BLOCK_BYTES = 1 << 20
# A chunk shorter than 4 GB, up to its two times.
_CHUNK_START = re.compile(rb"\x06(?=.{4}\x00{4})", re.DOTALL)


class Located(NamedTuple):
    """A message in the file.

    Attributes
    ----------
    schema
        Name of its schema.
    offset, length
        Where its data lie in the file, in bytes.
    data
        The data; only the first `foxglove.HEAD_BYTES` of messages that are not JSON.
    """

    topic: str
    schema: str
    time_ns: int
    sequence: int
    offset: int
    length: int
    data: bytes


@dataclass(eq=False)
class Contents:
    """What a container holds.

    Attributes
    ----------
    metadata
        Metadata records by name.
    files
        Attachments by name.
    whole
        Whether the file was finished and nothing is missing or damaged.
    problems
        What is missing or damaged, in words.
    """

    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)
    messages: list[Located] = field(default_factory=list)
    whole: bool = False
    problems: list[str] = field(default_factory=list)


def walk(path: Path, *, check: bool = False) -> Contents:
    """Read a container up to its last complete message.

    Parameters
    ----------
    check
        Also compare every chunk with its checksum, which reads the whole file.

    Raises
    ------
    CaptureError
        If the file cannot be read, is empty, is no MCAP file, or is compressed.
    """
    try:
        with path.open("rb", buffering=_BUFFER_BYTES) as stream:
            return _Walker(path, stream, check).run()
    except OSError as error:
        raise CaptureError(f"{path} cannot be read: {error.strerror or error}.") from error


def is_container(path: Path) -> bool:
    """Whether a file begins like an MCAP file; one that was cut off within its first bytes counts."""
    try:
        with path.open("rb") as stream:
            start = stream.read(len(MAGIC))
    except OSError:
        return False
    return MAGIC.startswith(start) and (bool(start) or path.suffix == ".mcap")


class _Walker:
    def __init__(self, path: Path, stream: BinaryIO, check: bool) -> None:
        self._path, self._stream, self._check = path, stream, check
        self._size = stream.seek(0, 2)
        self._contents = Contents()
        self._schemas: dict[int, str] = {0: ""}
        self._channels: dict[int, tuple[str, str]] = {}

    def run(self) -> Contents:
        self._stream.seek(0)
        start = self._stream.read(len(MAGIC))
        if not start:
            raise CaptureError(f"{self._path} is empty (0 bytes); the recording was interrupted before it began.")
        if start != MAGIC:
            cut_off = MAGIC.startswith(start)
            why = "was cut off within its first bytes" if cut_off else "is no recording: it is not an MCAP file"
            raise CaptureError(f"{self._path} {why}; give a recording that Twinline has written.")
        self._walk_file(len(MAGIC))
        return self._contents

    def _walk_file(self, position: int) -> None:
        finished = False
        while position < self._size and not finished:
            opcode, end = self._record(position, self._size)
            body = position + _RECORD.size
            if opcode == _CHUNK and end is None:
                # Cut off in the middle of a chunk: the messages before the cut are whole.
                self._walk_chunk(body, self._size)
            if end is None or opcode == 0:
                position = self._resume(position)
                continue
            if opcode == _CHUNK:
                self._walk_chunk(body, end)
            elif opcode in {_METADATA, _ATTACHMENT, _SCHEMA, _CHANNEL}:
                self._small(opcode, body, end)
            elif opcode == _FOOTER:
                self._stream.seek(end)
                finished = self._stream.read(len(MAGIC)) == MAGIC
            position = end
        if not finished and not self._contents.problems:
            self._contents.problems.append("it was not finished: the recording was interrupted")
        self._contents.whole = finished and not self._contents.problems

    def _record(self, position: int, limit: int) -> tuple[int, int | None]:
        """Kind of the record at a place, and where it ends; None if that is not within the limit."""
        self._stream.seek(position)
        head = self._stream.read(_RECORD.size)
        if len(head) < _RECORD.size:
            return 0, None
        opcode, length = _RECORD.unpack(head)
        end = position + _RECORD.size + length
        return opcode, end if end <= limit else None

    def _resume(self, position: int) -> int:
        """Find the next chunk after a place that makes no sense; the end of the file if there is none."""
        found = next(self._chunk_starts(position + 1), self._size)
        if found < self._size:
            self._contents.problems.append(f"{found - position} bytes from {position} on are damaged")
        else:
            self._contents.problems.append(f"it ends at byte {position} in the middle of a record")
        return found

    def _chunk_starts(self, position: int) -> Iterator[int]:
        """Places that look like the start of a whole chunk: all its lengths agree."""
        head_bytes = _RECORD.size + _CHUNK_FIXED_BYTES
        while position < self._size:
            self._stream.seek(position)
            block = self._stream.read(_BLOCK_BYTES + head_bytes)
            for match in _CHUNK_START.finditer(block, 0, min(len(block), _BLOCK_BYTES + _RECORD.size)):
                head = block[match.start() : match.start() + head_bytes]
                place = position + match.start()
                if len(head) == head_bytes and self._agrees(head, place):
                    yield place
            position += _BLOCK_BYTES

    def _agrees(self, head: bytes, place: int) -> bool:
        _, length = _RECORD.unpack_from(head)
        uncompressed = int.from_bytes(head[25:33], "little")
        name, data = int.from_bytes(head[37:41], "little"), int.from_bytes(head[41:49], "little")
        return bool(
            name == 0
            and data == uncompressed == length - _CHUNK_FIXED_BYTES
            and place + _RECORD.size + length <= self._size
        )

    def _walk_chunk(self, body: int, end: int) -> None:
        self._stream.seek(body)
        head = self._stream.read(_CHUNK_FIXED_BYTES)
        if len(head) < _CHUNK_FIXED_BYTES:
            return
        _, _, _, crc = _CHUNK_HEAD.unpack_from(head)
        if any(head[28:32]):
            raise CaptureError(f"{self._path} is compressed; decompress it first, with the mcap command for example.")
        position = body + _CHUNK_FIXED_BYTES
        if self._check and end < self._size:
            self._stream.seek(position)
            if zlib.crc32(self._stream.read(end - position)) != crc:
                self._contents.problems.append(f"the chunk at byte {body - _RECORD.size} does not match its checksum")
        while position < end:
            opcode, after = self._record(position, end)
            if after is None or opcode == 0:
                if end < self._size:
                    self._contents.problems.append(f"{end - position} bytes from {position} on are damaged")
                return
            if opcode == _MESSAGE:
                self._message(position + _RECORD.size, after)
            elif opcode in {_SCHEMA, _CHANNEL}:
                self._small(opcode, position + _RECORD.size, after)
            else:
                # Nothing else stands in a chunk: its own length was damaged, and this is what follows it.
                return
            position = after

    def _message(self, body: int, end: int) -> None:
        self._stream.seek(body)
        head = self._stream.read(_MESSAGE_HEAD.size)
        channel, sequence, time_ns, _ = _MESSAGE_HEAD.unpack(head) if len(head) == _MESSAGE_HEAD.size else (-1, 0, 0, 0)
        known = self._channels.get(channel)
        if known is None:
            return
        topic, schema = known
        offset = body + _MESSAGE_HEAD.size
        length = end - offset
        json = schema.startswith("twinline.")
        data = self._stream.read(length if json else min(length, HEAD_BYTES))
        self._contents.messages.append(Located(topic, schema, time_ns, sequence, offset, length, data))

    def _small(self, opcode: int, body: int, end: int) -> None:
        if end - body > _MOST_SMALL_BYTES:
            return
        self._stream.seek(body)
        data = self._stream.read(end - body)
        try:
            if opcode == _SCHEMA:
                self._schemas[int.from_bytes(data[:2], "little")] = _text(data, 2)[0]
            elif opcode == _CHANNEL:
                number, schema = struct.unpack_from("<HH", data)
                self._channels[number] = (_text(data, 4)[0], self._schemas.get(schema, ""))
            elif opcode == _METADATA:
                name, position = _text(data, 0)
                self._contents.metadata[name] = dict(_pairs(data, position))
            else:
                self._attachment(data)
        except (struct.error, UnicodeDecodeError, IndexError, OverflowError):
            self._contents.problems.append(f"the record at byte {body - _RECORD.size} is damaged")

    def _attachment(self, data: bytes) -> None:
        name, position = _text(data, 16)
        _, position = _text(data, position)
        (length,) = struct.unpack_from("<Q", data, position)
        start = position + 8
        (crc,) = struct.unpack_from("<I", data, start + length)
        if crc and zlib.crc32(data[: start + length]) != crc:
            self._contents.problems.append(f"the attached file {name} does not match its checksum")
            return
        self._contents.files[name] = data[start : start + length]


def _text(data: bytes, position: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", data, position)
    end = position + 4 + length
    if end > len(data):
        raise IndexError("text beyond the end of its record")
    return data[position + 4 : end].decode(), end


def _pairs(data: bytes, position: int) -> Iterator[tuple[str, str]]:
    (length,) = struct.unpack_from("<I", data, position)
    end, position = position + 4 + length, position + 4
    while position < end:
        name, position = _text(data, position)
        value, position = _text(data, position)
        yield name, value
