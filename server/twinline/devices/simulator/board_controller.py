"""What the simulated board does with each request."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, TypeAlias

from twinline.devices.board import AXES, Axis
from twinline.devices.serial.codec import Request
from twinline.devices.serial.protocol_gen import (
    PROTOCOL_VERSION,
    TIMER_HZ,
    ErrorCode,
    EventKind,
    Flag,
    MotionEnd,
    Verb,
)
from twinline.devices.simulator.board_clock import SimulatedClock
from twinline.devices.simulator.board_lasers import LaserOutputs
from twinline.devices.simulator.board_motion import BoardMotion
from twinline.devices.simulator.board_programs import EndedEarlyError, Program, rows, run_up_steps
from twinline.devices.simulator.board_safety import BoardSafety
from twinline.devices.simulator.board_session import RefusalError

_MOTION_NUMBERS = 65536
_LEAST_PHASE_US = 1000
Course: TypeAlias = Callable[[], Coroutine[Any, Any, None]]


class BoardController:
    """The board's program without its talk.

    Parameters
    ----------
    clock
        The board's time.
    motion
        The axes.
    outputs
        The lasers.
    event
        Tells an event: kind, two details, and when.
    identity
        Words of HELLO's answer after the version: hash, and the board's software and name.
    """

    def __init__(
        self,
        clock: SimulatedClock,
        motion: BoardMotion,
        outputs: LaserOutputs,
        event: Callable[[EventKind, int, int, int], None],
        identity: tuple[str, str, str],
    ) -> None:
        self._clock = clock
        self._motion = motion
        self._outputs = outputs
        self._event = event
        self._identity = identity
        self._task: asyncio.Task[None] | None = None
        self._motion_number = 0
        self.safety = BoardSafety(clock, motion, outputs, event)
        self.next_event: Callable[[], int] = lambda: 0
        self.reading: Callable[[], int] = lambda: 0
        self.set_telemetry: Callable[[int, int], None] = lambda rate_hz, samples: None
        self.boot_id = 0

    def restart(self, boot_id: int) -> None:
        """Be dark, still and ignorant, as after a restart of the board."""
        self.boot_id = boot_id
        self.shut_down()
        self._motion_number = 0
        self._motion.restart()
        self.safety.restart()

    def shut_down(self) -> None:
        """End everything at once."""
        self._outputs.switch(0, self._clock.now())
        self.safety.disarm()
        if self._task is not None:
            self._task.cancel()
        self._task = self.safety.program = None

    def flags(self, ticks: int) -> Flag:
        """State at the present or a time just past."""
        mask = self._outputs.mask(ticks)
        states = {
            Flag.LASER_1: mask & 1,
            Flag.LASER_2: mask & 2,
            Flag.CART_MOVING: self._motion.moving("cart"),
            Flag.SLIDE_MOVING: self._motion.moving("slide"),
        }
        flags = self.safety.flags()
        for flag, state in states.items():
            if state:
                flags |= flag
        return flags

    def execute(self, request: Request) -> tuple[int | str, ...]:
        """Do a request.

        Returns
        -------
        tuple
            Words of the answer.

        Raises
        ------
        RefusalError
            It is not to be done now.
        """
        arguments = request.arguments
        match request.verb:
            case Verb.HELLO:
                self.safety.halt(MotionEnd.STOPPED)
                self.safety.disarm()
                code, software, name = self._identity
                return (PROTOCOL_VERSION, code, self.boot_id, self.next_event(), software, name)
            case Verb.STATUS:
                return self._status()
            case Verb.PING:
                return (self._shown_us(),)
            case Verb.HB:
                self.safety.arm(arguments[0])
                return (self._shown_us(), self.next_event())
            case Verb.TELEM:
                if arguments[1] not in (1, 4):
                    raise RefusalError(ErrorCode.OUT_OF_RANGE)
                self.set_telemetry(arguments[0], arguments[1])
                return ()
            case Verb.RESET:
                self.safety.release()
                return ()
            case Verb.LASER:
                self.safety.switch(arguments[0])
                return ()
            case Verb.STOP:
                self.safety.halt(MotionEnd.STOPPED)
                return ()
            case _:
                return self._move(request.verb, arguments)

    def _move(self, verb: Verb, arguments: tuple[int, ...]) -> tuple[int, ...]:
        axis = AXES[arguments[0]] if verb in (Verb.SPEED, Verb.BOUNDS, Verb.MOVE, Verb.HOME) else "cart"
        match verb:
            case Verb.SPEED:
                self._motion.rate[axis], self._motion.acceleration[axis] = arguments[1:]
                return ()
            case Verb.BOUNDS:
                if arguments[1] > arguments[2]:
                    raise RefusalError(ErrorCode.OUT_OF_RANGE)
                self._motion.bounds[axis] = (arguments[1], arguments[2])
                return ()
            case Verb.MOVE:
                return (self._move_to(axis, arguments[1]),)
            case Verb.HOME:
                return (self._home(axis),)
            case Verb.SCAN:
                return (self._scan(*arguments),)
            case _:
                return (self._raster(*arguments),)

    # ------------------------------------------------------------------------------------------------------- movements

    def _move_to(self, axis: Axis, to: int) -> int:
        self._check_free((axis,))
        self._check_bounds(axis, to)
        if self._motion.blocked(axis, to):
            raise RefusalError(ErrorCode.LIMIT_ACTIVE)
        number = self._next_number()
        self._motion.start(axis, to, lambda reason, ticks: self._event(EventKind.MOTION_END, number, reason, ticks))
        return number

    def _home(self, axis: Axis) -> int:
        self._check_free((axis,))
        number = self._next_number()
        self.safety.known.discard(axis)
        if axis == "slide":
            program = self._new_program(number)
            self.safety.forget_edges()
            self._run(number, program, program.home_slide, axis)
        else:
            self._motion.renumber(axis, self._motion.count(axis))
            self.safety.known.add(axis)
            self._event(EventKind.MOTION_END, number, MotionEnd.DONE, self._clock.now())
        return number

    def _scan(self, first: int, last: int, rate_msteps_s: int, phases: int, phase_us: int) -> int:
        masks = tuple(int(digit) for digit in str(phases))
        if max(masks) > 3 or first == last or (len(masks) > 1 and phase_us < _LEAST_PHASE_US):
            raise RefusalError(ErrorCode.OUT_OF_RANGE)
        self._check_free(AXES)
        if any(masks):
            self.safety.check_heartbeat()
        self._check_known(("cart",))
        run_up = run_up_steps(first, last, rate_msteps_s, self._motion.acceleration["cart"])
        self._check_bounds("cart", first - run_up, last + run_up)

        def light(shining: bool, ticks: int) -> None:
            if shining:
                self._outputs.alternate(masks, phase_us * (TIMER_HZ // 1_000_000), ticks)
                self._event(EventKind.LASERS, self._outputs.mask(ticks), 0, ticks)
            else:
                self.safety.dark(ticks)

        number = self._next_number()
        program = self._new_program(number)
        self._run(number, program, lambda: program.laser_pass(first, last, rate_msteps_s, light))
        return number

    def _raster(
        self, cart_first: int, cart_last: int, advance: int, slide_first: int, slide_last: int, rate_msteps_s: int
    ) -> int:
        if slide_first == slide_last:
            raise RefusalError(ErrorCode.OUT_OF_RANGE)
        self._check_free(AXES)
        self._check_known(AXES)
        places = rows((cart_first, cart_last), advance)
        self._check_bounds("cart", places[0], places[-1])
        self._check_bounds("slide", slide_first, slide_last)
        number = self._next_number()
        program = self._new_program(number)
        cart, slide = (cart_first, cart_last), (slide_first, slide_last)
        self._run(number, program, lambda: program.raster(cart, advance, slide, rate_msteps_s))
        return number

    def _new_program(self, number: int) -> Program:
        return Program(self._clock, self._motion, lambda kind, b, ticks: self._event(kind, number, b, ticks))

    def _run(self, number: int, program: Program, course: Course, homes: Axis | None = None) -> None:
        self.safety.program = program

        async def run() -> None:
            reason = MotionEnd.DONE
            try:
                await course()
                if homes is not None:
                    self.safety.known.add(homes)
            except EndedEarlyError as end:
                reason = end.reason
            self.safety.program = self._task = None
            self.safety.dark(self._clock.now())
            self._event(EventKind.MOTION_END, number, reason, self._clock.now())

        self._task = asyncio.get_running_loop().create_task(run())

    def _next_number(self) -> int:
        self._motion_number = (self._motion_number + 1) % _MOTION_NUMBERS
        return self._motion_number

    def _check_free(self, axes: tuple[Axis, ...]) -> None:
        if self.safety.latch:
            raise RefusalError(ErrorCode.LATCHED)
        if self.safety.program is not None or any(self._motion.moving(axis) for axis in axes):
            raise RefusalError(ErrorCode.BUSY)

    def _check_bounds(self, axis: Axis, *counts: int) -> None:
        low, high = self._motion.bounds[axis]
        if axis in self.safety.known and not all(low <= count <= high for count in counts):
            raise RefusalError(ErrorCode.OUT_OF_RANGE)

    def _check_known(self, axes: tuple[Axis, ...]) -> None:
        if not self.safety.known.issuperset(axes):
            raise RefusalError(ErrorCode.NOT_HOMED)

    def _status(self) -> tuple[int, ...]:
        now = self._clock.now()
        return (
            self._clock.shown_us(now),
            self._motion.count("cart", now),
            self._motion.count("slide", now),
            self.reading(),
            int(self.flags(now)),
            int(self.safety.latch),
            self._motion_number,
            self.boot_id,
            self.next_event(),
        )

    def _shown_us(self) -> int:
        return self._clock.shown_us(self._clock.now())
