"""Events in order, whatever the wire makes of them."""

from hypothesis import given
from hypothesis import strategies as st

from twinline.devices.serial.codec import WireEvent
from twinline.devices.serial.event_order import EventOrder
from twinline.devices.serial.protocol_gen import EVENTS_KEPT, EventKind


def event(n: int) -> WireEvent:
    return WireEvent(n, 0, EventKind.LIMIT, 0, 0, 0, 0)


def numbers(events: list[WireEvent]) -> list[int]:
    return [item.n for item in events]


@given(st.lists(st.integers(0, EVENTS_KEPT - 1), max_size=200))
def test_what_comes_out_is_in_order_and_without_gaps(arriving: list[int]) -> None:
    order = EventOrder()
    given_out = [n for arrived in arriving for n in numbers(order.take(event(arrived)))]
    assert given_out == list(range(order.expected))
    assert order.expected == next(n for n in range(EVENTS_KEPT + 1) if n not in arriving)
    assert order.waiting == any(n > order.expected for n in arriving)


@given(st.lists(st.integers(0, EVENTS_KEPT - 1), max_size=60), st.integers(0, EVENTS_KEPT))
def test_what_is_given_up_is_counted(arriving: list[int], first: int) -> None:
    order = EventOrder()
    given_out = [n for arrived in arriving for n in numbers(order.take(event(arrived)))]
    late, lost = order.skip_to(first)
    given_out += numbers(late)
    assert given_out == sorted(set(given_out))
    assert lost == sum(n not in given_out for n in range(first))
    assert order.expected >= first


def test_an_event_far_ahead_is_left_to_be_asked_for() -> None:
    order = EventOrder()
    assert order.take(event(EVENTS_KEPT)) == []
    assert not order.waiting


def test_after_a_new_beginning_nothing_old_counts() -> None:
    order = EventOrder()
    order.take(event(3))
    order.begin(2)
    assert order.take(event(2)) == [event(2)]
    assert order.expected == 3
