"""The simulated board's movements: begun, braked, cut off, ended in time, and what the limit switches do meanwhile."""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from twinline.devices.board import AXES, Axis
from twinline.devices.serial.protocol_gen import (
    DEFAULT_ACCELERATION_STEPS_S2,
    DEFAULT_RATE_MSTEPS_S,
    AxisNumber,
    MotionEnd,
)
from twinline.devices.simulator.axis import SimulatedAxis
from twinline.devices.simulator.board_clock import SimulatedClock
from twinline.devices.simulator.ramp import ramp, trapezoid

UNBOUNDED = (-(10**7), 10**7)
Ended: TypeAlias = Callable[[MotionEnd, int], None]
"""Told how and when a movement ended."""


@dataclass
class _Run:
    done: Ended
    reason: MotionEnd = MotionEnd.DONE


class BoardMotion:
    """Both axes.

    Parameters
    ----------
    clock
        The board's time.
    axes
        The axes.
    on_switch
        Told of each change of a limit switch: 0 for low or 1 for high, whether it is pressed, and when.
    """

    def __init__(
        self,
        clock: SimulatedClock,
        axes: Mapping[Axis, SimulatedAxis],
        on_switch: Callable[[int, bool, int], None],
    ) -> None:
        self._clock = clock
        self._axes = axes
        self._on_switch = on_switch
        self._forced: tuple[bool | None, bool | None] = (None, None)
        self._runs: dict[Axis, _Run] = {}
        self._timers: dict[Axis, asyncio.TimerHandle] = {}
        self.pressed = (False, False)
        self.restart()

    def restart(self) -> None:
        """Forget settings and counts and stand still, as a restart of the board does."""
        now = self._clock.now()
        self._runs.clear()
        for axis, carriage in self._axes.items():
            self._halt_timer(axis)
            if carriage.movement is not None:
                carriage.replace(carriage.movement.cut(now))
                carriage.end(now)
            carriage.renumber(now, -carriage.count(now))
        self.rate = {axis: DEFAULT_RATE_MSTEPS_S[number_of(axis)] for axis in AXES}
        self.acceleration = {axis: DEFAULT_ACCELERATION_STEPS_S2[number_of(axis)] for axis in AXES}
        self.bounds = dict.fromkeys(AXES, UNBOUNDED)
        self.pressed = self._pressed(now)

    def count(self, axis: Axis, ticks: int | None = None) -> int:
        """Count of an axis, in steps."""
        return self._axes[axis].count(self._clock.now() if ticks is None else ticks)

    def moving(self, axis: Axis) -> bool:
        """Whether an axis moves."""
        return axis in self._runs

    def heading(self, axis: Axis) -> int:
        """Direction of an axis: +1, -1, or 0 at rest."""
        movement = self._axes[axis].movement
        return 0 if movement is None else movement.sign

    def start(self, axis: Axis, to: int, done: Ended, *, rate_msteps_s: int | None = None) -> None:
        """Begin a movement; ``done`` is called at its end, not from within."""
        now = self._clock.now()
        carriage = self._axes[axis]
        run = _Run(done)
        self._runs[axis] = run
        if to == carriage.count(now):
            self._timers[axis] = self._clock.call_at(now, lambda: self._finish(axis, now))
            return
        shape = ramp(rate_msteps_s or self.rate[axis], self.acceleration[axis])
        carriage.begin(trapezoid(now, carriage.count(now), to, shape))
        self._schedule(axis)

    def blocked(self, axis: Axis, to: int) -> bool:
        """Whether a movement would lead into a limit switch that is pressed."""
        if axis != "slide":
            return False
        count = self.count(axis)
        return (self.pressed[0] and to < count) or (self.pressed[1] and to > count)

    def time_at(self, axis: Axis, count: int) -> int:
        """When the present movement of an axis reaches a count."""
        movement = self._axes[axis].movement
        if movement is None:
            raise ValueError(f"the {axis} does not move")
        return movement.time_of(abs(count - movement.first))

    def brake(self, reason: MotionEnd, axes: tuple[Axis, ...] = AXES, *, ticks: int | None = None) -> None:
        """Slow axes down, now or from a time just past."""
        ticks = self._clock.now() if ticks is None else ticks
        for axis in axes:
            movement = self._axes[axis].movement
            if movement is not None and axis in self._runs:
                braked = movement.braked(ticks)
                if braked is not movement:
                    self._runs[axis].reason = reason
                    self._axes[axis].replace(braked)
                    self._schedule(axis)

    def cut(self, reason: MotionEnd) -> None:
        """Stop both axes dead; the counts stay exact, the places may not."""
        now = self._clock.now()
        for axis, run in list(self._runs.items()):
            movement = self._axes[axis].movement
            if movement is not None:
                run.reason = reason
                self._axes[axis].replace(movement.cut(now))
            self._finish(axis, now)

    def renumber(self, axis: Axis, zero: int) -> None:
        """Make a count of an axis at rest the new zero."""
        self._axes[axis].renumber(self._clock.now(), -zero)

    def stall(self, stalled: frozenset[Axis]) -> None:
        """Let the motors of these axes lose their steps, and of no others."""
        now = self._clock.now()
        for axis, carriage in self._axes.items():
            carriage.stall(now, axis in stalled)
            if axis in self._runs and carriage.movement is not None:
                self._schedule(axis)

    def force_switches(self, low: bool | None, high: bool | None) -> None:
        """Let limit switches tell something else than the truth; None for the truth."""
        self._forced = (low, high)
        self._look_at_switches(self._clock.now())

    def _schedule(self, axis: Axis) -> None:
        self._halt_timer(axis)
        self._timers[axis] = self._clock.call_at(self._next_ticks(axis), lambda: self._due(axis))

    def _next_ticks(self, axis: Axis) -> int:
        movement = self._axes[axis].movement
        if movement is None:
            return self._clock.now()
        switch = self._axes[axis].next_switch_ticks(self._looked_ticks)
        return movement.end_ticks if switch is None else min(switch, movement.end_ticks)

    def _due(self, axis: Axis) -> None:
        carriage, now = self._axes[axis], self._clock.now()
        # A late call finds several switch edges behind it; each is dealt with at its own time.
        while (ticks := self._axes["slide"].next_switch_ticks(self._looked_ticks)) is not None and ticks <= now:
            self._look_at_switches(ticks)
        if carriage.movement is not None and carriage.movement.end_ticks <= now:
            self._finish(axis, carriage.movement.end_ticks)
        elif axis in self._runs:
            self._schedule(axis)

    def _finish(self, axis: Axis, ticks: int) -> None:
        self._halt_timer(axis)
        self._axes[axis].end(ticks)
        run = self._runs.pop(axis)
        run.done(run.reason, ticks)

    def _look_at_switches(self, ticks: int) -> None:
        self._looked_ticks = ticks
        before, self.pressed = self.pressed, self._pressed(ticks)
        for side, (was, now) in enumerate(zip(before, self.pressed, strict=True)):
            if was != now:
                self._on_switch(side, now, ticks)

    def _pressed(self, ticks: int) -> tuple[bool, bool]:
        self._looked_ticks = ticks
        low, high = self._axes["slide"].pressed(ticks)
        forced_low, forced_high = self._forced
        return (low if forced_low is None else forced_low, high if forced_high is None else forced_high)

    def _halt_timer(self, axis: Axis) -> None:
        timer = self._timers.pop(axis, None)
        if timer is not None:
            timer.cancel()


def number_of(axis: Axis) -> AxisNumber:
    """The axis's number on the wire."""
    return AxisNumber.CART if axis == "cart" else AxisNumber.SLIDE
