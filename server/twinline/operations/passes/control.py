"""Pause, resume and cancel a pass that is under way, from outside."""

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from contextlib import suppress

from twinline.devices.serial.reasons import STOPPED_CODE
from twinline.errors import CancelledError, DeviceError, MotionError


class PassControl:
    """The handle on a running pass; all methods are called on its event loop.

    A pass that is paused stands still with its lasers off, and its recording is closed: it goes on in a new file.
    """

    def __init__(self) -> None:
        self._going = asyncio.Event()
        self._going.set()
        self._cancelled = False
        self._asked_to_stop = False
        self._interrupt: Callable[[], Awaitable[None]] | None = None
        self._stopping: set[asyncio.Task[None]] = set()

    @property
    def paused(self) -> bool:
        """Whether it is to stand still."""
        return not self._going.is_set()

    @property
    def cancelled(self) -> bool:
        """Whether it is to end."""
        return self._cancelled

    def pause(self) -> None:
        """Stop the machine where it is; `resume` goes on from there."""
        self._going.clear()
        self._stop()

    def resume(self) -> None:
        """Go on after a pause."""
        self._going.set()

    def cancel(self) -> None:
        """Stop the machine and end the pass; what was recorded stays."""
        self._cancelled = True
        self._going.set()
        self._stop()

    async def checkpoint(self) -> None:
        """Wait while paused.

        Raises
        ------
        CancelledError
            The pass was cancelled.
        """
        await self._going.wait()
        if self._cancelled:
            raise CancelledError("The pass was cancelled; what was recorded until then is kept.")
        self._asked_to_stop = False

    def require_going(self) -> None:
        """Begin no movement after a pause or a cancellation.

        Raises
        ------
        MotionError
            With the code of a movement that was told to stop.
        """
        if self.paused or self._cancelled:
            raise MotionError("The pass did not go on because it was paused or cancelled.", code=STOPPED_CODE)

    def explains(self, error: DeviceError) -> bool:
        """Whether an error is nothing but a pause's or a cancellation's doing, even if it was resumed since."""
        return self._asked_to_stop and error.code == STOPPED_CODE

    async def drive(self, movement: Coroutine[None, None, None], interrupt: Callable[[], Awaitable[None]]) -> None:
        """Run a movement that a pause or a cancellation interrupts.

        Parameters
        ----------
        interrupt
            Lets the movement end early.

        Raises
        ------
        MotionError
            As `require_going`; and whatever the movement raises.
        """
        try:
            self.require_going()
        except MotionError:
            movement.close()
            raise
        self._interrupt = interrupt
        try:
            await movement
        finally:
            self._interrupt = None

    def _stop(self) -> None:
        self._asked_to_stop = True
        if self._interrupt is not None:
            task = asyncio.ensure_future(_quietly(self._interrupt))
            self._stopping.add(task)
            task.add_done_callback(self._stopping.discard)


async def _quietly(interrupt: Callable[[], Awaitable[None]]) -> None:
    # That the link is down is told to who waits for the movement.
    with suppress(DeviceError):
        await interrupt()
