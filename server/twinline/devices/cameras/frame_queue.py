"""The one queue between a camera's thread and the event loop: bounded, and neither side waits for the other's work."""

import asyncio
import threading
import weakref
from collections import deque
from collections.abc import AsyncIterator
from dataclasses import replace

from twinline.devices.camera import CameraFrame
from twinline.errors import TransitionError


class FrameQueue:
    """Hands frames from the camera's thread to one reader on the loop, numbers them, and counts what is lost.

    Every frame made takes a number, delivered or not; what lies between two delivered numbers was dropped. So the
    counts cannot disagree with the numbers, wherever a frame was lost.

    Parameters
    ----------
    loop
        The loop of the reader.
    capacity
        Frames that are kept for a reader that is busy.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, capacity: int) -> None:
        self._loop = loop
        self._capacity = capacity
        self._changed = threading.Condition()
        self._arrived = asyncio.Event()
        self._frames: deque[CameraFrame] = deque()
        self._reader: weakref.ref[FrameIterator] | None = None
        self._owner: weakref.ref[asyncio.Task[object]] | None = None
        self._next = 0
        self._expected = 0
        self._delivered = 0
        self._dropped = 0
        self._over = False
        self._error: Exception | None = None

    # ------------------------------------------------------------------------------------------- the camera's thread

    def put(self, frame: CameraFrame) -> None:
        """Add a frame and never wait: the oldest one is dropped where there is no room, the frame if nobody reads."""
        with self._changed:
            frame = self._numbered(frame)
            if self._over or not self._is_read():
                return
            if len(self._frames) == self._capacity:
                self._frames.popleft()
            self._frames.append(frame)
        self._wake()

    def put_when_taken(self, frame: CameraFrame) -> None:
        """Add a frame as soon as somebody reads and there is room, so that none is lost."""
        with self._changed:
            self._changed.wait_for(lambda: self._over or (self._is_read() and len(self._frames) < self._capacity))
            if self._over:
                return
            self._frames.append(self._numbered(frame))
        self._wake()

    def lose(self, count: int) -> None:
        """Count frames that were made and cannot be delivered."""
        with self._changed:
            self._next += count

    def wait_for_reader(self) -> None:
        """Wait until somebody reads, or the queue is over."""
        with self._changed:
            self._changed.wait_for(lambda: self._over or self._is_read())

    def finish(self, error: Exception | None = None) -> None:
        """End the iteration, once what is queued has been taken, with an error or without."""
        with self._changed:
            if not self._over:
                self._over, self._error = True, error
            self._changed.notify_all()
        self._wake()

    # -------------------------------------------------------------------------------------------------------- the loop

    def close(self) -> None:
        """End the iteration now, and forget what is queued."""
        with self._changed:
            self._over, self._error = True, None
            self._frames.clear()
            self._changed.notify_all()
        self._arrived.set()

    def read(self, *, fresh: bool) -> "FrameIterator":
        """Begin an iteration.

        Parameters
        ----------
        fresh
            Whether it begins with the next frame that arrives; otherwise with the one after the last delivered.

        Raises
        ------
        TransitionError
            If somebody else reads.
        """
        with self._changed:
            if self._is_read():
                raise TransitionError("Somebody else reads this camera's frames: end that first.")
            iterator = FrameIterator(self)
            self._reader = weakref.ref(iterator)
            task = asyncio.current_task(self._loop)
            self._owner = None if task is None else weakref.ref(task)
            if fresh:
                self._frames.clear()
                self._expected = self._next
            self._changed.notify_all()
        return iterator

    async def take(self, iterator: "FrameIterator") -> CameraFrame:
        """Wait for the next frame of an iteration.

        Raises
        ------
        StopAsyncIteration
            If there is none any more.
        TransitionError
            If somebody else reads by now, since the task that began this iteration had ended.
        """
        while True:
            with self._changed:
                if self._reader is None:
                    raise StopAsyncIteration
                if self._reader() is not iterator:
                    raise TransitionError("Somebody else reads this camera's frames by now: begin again.")
                if self._frames:
                    frame = self._frames.popleft()
                    self._dropped += frame.sequence - self._expected
                    self._expected = frame.sequence + 1
                    self._delivered += 1
                    self._changed.notify_all()
                    return replace(frame, dropped=self._dropped)
                if self._over:
                    if self._error is not None:
                        raise self._error
                    raise StopAsyncIteration
                self._arrived.clear()
            await self._arrived.wait()

    def release(self, iterator: "FrameIterator") -> None:
        """End an iteration."""
        with self._changed:
            if self._reader is not None and self._reader() is iterator:
                self._reader = None
        self._arrived.set()

    def counts(self) -> tuple[int, int]:
        """Frames delivered and dropped so far."""
        with self._changed:
            waiting = len(self._frames)
            missing = self._next - self._expected - waiting if self._is_read() else 0
            return self._delivered, self._dropped + missing

    # ---------------------------------------------------------------------------------------------------------- inside

    def _numbered(self, frame: CameraFrame) -> CameraFrame:
        self._next += 1
        return replace(frame, sequence=self._next - 1)

    def _is_read(self) -> bool:
        if self._reader is None or self._reader() is None:
            return False
        # The traceback of a task that failed can keep its iterator alive for long, and nobody reads on.
        task = None if self._owner is None else self._owner()
        return self._owner is None or (task is not None and not task.done())

    def _wake(self) -> None:
        try:
            self._loop.call_soon_threadsafe(self._arrived.set)
        except RuntimeError:
            # The loop has been closed under the camera: nobody reads any more, and nothing can be told to anybody.
            self._over = True


class FrameIterator(AsyncIterator[CameraFrame]):
    """One iteration over a camera's frames; over when closed, or when nobody holds it any more."""

    def __init__(self, queue: FrameQueue) -> None:
        self._queue = queue

    async def __anext__(self) -> CameraFrame:
        return await self._queue.take(self)

    async def aclose(self) -> None:
        """End the iteration."""
        self._queue.release(self)
