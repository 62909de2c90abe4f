"""One simulated axis: what the board counts, and where the carriage truly is."""

from collections import deque
from dataclasses import dataclass, replace
from math import ceil, floor, inf, pi, sin

from twinline.devices.serial.protocol_gen import POSITION_FRACTION, TIMER_HZ
from twinline.devices.simulator.ramp import Trapezoid

_REMEMBERED_TICKS = 15 * TIMER_HZ


@dataclass(frozen=True)
class Mechanics:
    """An axis as it truly is.

    Attributes
    ----------
    mm_per_step
        Travel of a step by the drawings.
    scale_error
        Share by which a step is longer than that.
    ripple_mm
        Amplitude of a periodic error of position, so of a ripple of speed: a wheel or pulley that does not run true.
    ripple_period_mm
        Travel of one period.
    switches_mm
        True places of the low and the high limit switch, or none.
    stops_mm
        True places of the ends, at which the carriage can go no further and the motor loses steps.
    start_mm
        True place at power-on.
    """

    mm_per_step: float
    scale_error: float = 0.0
    ripple_mm: float = 0.0
    ripple_period_mm: float = 100.53
    switches_mm: tuple[float, float] | None = None
    stops_mm: tuple[float, float] = (-inf, inf)
    start_mm: float = 0.0

    @property
    def true_mm_per_step(self) -> float:
        """Travel of a step on average."""
        return self.mm_per_step * (1.0 + self.scale_error)

    def place_mm(self, steps: float) -> float:
        """True place, mm, of a position in steps."""
        travelled = steps * self.true_mm_per_step
        return travelled + self.ripple_mm * sin(2.0 * pi * travelled / self.ripple_period_mm)

    def steps_at(self, place_mm: float) -> float:
        """Position in steps of a place, without the ripple."""
        return place_mm / self.true_mm_per_step


@dataclass(frozen=True)
class _Stretch:
    """What holds from a time on: a movement or rest, and how counts translate into true positions.

    ``slip`` is the true position less the count, in steps. Where ``stuck_at`` is not None, the axis stands there
    whatever the count.
    """

    begin_ticks: int
    movement: Trapezoid | None
    count: int
    slip: float
    stuck_at: float | None = None


class SimulatedAxis:
    """An axis that moves analytically: every question is answered from the time asked for.

    Parameters
    ----------
    mechanics
        What it is like.
    ticks
        The present time.
    """

    def __init__(self, mechanics: Mechanics, ticks: int) -> None:
        self.mechanics = mechanics
        self._low = mechanics.steps_at(mechanics.stops_mm[0])
        self._high = mechanics.steps_at(mechanics.stops_mm[1])
        start = _Stretch(ticks, None, 0, mechanics.steps_at(mechanics.start_mm))
        self._stretches: deque[_Stretch] = deque([start])

    @property
    def movement(self) -> Trapezoid | None:
        """The present movement."""
        return self._stretches[-1].movement

    def count(self, ticks: int) -> int:
        """What the board counts, in steps, at the present or a little earlier."""
        now = self._stretches[-1]
        return now.count if now.movement is None else now.movement.count(ticks)

    def reported(self, ticks: int) -> int:
        """The same with its fraction, in `POSITION_FRACTION` parts of a step."""
        now = self._stretches[-1]
        return POSITION_FRACTION * now.count if now.movement is None else now.movement.reported(ticks)

    def place_mm(self, ticks: int) -> float:
        """True place, mm, now or in the recent past."""
        stretch = self._stretches[-1]
        if ticks < stretch.begin_ticks:
            stretch = self._stretch_at(ticks)
        return self.mechanics.place_mm(self._position(stretch, ticks))

    def begin(self, movement: Trapezoid) -> None:
        """Start a movement."""
        self._change(movement.start_ticks, movement=movement)

    def replace(self, movement: Trapezoid) -> None:
        """Let the present movement end otherwise."""
        self._stretches[-1] = replace(self._stretches[-1], movement=movement)

    def end(self, ticks: int) -> None:
        """End the present movement at a time when it has taken its last step."""
        now = self._stretches[-1]
        if now.movement is None:
            return
        count = now.movement.last
        position = self._position(now, max(ticks, now.movement.end_ticks))
        slip = now.slip if now.stuck_at is not None else position - count
        self._change(ticks, movement=None, count=count, slip=slip)

    def renumber(self, ticks: int, shift: int) -> None:
        """Add to the count at rest without moving."""
        now = self._stretches[-1]
        self._change(ticks, count=now.count + shift, slip=now.slip - shift)

    def stall(self, ticks: int, stalled: bool) -> None:
        """Let the motor lose every step from now on, or hold again where the carriage stands."""
        now = self._stretches[-1]
        if stalled == (now.stuck_at is not None):
            return
        if now.stuck_at is None:
            self._change(ticks, stuck_at=self._position(now, ticks))
        else:
            counted = now.count if now.movement is None else now.movement.position(ticks)
            self._change(ticks, slip=now.stuck_at - counted, stuck_at=None)

    def pressed(self, ticks: int) -> tuple[bool, bool]:
        """Whether the carriage presses the low and the high limit switch."""
        switches = self.mechanics.switches_mm
        if switches is None:
            return False, False
        now = self._stretches[-1]
        position = now.stuck_at if now.stuck_at is not None else self.count(ticks) + now.slip
        low, high = (self.mechanics.steps_at(place) for place in switches)
        return position <= low, position >= high

    def next_switch_ticks(self, ticks: int) -> int | None:
        """When the present movement next presses or releases a limit switch."""
        now, switches = self._stretches[-1], self.mechanics.switches_mm
        if now.movement is None or now.stuck_at is not None or switches is None:
            return None
        movement = now.movement
        # Distances to the counts at which either switch changes, measured along the movement.
        low, high = (self.mechanics.steps_at(place) - now.slip - movement.first for place in switches)
        changes = (floor(low) + 1, ceil(high)) if movement.sign > 0 else (ceil(-low), floor(-high) + 1)
        times = [movement.time_of(step) for step in changes if movement.taken(ticks) < step <= movement.steps]
        return min(times, default=None)

    def _position(self, stretch: _Stretch, ticks: int) -> float:
        if stretch.stuck_at is not None:
            return stretch.stuck_at
        counted = stretch.count if stretch.movement is None else stretch.movement.position(ticks)
        return min(max(counted + stretch.slip, self._low), self._high)

    def _stretch_at(self, ticks: int) -> _Stretch:
        for stretch in reversed(self._stretches):
            if stretch.begin_ticks <= ticks:
                return stretch
        return self._stretches[0]

    def _change(self, ticks: int, **changes: object) -> None:
        self._stretches.append(replace(self._stretches[-1], begin_ticks=ticks, **changes))  # type: ignore[arg-type]
        while len(self._stretches) > 1 and self._stretches[1].begin_ticks < ticks - _REMEMBERED_TICKS:
            self._stretches.popleft()
