"""Recording a pass: whatever happens is handed over at once and written by a thread of its own.

The caller never waits for the disk. What it hands over is on its way to the system within `FLUSH_S`, so that a process
that is killed loses no more than that; and on the disk a second later, so that a power cut loses little more.
"""

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Self

from twinline.errors import OutputError
from twinline.recording.atomic_file import output_error
from twinline.recording.container_file import ContainerFile
from twinline.recording.delivered import BoardHappening, BoardSample, DeliveredFrame, LinkReport
from twinline.recording.pass_header import METADATA, PassHeader
from twinline.recording.pass_messages import (
    Message,
    Picture,
    event_message,
    link_message,
    note_message,
    suffix_of,
    telemetry_message,
)
from twinline.recording.topics import PartName

FLUSH_S = 0.4
SYNC_S = 1.0
MOST_WAITING_BYTES = 256 << 20
_OVERHEAD_BYTES = 100


@dataclass(frozen=True)
class WriterStatus:
    """How a recording is doing.

    Attributes
    ----------
    frames, messages
        Accepted so far; messages are everything but frames.
    waiting_bytes
        Accepted and not yet written.
    written_bytes
        Length of the file.
    problem
        Why nothing is written any more; None while all is well.
    """

    frames: int
    messages: int
    waiting_bytes: int
    written_bytes: int
    problem: OutputError | None


class PassWriter:
    """Writes one recording. Any thread may call any method.

    After a failure of the disk every call raises the same error; what was written before stays, and is readable.

    Parameters
    ----------
    path
        New file; its name should end in ``.mcap``.
    most_waiting_bytes
        What may wait for a disk that is slow for a while.
    sync
        Whether to have the disk itself take the data every `SYNC_S`, against power cuts.
    clock
        Seconds of a clock that never goes back; the thread's own, whatever time the machine lives in.

    Raises
    ------
    OutputError
        If the file exists already, or cannot be made.
    """

    def __init__(
        self,
        path: Path,
        header: PassHeader,
        *,
        most_waiting_bytes: int = MOST_WAITING_BYTES,
        sync: bool = True,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.path = path
        self._file = ContainerFile(path, METADATA, header.metadata(), header.files())
        self._most_waiting = most_waiting_bytes
        self._clock = clock
        self._changed = threading.Condition()
        self._waiting: deque[Message | Picture] = deque()
        self._waiting_bytes = 0
        self._numbers: dict[PartName, int] = {}
        self._messages = 0
        self._barriers: list[threading.Event] = []
        self._problem: OutputError | None = None
        self._closing = False
        self._thread = threading.Thread(target=self._work, name=f"recording {path.name}", daemon=True)
        self._thread.start()
        self._synced = threading.Event()
        self._syncer = threading.Thread(target=self._keep_synced, name=f"sync {path.name}", daemon=True)
        if sync:
            self._syncer.start()

    def frame(
        self,
        frame: DeliveredFrame,
        part: PartName = "laser",
        *,
        lasers: frozenset[int] | None = None,
        cart_mm: float | None = None,
        timeout_s: float = 0.0,
    ) -> None:
        """Record a frame as it was delivered.

        Parameters
        ----------
        lasers
            Numbers of the lasers that were on; None means all.
        cart_mm
            Position of the cart, if it is known otherwise than from telemetry.
        timeout_s
            How long to wait for a slow disk before giving up.

        Raises
        ------
        OutputError
            The disk failed, or is so slow (code ``disk-too-slow``) that this frame was not taken.
        ValueError
            The frame's data do not fit its size.
        """
        name = f"{frame.sequence:08d}{suffix_of(frame.encoding)}"
        self.picture(
            Picture(
                part, -1, name, frame.encoding, frame.data, frame.image_size, frame.host_time_s, frame.sequence,
                frame.exposure_s, frame.dropped, lasers, cart_mm,
            ),
            timeout_s=timeout_s,
        )  # fmt: skip

    def picture(self, picture: Picture, *, timeout_s: float = 0.0) -> None:
        """Record a picture from anywhere; its ``number`` is given here. Otherwise as `frame`."""
        picture.check()
        with self._changed:
            size = len(picture.data) + 5 * _OVERHEAD_BYTES
            if not self._changed.wait_for(lambda: self._room_for(size), timeout_s) and self._problem is None:
                raise OutputError(
                    f"{self.path}: the disk is too slow, {self._waiting_bytes / 1e6:.0f} MB wait for it; record to a "
                    "faster disk, or take fewer frames.",
                    code="disk-too-slow",
                )
            self._require_open()
            number = self._numbers.get(picture.part, 0)
            self._numbers[picture.part] = number + 1
            self._put(replace(picture, number=number), size)

    def telemetry(self, sample: BoardSample) -> None:
        """Record a line of telemetry; OutputError as for `frame`, but it is always taken while the disk works."""
        self.message(telemetry_message(sample))

    def event(self, event: BoardHappening) -> None:
        """Record an event of the board; as `telemetry`."""
        self.message(event_message(event))

    def link(self, change: LinkReport) -> None:
        """Record that the connection to the board came up or went down; as `telemetry`."""
        self.message(link_message(change))

    def note(self, host_time_s: float, about: str, text: str) -> None:
        """Record whatever else is worth knowing, such as a setting that was changed; as `telemetry`."""
        self.message(note_message(host_time_s, about, text))

    def message(self, message: Message) -> None:
        """Record a message that is ready; as `telemetry`."""
        with self._changed:
            self._require_open()
            self._messages += 1
            self._put(message, len(message.data) + _OVERHEAD_BYTES)

    def status(self) -> WriterStatus:
        """How the recording is doing."""
        with self._changed:
            frames = sum(self._numbers.values())
            return WriterStatus(frames, self._messages, self._waiting_bytes, self._file.bytes_written, self._problem)

    def flush(self) -> None:
        """Wait until all that was accepted is with the system.

        Raises
        ------
        OutputError
            The disk failed.
        """
        done = threading.Event()
        with self._changed:
            self._require_open()
            self._barriers.append(done)
            self._changed.notify_all()
        done.wait()
        self._raise_problem()

    def close(self) -> None:
        """Write what waits and the index, and close the file; closing twice does nothing.

        Raises
        ------
        OutputError
            The disk failed, now or before: the recording is not whole. What was written is readable.
        """
        with self._changed:
            first = not self._closing
            self._closing = True
            self._changed.notify_all()
        self._synced.set()
        self._thread.join()
        if self._syncer.is_alive():
            self._syncer.join()
        if not first:
            return
        try:
            if self._problem is None:
                self._file.finish()
        except OSError as error:
            self._problem = output_error(self.path, error)
        finally:
            self._file.abandon()
        self._raise_problem()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except OutputError:
            if error is None:
                raise

    def _room_for(self, size: int) -> bool:
        # One frame is always taken, however large.
        fits = self._waiting_bytes + size <= self._most_waiting or not self._waiting_bytes
        return fits or self._problem is not None or self._closing

    def _require_open(self) -> None:
        self._raise_problem()
        if self._closing:
            raise OutputError(f"{self.path} is closed already; begin another recording.")

    def _raise_problem(self) -> None:
        if self._problem is not None:
            raise OutputError(self._problem.detail, code=self._problem.code)

    def _put(self, item: Message | Picture, size: int) -> None:
        self._waiting.append(item)
        self._waiting_bytes += size
        self._changed.notify_all()

    def _work(self) -> None:
        try:
            self._write_all()
        finally:
            with self._changed:
                if self._problem is None and not self._closing:
                    self._problem = OutputError(
                        f"{self.path}: the recorder stopped for a reason of its own; see the log."
                    )
                for barrier in self._barriers:
                    barrier.set()
                self._changed.notify_all()

    def _write_all(self) -> None:
        flushed_s = self._clock()
        dirty = False
        while True:
            with self._changed:
                left_s = max(flushed_s + FLUSH_S - self._clock(), 0.0) if dirty else None
                self._changed.wait_for(lambda: self._waiting or self._barriers or self._closing, left_s)
                items, self._waiting = self._waiting, deque()
                taken, barriers, self._barriers = self._waiting_bytes, self._barriers, []
                closing = self._closing
            try:
                dirty = bool(items) or dirty
                self._write(items)
                if dirty and (barriers or closing or self._clock() >= flushed_s + FLUSH_S):
                    self._file.flush()
                    flushed_s, dirty = self._clock(), False
            except OSError as error:
                self._fail(error)
            with self._changed:
                self._waiting_bytes -= taken
                self._changed.notify_all()
            for barrier in barriers:
                barrier.set()
            if closing or self._problem is not None:
                return

    def _write(self, items: deque[Message | Picture]) -> None:
        while items:
            item = items.popleft()
            for message in item.messages() if isinstance(item, Picture) else (item,):
                self._file.add(message)

    def _keep_synced(self) -> None:
        while not self._synced.wait(SYNC_S):
            try:
                self._file.sync()
            except OSError as error:
                self._fail(error)
                return

    def _fail(self, error: OSError) -> None:
        with self._changed:
            if self._problem is None:
                self._problem = output_error(self.path, error)
            self._waiting.clear()
            self._changed.notify_all()
