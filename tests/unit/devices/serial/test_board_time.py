"""Host time out of the board's."""

from random import Random

import pytest

from twinline.devices.serial.board_time import BoardTime
from twinline.devices.serial.codec import TIME_WRAP_US

BAUD = 115200
ASKED, ANSWERED = 12, 25


def exchange(clock: BoardTime, host_s: float, board_s: float, *, up_s: float = 0.0, down_s: float = 0.0) -> None:
    """The board answers at the given moment; the lines take their time, and the delays besides."""
    clock.add(
        int(board_s * 1e6) % TIME_WRAP_US,
        host_s - ASKED * 10 / BAUD - up_s,
        host_s + ANSWERED * 10 / BAUD + down_s,
        sent_bytes=ASKED,
        received_bytes=ANSWERED,
    )


def test_an_exchange_without_delay_gives_the_exact_offset() -> None:
    clock = BoardTime(BAUD)
    exchange(clock, 1000.0, 5.0)
    assert clock.host_time_s(6.5) == pytest.approx(1001.5, abs=1e-6)


def test_the_fastest_of_many_exchanges_is_believed() -> None:
    random, clock = Random(3), BoardTime(BAUD)
    for number in range(100):
        lucky = number == 37
        up_s, down_s = (0.0, 0.0) if lucky else (random.uniform(0.001, 0.01), random.uniform(0.001, 0.05))
        exchange(clock, 1000.0 + number * 0.01, 5.0 + number * 0.01, up_s=up_s, down_s=down_s)
    assert clock.host_time_s(7.0) == pytest.approx(1002.0, abs=2e-6)


@pytest.mark.parametrize("drift_ppm", [-80.0, 0.0, 80.0])
def test_a_drifting_quartz_is_followed_within_20_us(drift_ppm: float) -> None:
    random, clock, rate = Random(5), BoardTime(BAUD), 1.0 + drift_ppm * 1e-6
    for number in range(1, 6000):
        since = number * 0.1
        exchange(clock, 1000.0 + since, since * rate, up_s=random.expovariate(5000), down_s=random.expovariate(2000))
        if number > 600:
            error = clock.host_time_s((since + 0.05) * rate) - (1000.05 + since)
            assert abs(error) < 2e-4, number
    errors = [clock.host_time_s((599.9 + ahead) * rate) - (1599.9 + ahead) for ahead in (0.0, 0.1)]
    assert max(map(abs, errors)) < 1e-4


def test_the_wrap_after_71_minutes_is_unwrapped() -> None:
    clock = BoardTime(BAUD)
    start_s = TIME_WRAP_US * 1e-6 - 2.0
    for number in range(40):
        exchange(clock, 1000.0 + number * 0.1, start_s + number * 0.1)
        assert clock.host_time_s(start_s + number * 0.1) == pytest.approx(1000.0 + number * 0.1, abs=1e-5)
    late_us = round((start_s + 3.5) * 1e6) % TIME_WRAP_US
    assert clock.unwrap_s(late_us, 1003.5) == pytest.approx(start_s + 3.5, abs=1e-5)
    early_us = round((start_s + 1.5) * 1e6) % TIME_WRAP_US
    assert clock.unwrap_s(early_us, 1003.6) == pytest.approx(start_s + 1.5, abs=1e-5)


def test_a_link_that_was_away_for_hours_still_unwraps() -> None:
    clock = BoardTime(BAUD)
    exchange(clock, 1000.0, 10.0)
    exchange(clock, 1000.0 + 3 * 4294.967296 + 5.0, 15.0 + 3 * 4294.967296)
    assert clock.host_time_s(15.0 + 3 * 4294.967296) == pytest.approx(1005.0 + 3 * 4294.967296, abs=1e-5)


def test_after_a_restart_of_the_board_nothing_old_counts() -> None:
    clock = BoardTime(BAUD)
    exchange(clock, 1000.0, 500.0)
    clock.restart()
    assert not clock.known
    exchange(clock, 1100.0, 0.5)
    assert clock.host_time_s(1.0) == pytest.approx(1100.5, abs=1e-6)


def test_a_link_that_is_faster_than_its_bit_rate_is_not_misjudged() -> None:
    clock = BoardTime(BAUD)
    clock.add(5_000_000, 999.9999, 1000.0002, sent_bytes=ASKED, received_bytes=ANSWERED)
    assert clock.host_time_s(6.0) == pytest.approx(1001.0, abs=2e-4)
