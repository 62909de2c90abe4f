"""Every step of a movement at its tick."""

from itertools import pairwise
from math import sqrt

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinline.devices.serial.protocol_gen import POSITION_FRACTION, TIMER_HZ
from twinline.devices.simulator.ramp import Trapezoid, ramp, stopping_steps, trapezoid

SHAPES = st.tuples(st.sampled_from([1000, 50_000, 497_368, 4_000_000]), st.sampled_from([100, 2000, 40_000, 10**6]))
MOVES = st.tuples(SHAPES.filter(lambda s: s[0] ** 2 / s[1] < 1e10), st.integers(-3000, 3000).filter(bool))


def movement(drawn: tuple[tuple[int, int], int], start_ticks: int = 777) -> Trapezoid:
    (rate, acceleration), steps = drawn
    return trapezoid(start_ticks, 5, 5 + steps, ramp(rate, acceleration))


def times(move: Trapezoid) -> list[int]:
    return [move.time_of(step) for step in range(1, move.steps + 1)]


@pytest.mark.parametrize(("rate", "acceleration"), [(500_000, 2000), (4_000_000, 40_000), (100_000, 100)])
def test_the_ramp_is_that_of_even_acceleration(rate: int, acceleration: int) -> None:
    shape = ramp(rate, acceleration)
    assert stopping_steps(rate, acceleration) == pytest.approx(rate**2 / 1e6 / 2 / acceleration, abs=1.5)
    # After n steps from rest under even acceleration t = sqrt(2 n / a); the first interval is shortened to 0.676 of its
    # own so that the recursion meets that from the second step on.
    early_s = 0.324 * sqrt(2 / acceleration)
    for step in range(2, len(shape.times), 3):
        assert shape.times[step - 1] / TIMER_HZ + early_s == pytest.approx(sqrt(2 * step / acceleration), rel=0.015)


@given(MOVES)
def test_a_movement_takes_exactly_its_steps_and_none_at_the_same_tick(drawn: tuple[tuple[int, int], int]) -> None:
    move = movement(drawn)
    assert (move.steps, move.last) == (abs(drawn[1]), 5 + drawn[1])
    assert all(before < after for before, after in pairwise([move.start_ticks, *times(move)]))


@given(MOVES)
def test_counts_change_at_the_very_ticks_of_the_steps(drawn: tuple[tuple[int, int], int]) -> None:
    move = movement(drawn)
    for step, ticks in enumerate(times(move), start=1):
        assert (move.taken(ticks - 1), move.taken(ticks)) == (step - 1, step)


@given(MOVES, st.floats(0, 1.1))
def test_braking_changes_nothing_that_has_happened_and_never_goes_further(
    drawn: tuple[tuple[int, int], int], part: float
) -> None:
    move = movement(drawn)
    now = move.start_ticks + round(part * (move.end_ticks - move.start_ticks))
    braked = move.braked(now)
    taken = move.taken(now)
    assert braked.taken(now) == taken
    assert taken <= braked.steps <= move.steps
    assert times(braked)[:taken] == times(move)[:taken]
    # The steps after it take as long as those by which the same rate was reached.
    assert braked.steps - taken <= len(move.ramp.intervals) + 1


@given(MOVES, st.floats(0, 1.1))
def test_cutting_off_keeps_the_count_exact(drawn: tuple[tuple[int, int], int], part: float) -> None:
    move = movement(drawn)
    now = move.start_ticks + round(part * (move.end_ticks - move.start_ticks))
    cut = move.cut(now)
    assert cut.steps == move.taken(now) == cut.taken(10**15)
    assert cut.position(10**15) == cut.last


@given(MOVES)
def test_the_rotor_passes_each_count_between_that_step_and_the_next(drawn: tuple[tuple[int, int], int]) -> None:
    move = movement(drawn)
    for step in range(1, move.steps):
        middle = (move.time_of(step) + move.time_of(step + 1)) // 2
        assert move.position(middle) == pytest.approx(move.count(middle), abs=0.01)
    assert move.position(move.start_ticks) == 5
    assert move.position(move.end_ticks) == move.last


def test_the_reported_fraction_follows_the_rotor_at_constant_rate() -> None:
    move = trapezoid(0, 0, 400, ramp(500_000, 2000))
    begin, end = move.time_of(move.up + 2), move.time_of(move.up + move.cruise - 2)
    for ticks in range(begin, end, 1117):
        assert move.reported(ticks) / POSITION_FRACTION == pytest.approx(move.position(ticks), abs=1 / 16)
    assert move.reported(move.end_ticks) == 400 * POSITION_FRACTION
