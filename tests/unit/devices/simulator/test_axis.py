"""Counts on the one hand, the carriage on the other."""

import pytest

from twinline.devices.serial.protocol_gen import TIMER_HZ
from twinline.devices.simulator.axis import Mechanics, SimulatedAxis
from twinline.devices.simulator.ramp import ramp, trapezoid

SHAPE = ramp(500_000, 2000)


def moved(axis: SimulatedAxis, to: int, start_ticks: int) -> int:
    """Move an axis and give the tick of the end."""
    movement = trapezoid(start_ticks, axis.count(start_ticks), to, SHAPE)
    axis.begin(movement)
    axis.end(movement.end_ticks)
    return movement.end_ticks


def test_the_past_can_be_asked_for() -> None:
    axis = SimulatedAxis(Mechanics(0.1), 0)
    first_end = moved(axis, 100, 1000)
    second_end = moved(axis, 0, first_end + 1000)
    assert axis.place_mm(second_end) == 0.0
    assert axis.place_mm(first_end) == pytest.approx(10.0)
    assert axis.place_mm(500) == 0.0
    assert 0.0 < axis.place_mm((1000 + first_end) // 2) < 10.0


def test_the_past_is_forgotten_after_a_while() -> None:
    axis = SimulatedAxis(Mechanics(0.1), 0)
    end = 0
    for number in range(1000):
        end = moved(axis, 50 * (number % 2 + 1), end + TIMER_HZ // 10)
    assert axis.place_mm(0) in (pytest.approx(5.0, abs=5.0), pytest.approx(10.0))
    assert len(axis._stretches) < 300


def test_drive_errors_are_in_the_true_place_only() -> None:
    axis = SimulatedAxis(Mechanics(0.1, scale_error=0.005, ripple_mm=0.03, ripple_period_mm=40.2), 0)
    end = moved(axis, 100, 0)
    assert axis.count(end) == 100
    assert axis.place_mm(end) == pytest.approx(10.05 + 0.03)


def test_a_stalled_motor_loses_its_steps_for_good() -> None:
    axis = SimulatedAxis(Mechanics(0.1), 0)
    movement = trapezoid(0, 0, 200, SHAPE)
    axis.begin(movement)
    middle = movement.time_of(100)
    place = axis.place_mm(middle)
    axis.stall(middle, True)
    axis.end(movement.end_ticks)
    assert axis.count(movement.end_ticks) == 200
    assert axis.place_mm(movement.end_ticks) == pytest.approx(place)
    axis.stall(movement.end_ticks + 1, False)
    end = moved(axis, 210, movement.end_ticks + 2)
    assert axis.place_mm(end) == pytest.approx(place + 1.0)


def test_nothing_goes_through_the_ends() -> None:
    axis = SimulatedAxis(Mechanics(0.1, stops_mm=(-1.0, 5.0)), 0)
    end = moved(axis, 100, 0)
    assert axis.place_mm(end) == pytest.approx(5.0)
    back = moved(axis, 90, end + 10)
    assert axis.place_mm(back) == pytest.approx(4.0)


@pytest.mark.parametrize(("start_mm", "to"), [(5.0, -120), (5.0, 120), (-1.0, 80), (11.0, -30), (-1.0, 200)])
def test_limit_switches_change_at_the_step_that_reaches_them(start_mm: float, to: int) -> None:
    axis = SimulatedAxis(Mechanics(0.1, switches_mm=(0.0, 10.0), start_mm=start_mm), 0)
    movement = trapezoid(0, 0, to, SHAPE)
    axis.begin(movement)
    told = [ticks := 0]
    while (change := axis.next_switch_ticks(ticks)) is not None:
        told.append(ticks := change)
    seen = [0]
    for step in range(1, movement.steps + 1):
        ticks = movement.time_of(step)
        if axis.pressed(ticks) != axis.pressed(ticks - 1):
            seen.append(ticks)
    assert told == seen
    assert len(seen) > 1


def test_a_new_zero_moves_nothing() -> None:
    axis = SimulatedAxis(Mechanics(0.1, start_mm=3.0), 0)
    end = moved(axis, 20, 0)
    axis.renumber(end + 1, -20)
    assert axis.count(end + 2) == 0
    assert axis.place_mm(end + 2) == pytest.approx(5.0)
