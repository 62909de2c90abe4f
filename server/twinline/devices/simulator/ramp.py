"""When each step of a movement is taken: trapezoids of speed in whole timer ticks.

References
----------
David Austin, "Generate stepper-motor speed profiles in real time", Embedded Systems Programming, January 2005,
equation 13 (``c_n = c_{n-1} - 2 c_{n-1} / (4 n + 1)``, the remainder carried on) with the correction 0.676 of the first
interval; the same is in Atmel's application note AVR446.
"""

from bisect import bisect_right
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import accumulate
from math import isqrt

from twinline.devices.serial.protocol_gen import POSITION_FRACTION, TIMER_HZ


@dataclass(frozen=True)
class Ramp:
    """Acceleration from rest.

    Attributes
    ----------
    intervals
        Ticks before each of its steps.
    times
        Ticks from the start to each of its steps.
    cruise_ticks
        Interval of the steps after it.
    """

    intervals: tuple[int, ...]
    times: tuple[int, ...]
    cruise_ticks: int


@lru_cache(maxsize=64)
def ramp(rate_msteps_s: int, acceleration_steps_s2: int) -> Ramp:
    """Acceleration from rest to a rate, in thousandths of a step per second."""
    cruise_ticks = max(1, TIMER_HZ * 1000 // rate_msteps_s)
    interval = isqrt(2 * TIMER_HZ * TIMER_HZ // acceleration_steps_s2) * 676 // 1000
    remainder = 0
    intervals: list[int] = []
    while interval > cruise_ticks:
        intervals.append(interval)
        divisor = 4 * len(intervals) + 1
        change, remainder = divmod(2 * interval + remainder, divisor)
        interval -= change
    if not intervals:
        intervals.append(cruise_ticks)
    return Ramp(tuple(intervals), tuple(accumulate(intervals)), cruise_ticks)


def stopping_steps(rate_msteps_s: int, acceleration_steps_s2: int) -> int:
    """Steps that reaching a rate takes, and so does braking from it."""
    return len(ramp(rate_msteps_s, acceleration_steps_s2).intervals)


@dataclass(frozen=True)
class Trapezoid:
    """A movement: so many steps up the ramp, at constant rate, and down the ramp again.

    Attributes
    ----------
    start_ticks
        When its timer starts.
    first
        Count before it.
    sign
        +1 or -1.
    ramp
        Its ramp.
    up, cruise, down
        Steps of its three parts.
    cut_ticks
        When it was cut off; none of its steps comes after this.
    """

    start_ticks: int
    first: int
    sign: int
    ramp: Ramp
    up: int
    cruise: int
    down: int
    cut_ticks: int | None = None

    @property
    def steps(self) -> int:
        """Steps that it takes."""
        whole = self.up + self.cruise + self.down
        return whole if self.cut_ticks is None else self._taken(self.cut_ticks, whole)

    @property
    def last(self) -> int:
        """Count after it."""
        return self.first + self.sign * self.steps

    @property
    def end_ticks(self) -> int:
        """When it takes its last step, or was cut off."""
        return self.cut_ticks if self.cut_ticks is not None else self.time_of(self.steps)

    def time_of(self, step: int) -> int:
        """When it takes a step, the first being 1; 0 is the start."""
        if step <= 0:
            return self.start_ticks
        if step <= self.up:
            return self.start_ticks + self.ramp.times[step - 1]
        cruising = min(step - self.up, self.cruise) * self.ramp.cruise_ticks
        braking = step - self.up - self.cruise
        time = self.start_ticks + self.ramp.times[self.up - 1] + cruising
        if braking > 0:
            left = self.down - braking
            time += self.ramp.times[self.down - 1] - (self.ramp.times[left - 1] if left else 0)
        return time

    def taken(self, ticks: int) -> int:
        """Steps that it has taken by a time."""
        if self.cut_ticks is not None:
            ticks = min(ticks, self.cut_ticks)
        return self._taken(ticks, self.up + self.cruise + self.down)

    def _taken(self, ticks: int, whole: int) -> int:
        since = ticks - self.start_ticks
        up_ticks = self.ramp.times[self.up - 1]
        if since < up_ticks:
            return bisect_right(self.ramp.times, since) if since >= 0 else 0
        cruising = (since - up_ticks) // self.ramp.cruise_ticks
        if cruising < self.cruise:
            return self.up + cruising
        left = self.time_of(whole) - ticks
        if left <= 0:
            return whole
        # Read backwards, braking is an acceleration, of which so many steps are still to come.
        return whole - self._still_to_come(left)

    def _still_to_come(self, left: int) -> int:
        # A step at the very moment has been taken; the ramp's last interval precedes the last step.
        to_come = 1 + bisect_right(self.ramp.times, left - 1, 0, self.down)
        return min(to_come, self.down)

    def count(self, ticks: int) -> int:
        """Count at a time."""
        return self.first + self.sign * self.taken(ticks)

    def reported(self, ticks: int) -> int:
        """Count at a time in `POSITION_FRACTION` parts of a step, by how far the timer is through the present one."""
        step = self.taken(ticks)
        whole = POSITION_FRACTION * (self.first + self.sign * step)
        if step == 0 or step >= self.steps or ticks >= self.end_ticks:
            return whole
        begin, end = self.time_of(step), self.time_of(step + 1)
        part = POSITION_FRACTION * (ticks - begin) // (end - begin) - POSITION_FRACTION // 2
        return whole + self.sign * part

    def position(self, ticks: int) -> float:
        """Where a rotor that follows without overshoot is, in steps.

        It passes each count in the middle between that step and the next, and stands when the last step is taken.
        """
        if ticks >= self.end_ticks:
            return self.last
        step = self.taken(ticks)
        middle = self._middle(step)
        if ticks >= middle:
            before, begin, end = step, middle, self._middle(step + 1)
        elif step == 0:
            return self.first
        else:
            before, begin, end = step - 1, self._middle(step - 1), middle
        return self.first + self.sign * (before + (ticks - begin) / (end - begin))

    def _middle(self, step: int) -> float:
        whole = self.up + self.cruise + self.down
        return self.time_of(step) if step >= whole else (self.time_of(step) + self.time_of(step + 1)) / 2

    def braked(self, ticks: int) -> "Trapezoid":
        """The same movement, slowed down from a time on with the ramp's deceleration."""
        taken = self.taken(ticks)
        if taken < self.up:
            shorter = replace(self, up=taken + 1, cruise=0, down=taken + 1)
        elif taken < self.up + self.cruise:
            shorter = replace(self, cruise=taken + 1 - self.up, down=self.up)
        else:
            return self
        return shorter if shorter.steps < self.steps else self

    def cut(self, ticks: int) -> "Trapezoid":
        """The same movement without any step after a time."""
        return replace(self, cut_ticks=max(self.start_ticks, min(ticks, self.end_ticks)))


def trapezoid(start_ticks: int, first: int, to: int, shape: Ramp) -> Trapezoid:
    """The movement from a count to another one, at least one step away."""
    steps = abs(to - first)
    if steps == 0:
        raise ValueError("a movement needs at least one step")
    up = min(len(shape.intervals), (steps + 1) // 2)
    down = min(len(shape.intervals), steps - up)
    return Trapezoid(start_ticks, first, 1 if to > first else -1, shape, up, steps - up - down, down)
