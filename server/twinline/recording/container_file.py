"""The container of a recording as it is written: an MCAP file without compression, flushed chunk by chunk."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any, cast

from mcap import __version__ as mcap_version
from mcap.writer import CompressionType, Writer

from twinline import __version__
from twinline.errors import OutputError
from twinline.recording import foxglove
from twinline.recording.atomic_file import output_error
from twinline.recording.pass_messages import Message
from twinline.recording.topics import json_schema

PROFILE = "twinline"
SUFFIX = ".mcap"
CHUNK_BYTES = 1 << 20


class ContainerFile:
    """Appends messages to a new file. Not for several threads at once.

    Every chunk that is finished is handed to the system at once: whatever happens to this process then, it stays.

    Parameters
    ----------
    path
        New file, or an empty one.

    Raises
    ------
    OutputError
        If there is a file that is not empty, or it cannot be made.
    """

    def __init__(self, path: Path, name: str, metadata: dict[str, str], files: Mapping[str, bytes]) -> None:
        self._sink = _Sink(path)
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._writer = Writer(
            cast("IO[Any]", self._sink), chunk_size=CHUNK_BYTES, compression=CompressionType.NONE, use_chunking=True
        )
        try:
            self._writer.start(PROFILE, f"twinline/{__version__} mcap/{mcap_version}")
            self._writer.add_metadata(name, metadata)
            for file, data in files.items():
                self._writer.add_attachment(0, 0, file, "application/json", data)
        except OSError as error:
            self._sink.close()
            raise output_error(path, error) from error

    @property
    def bytes_written(self) -> int:
        """Length of the file so far."""
        return self._sink.tell()

    def add(self, message: Message) -> None:
        """Append a message to the chunk in the making; OSError if a full chunk cannot be written."""
        channel = self._channels.get(message.topic)
        if channel is None:
            channel = self._channel(message.topic)
        self._writer.add_message(channel, message.time_ns, message.data, message.time_ns, message.sequence)

    def flush(self) -> None:
        """Hand everything to the system; OSError if it does not take it."""
        self._writer.flush()  # type: ignore[no-untyped-call]

    def sync(self) -> None:
        """Have the system put what it was handed on the disk; may be called from another thread."""
        self._sink.sync()

    def finish(self) -> None:
        """Write the index and close; OSError if that is not possible, the file is closed anyway."""
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._sink.sync()
        finally:
            self._sink.close()

    def abandon(self) -> None:
        """Close the file as it is."""
        self._sink.close()

    def _channel(self, topic: str) -> int:
        kind = topic.rsplit("/", 1)[1]
        if kind in {"image", "raw"}:
            name = foxglove.COMPRESSED if kind == "image" else foxglove.RAW
            schema, encoding = foxglove.schema_of(name), "protobuf"
        else:
            name, schema = json_schema(topic)
            encoding = "json"
        if name not in self._schemas:
            kind_of_schema = "protobuf" if encoding == "protobuf" else "jsonschema"
            self._schemas[name] = self._writer.register_schema(name, kind_of_schema, schema)
        channel = self._writer.register_channel(topic, encoding, self._schemas[name])
        self._channels[topic] = channel
        return channel


class _Sink:
    """An unbuffered file that takes everything it is given or raises."""

    def __init__(self, path: Path) -> None:
        try:
            self._handle = os.open(path, os.O_CREAT | os.O_WRONLY | getattr(os, "O_BINARY", 0), 0o666)
        except OSError as error:
            raise output_error(path, error) from error
        if os.fstat(self._handle).st_size:
            os.close(self._handle)
            raise OutputError(f"{path} exists already; choose another name for the recording.")
        self._position = 0
        self._open = True

    def write(self, data: bytes) -> int:
        view = memoryview(data)
        while view:
            written = os.write(self._handle, view)
            self._position += written
            view = view[written:]
        return len(data)

    def tell(self) -> int:
        return self._position

    def flush(self) -> None:
        return

    def sync(self) -> None:
        if self._open:
            getattr(os, "fdatasync", os.fsync)(self._handle)

    def close(self) -> None:
        if self._open:
            self._open = False
            os.close(self._handle)
