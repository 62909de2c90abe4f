"""What the simulated board does in several movements: homing, laser pass and ToF pass."""

import asyncio
from collections.abc import Callable
from typing import Protocol

from twinline.devices.board import Axis
from twinline.devices.serial.protocol_gen import (
    HOME_CLEAR_STEPS,
    HOME_SLOW_MSTEPS_S,
    HOME_TRAVEL_STEPS,
    EventKind,
    MotionEnd,
)
from twinline.devices.simulator.board_clock import SimulatedClock
from twinline.devices.simulator.board_motion import BoardMotion
from twinline.devices.simulator.ramp import stopping_steps

RUN_UP_MARGIN_STEPS = 8
_BACK_OFFS = 20


class Light(Protocol):
    """Switches the light of a laser pass."""

    def __call__(self, shining: bool, ticks: int) -> None:
        """Switch its phases on or everything off, from a time just past."""
        ...


class EndedEarlyError(Exception):
    """A program's movement ended before it was complete.

    Parameters
    ----------
    reason
        How it ended.
    """

    def __init__(self, reason: MotionEnd) -> None:
        super().__init__(reason.name)
        self.reason = reason


class Program:
    """One run of a program of movements.

    Parameters
    ----------
    clock
        The board's time.
    motion
        The axes.
    event
        Tells an event: kind, second detail, and when.

    Attributes
    ----------
    low_edge
        Count at which the low switch was last pressed; the board keeps it up to date.
    dimmed
        Whether light has been switched off for the rest of it.
    """

    def __init__(
        self,
        clock: SimulatedClock,
        motion: BoardMotion,
        event: Callable[[EventKind, int, int], None],
    ) -> None:
        self._clock = clock
        self._motion = motion
        self._event = event
        self._halted: MotionEnd | None = None
        self.low_edge = 0
        self.dimmed = False

    def halt(self, reason: MotionEnd) -> None:
        """Let no further movement begin; the present one is for the caller to end."""
        self._halted = self._halted or reason

    async def home_slide(self) -> None:
        """Find the low switch fast, leave it, and meet it again slowly; its edge becomes zero.

        Raises
        ------
        EndedEarlyError
            Also with ``HOME_FAILED``: it was never met, or never left.
        """
        motion = self._motion
        if not motion.pressed[0]:
            await self._seek(motion.count("slide") - HOME_TRAVEL_STEPS)
        for _ in range(_BACK_OFFS):
            if not motion.pressed[0]:
                break
            await self._move("slide", motion.count("slide") + HOME_CLEAR_STEPS)
        if motion.pressed[0]:
            raise EndedEarlyError(MotionEnd.HOME_FAILED)
        await self._move("slide", motion.count("slide") + HOME_CLEAR_STEPS)
        await self._seek(motion.count("slide") - 3 * HOME_CLEAR_STEPS, HOME_SLOW_MSTEPS_S)
        motion.renumber("slide", self.low_edge)
        await self._move("slide", HOME_CLEAR_STEPS)

    async def laser_pass(self, first: int, last: int, rate_msteps_s: int, light: Light) -> None:
        """Cross a range of the cart at constant rate, with light from its first to its last step.

        Raises
        ------
        EndedEarlyError
            Stopped, or cut off.
        """
        run_up = run_up_steps(first, last, rate_msteps_s, self._motion.acceleration["cart"])
        await self._move("cart", first - run_up)

        def begin(ticks: int) -> None:
            if self._halted is None:
                self._event(EventKind.SCAN_START, 0, ticks)
                if not self.dimmed:
                    light(True, ticks)

        def end(ticks: int) -> None:
            if self._halted is None:
                light(False, ticks)
                self._event(EventKind.SCAN_END, 0, ticks)

        moving = self._start("cart", last + run_up, rate_msteps_s)
        times = [self._motion.time_at("cart", count) for count in (first, last)]
        timers = [self._clock.call_at(times[0], lambda: begin(times[0]))]
        timers.append(self._clock.call_at(times[1], lambda: end(times[1])))
        try:
            await self._until(moving)
        finally:
            for timer in timers:
                timer.cancel()

    async def raster(self, cart: tuple[int, int], advance: int, slide: tuple[int, int], rate_msteps_s: int) -> None:
        """Sweep the slide to and fro over rows of the cart.

        Raises
        ------
        EndedEarlyError
            Stopped, a limit switch, or cut off.
        """
        near, far = slide
        for row, place in enumerate(rows(cart, advance)):
            await self._move("cart", place)
            await self._move("slide", near)
            self._event(EventKind.ROW_START, row, self._clock.now())
            await self._move("slide", far, rate_msteps_s)
            self._event(EventKind.ROW_END, row, self._clock.now())
            near, far = far, near

    async def _move(self, axis: Axis, to: int, rate_msteps_s: int | None = None) -> None:
        await self._until(self._start(axis, to, rate_msteps_s))

    async def _seek(self, to: int, rate_msteps_s: int | None = None) -> None:
        """Move until a limit switch ends it; that it does not is the failure."""
        reason = await self._start("slide", to, rate_msteps_s)
        if self._halted is not None or reason is not MotionEnd.LIMIT or not self._motion.pressed[0]:
            raise EndedEarlyError(
                self._halted or (MotionEnd.HOME_FAILED if reason in (MotionEnd.DONE, MotionEnd.LIMIT) else reason)
            )

    def _start(self, axis: Axis, to: int, rate_msteps_s: int | None = None) -> asyncio.Future[MotionEnd]:
        if self._halted is not None:
            raise EndedEarlyError(self._halted)
        if self._motion.blocked(axis, to):
            raise EndedEarlyError(MotionEnd.LIMIT)
        ended: asyncio.Future[MotionEnd] = asyncio.get_running_loop().create_future()

        def done(reason: MotionEnd, _ticks: int) -> None:
            if not ended.done():
                ended.set_result(reason)

        self._motion.start(axis, to, done, rate_msteps_s=rate_msteps_s)
        return ended

    async def _until(self, moving: asyncio.Future[MotionEnd]) -> None:
        reason = await moving
        if self._halted is not None or reason is not MotionEnd.DONE:
            raise EndedEarlyError(self._halted or reason)


def rows(cart: tuple[int, int], advance: int) -> range:
    """Counts of the rows of a raster."""
    first, last = cart
    return range(first, last + 1, advance) if last >= first else range(first, last - 1, -advance)


def run_up_steps(first: int, last: int, rate_msteps_s: int, acceleration_steps_s2: int) -> int:
    """Steps before and beyond a laser pass's range, with the sign of its direction."""
    steps = stopping_steps(rate_msteps_s, acceleration_steps_s2) + RUN_UP_MARGIN_STEPS
    return steps if last > first else -steps
