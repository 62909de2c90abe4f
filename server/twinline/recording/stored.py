"""Pictures that lie inside a recording: where they are, and how to have one as if it were a file."""

import errno
import zlib
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Literal, TypeAlias

import numpy as np

StoredEncoding: TypeAlias = Literal["jpeg", "png", "gray8", "bgr8"]
"""A JPEG or PNG file as it came, or rows of pixels without padding: grey, or blue, green, red."""


@dataclass(frozen=True, slots=True)
class StoredAt:
    """Where the bytes of a picture lie in a recording.

    Attributes
    ----------
    offset, length
        In bytes, from the start of the file.
    crc32
        CRC-32 of these bytes.
    size : (int, int)
        Width and height in pixels; zeros where they were not known.
    """

    offset: int
    length: int
    crc32: int
    encoding: StoredEncoding
    size: tuple[int, int]


@dataclass(frozen=True, slots=True)
class StoredPicture:
    """A picture in a recording; reads like a file of its own.

    Attributes
    ----------
    container
        The recording.
    part
        Part of the capture that it belongs to.
    name
        File name.
    """

    container: Path
    part: str
    name: str
    at: StoredAt

    def __str__(self) -> str:
        return f"{self.container}: {self.part}/{self.name}"

    @property
    def stem(self) -> str:
        """The name without its ending."""
        return PurePosixPath(self.name).stem

    @property
    def parent(self) -> PurePosixPath:
        """The part, as the folder it would be in a capture folder."""
        return PurePosixPath(self.part)

    def raw_bytes(self) -> bytes:
        """The bytes as they were delivered.

        Raises
        ------
        OSError
            If the recording cannot be read, or the bytes are not those that were recorded.
        """
        with self.container.open("rb", buffering=0) as stream:
            stream.seek(self.at.offset)
            data = stream.read(self.at.length) or b""
        if len(data) != self.at.length:
            raise OSError(errno.EIO, f"the recording ends {self.at.length - len(data)} bytes before the picture does")
        if zlib.crc32(data) != self.at.crc32:
            raise OSError(errno.EIO, "the recording is damaged there: the checksum does not match")
        return data

    def read_bytes(self) -> bytes:
        """The picture as the bytes of a file; plain pixels become a portable pixmap.

        Raises
        ------
        OSError
            As `raw_bytes`.
        """
        data = self.raw_bytes()
        if self.at.encoding in {"jpeg", "png"}:
            return data
        width, height = self.at.size
        if self.at.encoding == "gray8":
            return b"P5\n%d %d\n255\n" % (width, height) + data
        pixels = np.frombuffer(data, np.uint8).reshape(-1, 3)[:, ::-1]
        return b"P6\n%d %d\n255\n" % (width, height) + pixels.tobytes()
