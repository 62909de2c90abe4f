"""What changed: a snapshot, then numbered changes, for any number of listeners."""

import asyncio
import threading
from collections import deque
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from typing import Any, Literal

Topic = Literal["job", "capture", "scan", "view"]
Action = Literal["put", "delete"]


@dataclass(frozen=True)
class Snapshot:
    """Everything, as it stood at or after change number `seq`."""

    seq: int
    state: Any


@dataclass(frozen=True)
class Change:
    """One thing that changed: the whole new item, or None where it was deleted."""

    seq: int
    topic: Topic
    action: Action
    id: str
    item: Any


class Feed:
    """Distributes changes; may be told of them from any thread.

    Every listener gets a snapshot and then all changes with consecutive numbers. One that reads too slowly loses its
    backlog and gets a fresh snapshot instead. A snapshot may already hold changes that follow it: each carries
    the whole item, so applying it again does no harm.

    Parameters
    ----------
    capacity
        Changes kept for a slow listener.
    """

    def __init__(self, capacity: int = 512) -> None:
        self._capacity = capacity
        self._lock = threading.Lock()
        self._seq = 0
        self._listeners: set[_Listener] = set()
        self._closed = False

    def publish(self, topic: Topic, action: Action, id: str, item: Any = None) -> None:
        """Tell all listeners of a change."""
        with self._lock:
            self._seq += 1
            change = Change(self._seq, topic, action, id, item)
            for listener in self._listeners:
                listener.offer(change)

    def close(self) -> None:
        """End all present and future listening."""
        with self._lock:
            self._closed = True
            for listener in self._listeners:
                listener.wake()

    async def follow(
        self, snapshot: Callable[[], Any], *, keep_alive_s: float = 10.0
    ) -> AsyncIterator[Snapshot | Change | None]:
        """Listen until the feed is closed.

        Parameters
        ----------
        snapshot
            Makes the present state of everything; called in a thread.
        keep_alive_s
            After so many quiet seconds None comes, so that a dead connection is noticed.
        """
        listener = _Listener(asyncio.get_running_loop(), self._capacity)
        with self._lock:
            self._listeners.add(listener)
        try:
            while True:
                with self._lock:
                    listener.restart()
                    seq = self._seq
                yield Snapshot(seq, await asyncio.to_thread(snapshot))
                while not self._closed and not listener.overrun:
                    change = listener.take()
                    if change is not None:
                        yield change
                    elif not await listener.wait(keep_alive_s):
                        yield None
                if self._closed:
                    return
        finally:
            with self._lock:
                self._listeners.discard(listener)


class _Listener:
    """The backlog of one listener; `offer` from any thread, the rest from its event loop."""

    def __init__(self, loop: asyncio.AbstractEventLoop, capacity: int) -> None:
        self._loop = loop
        self._capacity = capacity
        self._backlog: deque[Change] = deque()
        self._event = asyncio.Event()
        self.overrun = False

    def offer(self, change: Change) -> None:
        if len(self._backlog) >= self._capacity:
            self.overrun = True
        if not self.overrun:
            self._backlog.append(change)
        self.wake()

    def wake(self) -> None:
        # A loop that has been closed has nobody left to wake.
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._event.set)

    def restart(self) -> None:
        self._backlog.clear()
        self.overrun = False

    def take(self) -> Change | None:
        return self._backlog.popleft() if self._backlog else None

    async def wait(self, timeout_s: float) -> bool:
        """Wait for a change or an overrun; False after the given time without any."""
        try:
            await asyncio.wait_for(self._event.wait(), timeout_s)
        except TimeoutError:
            return False
        self._event.clear()
        return True
