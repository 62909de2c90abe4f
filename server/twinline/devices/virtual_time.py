"""An event loop whose time jumps to the next timer when there is nothing to do.

Programs that take their time from the loop (``loop.time()``, ``asyncio.sleep``, time-outs) run as fast as the machine
computes, with the same order of events and the same times as in a real hour.
"""

import asyncio
import selectors
from collections.abc import Coroutine, Generator, Mapping
from contextlib import contextmanager
from typing import Any, TypeVar

Result = TypeVar("Result")

START_S = 1000.0
"""Time of a new loop; not 0, so that a time that was never set is noticed."""


class VirtualTimeLoop(asyncio.SelectorEventLoop):
    """A selector event loop with its own time.

    Sockets, pipes and ``call_soon_threadsafe`` work, but what comes from outside takes no time, and the loop does not
    wait for it while a timer is set: enclose waiting for a thread or a process in `hold`.
    """

    def __init__(self) -> None:
        self._now_s = START_S
        self._holds = 0
        super().__init__(_JumpingSelector(self))

    def time(self) -> float:
        """Virtual seconds."""
        return self._now_s

    def advance(self, seconds: float) -> None:
        """Let time pass; for the selector."""
        self._now_s += seconds

    @property
    def held(self) -> bool:
        """Whether time stands still."""
        return self._holds > 0

    @contextmanager
    def hold(self) -> Generator[None]:
        """Let time stand still; see the function `hold`."""
        self._holds += 1
        try:
            yield
        finally:
            self._holds -= 1


@contextmanager
def hold() -> Generator[None]:
    """Let virtual time stand still while work runs in a thread or a process; without effect on other loops.

    What is awaited within must not itself wait for a timer of this loop: it would wait for ever.
    """
    loop = asyncio.get_running_loop()
    if isinstance(loop, VirtualTimeLoop):
        with loop.hold():
            yield
    else:
        yield


def run_virtual(main: Coroutine[Any, Any, Result]) -> Result:
    """Run a coroutine under a `VirtualTimeLoop` to its end, as ``asyncio.run`` does under a common loop."""
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(main)


class _JumpingSelector(selectors.BaseSelector):
    """Another selector's answers, except that waiting without result becomes a jump of the loop's time."""

    def __init__(self, loop: VirtualTimeLoop) -> None:
        self._loop = loop
        self._real = selectors.DefaultSelector()

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        if timeout is None or timeout <= 0.0:
            return self._real.select(timeout)
        if self._loop.held:
            return self._real.select(None)
        ready = self._real.select(0)
        if not ready:
            self._loop.advance(timeout)
        return ready

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        return self._real.register(fileobj, events, data)

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:
        return self._real.unregister(fileobj)

    def modify(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        return self._real.modify(fileobj, events, data)

    def get_map(self) -> Mapping[Any, selectors.SelectorKey]:
        return self._real.get_map()

    def close(self) -> None:
        self._real.close()
