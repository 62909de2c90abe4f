"""Opening a recording: its head, its frames, its telemetry; complete or cut off."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from twinline.errors import CaptureError
from twinline.recording import foxglove
from twinline.recording.capture_json import CaptureInfo
from twinline.recording.container_walk import Contents, Located, walk
from twinline.recording.pass_header import METADATA, PassHeader, parse_header
from twinline.recording.pass_rows import (
    RecordedEvent,
    RecordedFrame,
    RecordedLink,
    RecordedNote,
    RecordedTof,
    message_fields,
    parse_event,
    parse_frame,
    parse_link,
    parse_note,
    parse_telemetry,
    parse_tof,
    picture_extent,
)
from twinline.recording.telemetry_table import TelemetryTable
from twinline.recording.topics import (
    EVENT,
    LINK,
    NOTE,
    PARTS,
    TELEMETRY,
    TOF,
    PartName,
    frame_topic,
    image_topic,
    raw_topic,
)

_Row = TypeVar("_Row")


@dataclass(frozen=True, eq=False)
class Recording:
    """An opened recording; holds no picture and no open file.

    Attributes
    ----------
    parts
        Frames by the part of the capture that they belong to; parts without frames are absent.
    whole
        Whether the recording was finished and nothing of it is missing.
    problems
        What is missing or damaged, in words.
    """

    path: Path
    header: PassHeader
    info: CaptureInfo
    parts: Mapping[PartName, tuple[RecordedFrame, ...]]
    telemetry: TelemetryTable
    events: tuple[RecordedEvent, ...]
    links: tuple[RecordedLink, ...]
    notes: tuple[RecordedNote, ...]
    tof: tuple[RecordedTof, ...]
    whole: bool
    problems: tuple[str, ...] = field(default=())

    def shift_from(self, first: "Recording") -> float:
        """What to add to this recording's host times to put them on the clock of an earlier one, seconds.

        Host time begins anew when the host is restarted; the calendar tells how much later this one was begun.
        """
        if self is first:
            return 0.0
        apart_s = (self.header.started_at - first.header.started_at).total_seconds()
        return first.header.host_time_s + apart_s - self.header.host_time_s


def open_recording(path: Path) -> Recording:
    """Open a recording. One that was cut off is read up to its last complete message; the file is never changed.

    Raises
    ------
    CaptureError
        If the file cannot be read, is no recording, or says nothing of use.
    """
    contents = walk(path)
    header = parse_header(path, contents.metadata.get(METADATA), contents.files)
    messages: dict[str, list[Located]] = {}
    for message in contents.messages:
        messages.setdefault(message.topic, []).append(message)
    reader = _Reader(path, messages)
    parts = {part: frames for part in PARTS if (frames := reader.frames(part))}
    return Recording(
        path=path,
        header=header,
        info=header.info(path),
        parts=parts,
        telemetry=TelemetryTable.of(reader.rows(TELEMETRY, parse_telemetry)),
        events=tuple(reader.rows(EVENT, parse_event)),
        links=tuple(reader.rows(LINK, parse_link)),
        notes=tuple(reader.rows(NOTE, parse_note)),
        tof=tuple(reader.rows(TOF, parse_tof)),
        whole=contents.whole and not reader.unusable,
        problems=tuple(_problems(contents, reader.unusable)),
    )


def _problems(contents: Contents, unusable: int) -> Iterable[str]:
    yield from contents.problems
    if unusable:
        yield f"{unusable} of its messages cannot be used"


class _Reader:
    """Messages by channel, turned into rows; counts those that make no sense."""

    def __init__(self, path: Path, messages: Mapping[str, list[Located]]) -> None:
        self._path, self._messages = path, messages
        self.unusable = 0

    def rows(self, topic: str, parse: Callable[[dict[str, object]], _Row]) -> list[_Row]:
        rows = []
        for message in self._messages.get(topic, ()):
            try:
                rows.append(parse(message_fields(message)))
            except (ValueError, KeyError, TypeError, OverflowError):
                self.unusable += 1
        return rows

    def frames(self, part: PartName) -> tuple[RecordedFrame, ...]:
        pictures: dict[int, foxglove.Extent] = {}
        for topic in (image_topic(part), raw_topic(part)):
            for message in self._messages.get(topic, ()):
                extent = picture_extent(message)
                if extent is not None:
                    pictures[message.sequence] = extent
        frames = []
        for message in self._messages.get(frame_topic(part), ()):
            try:
                frames.append(parse_frame(self._path, part, message_fields(message), pictures[message.sequence]))
            except (ValueError, KeyError, TypeError, OverflowError):
                self.unusable += 1
        return tuple(frames)


def require_parts(recording: Recording) -> None:
    """Make sure that there is anything in a recording.

    Raises
    ------
    CaptureError
        If there are neither frames nor readings.
    """
    if not (recording.parts or recording.tof or len(recording.telemetry)):
        raise CaptureError(f"{recording.path} holds no frame and no reading: the pass ended before its first one.")
