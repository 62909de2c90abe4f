"""Movements that somebody waits for."""

import asyncio

from twinline.devices.serial.protocol_gen import MotionEnd
from twinline.devices.serial.reasons import ended
from twinline.devices.serial.requests import again
from twinline.errors import TwinlineError

_REMEMBERED = 64


class Motions:
    """Brings each movement's end to who waits for it, whichever of the board's answer and event comes first."""

    def __init__(self) -> None:
        self._waiting: dict[int, asyncio.Future[MotionEnd]] = {}
        self._over: dict[int, MotionEnd] = {}

    async def end(self, what: str, number: int) -> None:
        """Wait for the end of a movement.

        Parameters
        ----------
        what
            What messages call it.
        number
            The board's number.

        Raises
        ------
        MotionError
            It ended early.
        TwinlineError
            What `fail` was called with.
        """
        if number not in self._over:
            ending = self._waiting.setdefault(number, asyncio.get_running_loop().create_future())
            try:
                reason = await asyncio.shield(ending)
            finally:
                self._waiting.pop(number, None)
        else:
            reason = self._over.pop(number)
        if reason is not MotionEnd.DONE:
            raise ended(what, reason)

    def ended(self, number: int, reason: int) -> None:
        """The board has reported the end of a movement."""
        end = MotionEnd(reason) if reason in MotionEnd.__members__.values() else MotionEnd.STOPPED
        waiting = self._waiting.get(number)
        if waiting is not None:
            if not waiting.done():
                waiting.set_result(end)
            return
        self._over[number] = end
        if len(self._over) > _REMEMBERED:
            del self._over[next(iter(self._over))]

    def fail(self, error: TwinlineError) -> None:
        """Let everybody who waits fail."""
        for waiting in self._waiting.values():
            if not waiting.done():
                waiting.set_exception(again(error))

    def forget(self) -> None:
        """Forget ends that nobody has asked for; numbers may come again."""
        self._over.clear()
