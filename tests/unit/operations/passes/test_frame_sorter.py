"""Which frames belong to a pass, and which laser they show."""

from collections.abc import Iterable

import pytest

from twinline.devices.board import BoardEvent, LaserPass, Telemetry
from twinline.devices.camera import CameraFrame
from twinline.devices.serial.protocol_gen import EventKind, Flag
from twinline.operations.passes.frame_sorter import FrameSorter

BOTH = frozenset({1, 2})


def frame(time_s: float, exposure_s: float = 0.01) -> CameraFrame:
    return CameraFrame(int(time_s * 1000), time_s, exposure_s, "gray8", b"\0", (1, 1))


def telemetry(time_s: float, flags: Flag = Flag(0)) -> Telemetry:  # noqa: B008  (a constant)
    return Telemetry(0, time_s, time_s, 0.0, 0.0, 0, flags)


def event(kind: EventKind, time_s: float) -> BoardEvent:
    return BoardEvent(0, time_s, time_s, kind, 0.0, 0.0, 0, 0)


def sort(plan: LaserPass, arrivals: Iterable[object]) -> tuple[list[tuple[float, frozenset[int]]], FrameSorter]:
    kept: list[tuple[float, frozenset[int]]] = []
    sorter = FrameSorter(plan, lambda f, lasers: kept.append((f.host_time_s, lasers)))
    for arrival in arrivals:
        if isinstance(arrival, CameraFrame):
            sorter.frame(arrival)
        elif isinstance(arrival, Telemetry | BoardEvent):
            sorter.message(arrival)
    return kept, sorter


STEADY = LaserPass(0.0, 10.0, 5.0)
LIT = Flag.LASER_1 | Flag.LASER_2
START, END = event(EventKind.SCAN_START, 1.0), event(EventKind.SCAN_END, 2.0)


def test_frames_from_within_the_lit_range_are_kept_whoever_tells_of_it_first() -> None:
    frames = [frame(t) for t in (0.9, 1.1, 1.5, 1.9, 2.1)]
    late_board = [*frames, START, END, telemetry(3.0)]
    early_board = [START, telemetry(1.6), *frames, END, telemetry(3.0)]
    for arrivals in (late_board, early_board):
        kept, sorter = sort(STEADY, arrivals)
        assert kept == [(1.1, BOTH), (1.5, BOTH), (1.9, BOTH)]
        assert sorter.complete


def test_a_frame_waits_until_the_board_has_told_of_its_time() -> None:
    kept, _ = sort(STEADY, [START, telemetry(1.2, LIT), frame(1.3)])
    assert not kept
    kept, _ = sort(STEADY, [START, telemetry(1.2, LIT), frame(1.3), telemetry(1.4, LIT)])
    assert [time for time, _ in kept] == [1.3]


@pytest.mark.parametrize("time_s", [0.996, 1.004, 1.996, 2.004])
def test_an_exposure_across_an_end_of_the_range_is_not_kept(time_s: float) -> None:
    assert not sort(STEADY, [START, END, frame(time_s), telemetry(3.0)])[0]


def test_the_leg_is_complete_only_once_a_frame_from_beyond_it_has_come() -> None:
    assert not sort(STEADY, [START, frame(1.5), END, telemetry(3.0)])[1].complete
    assert sort(STEADY, [START, frame(1.5), END, telemetry(3.0), frame(2.2)])[1].complete


def test_a_movement_that_ends_early_ends_the_range() -> None:
    cut = event(EventKind.MOTION_END, 1.4)
    kept, sorter = sort(STEADY, [START, frame(1.3), frame(1.5), cut, telemetry(3.0)])
    assert [time for time, _ in kept] == [1.3]
    assert sorter.complete


def test_alternating_lasers_are_told_apart_and_a_switch_within_an_exposure_counts_for_neither() -> None:
    plan = LaserPass(0.0, 10.0, 5.0, (frozenset({1}), frozenset({2})), 0.08)
    times = [1.02, 1.06, 1.08, 1.10, 1.14, 1.18]
    kept, _ = sort(plan, [START, *(frame(t) for t in times), telemetry(1.9, LIT)])
    assert kept == [
        (1.02, {1}),
        (1.06, {1}),
        (1.08, frozenset()),
        (1.10, {2}),
        (1.14, {2}),
        (1.18, {1}),
    ]


def test_frames_wait_for_a_beginning_that_comes_late() -> None:
    """The event was lost and is sent again, while telemetry tells of light already."""
    early = [telemetry(0.9), frame(1.1), telemetry(1.2, LIT), frame(1.3), telemetry(1.4, LIT)]
    assert not sort(STEADY, early)[0]
    kept, _ = sort(STEADY, [*early, START])
    assert [time for time, _ in kept] == [1.1, 1.3]


def test_dark_frames_are_not_taken_for_lit_ones_while_the_end_is_on_its_way() -> None:
    late = [START, frame(1.5), telemetry(1.6, LIT), frame(2.1), telemetry(2.2), frame(2.3), telemetry(2.4)]
    kept, sorter = sort(STEADY, late)
    assert [time for time, _ in kept] == [1.5]
    assert not sorter.complete
    kept, sorter = sort(STEADY, [*late, END])
    assert [time for time, _ in kept] == [1.5]
    assert sorter.complete


def test_a_stop_ends_the_range_when_the_light_goes_off_not_when_the_cart_stands() -> None:
    dark, stands = event(EventKind.LASERS, 1.4), event(EventKind.MOTION_END, 1.8)
    kept, _ = sort(STEADY, [START, frame(1.3), frame(1.5), frame(1.7), dark, stands, telemetry(2.0)])
    assert [time for time, _ in kept] == [1.3]
