"""Losses that show in the camera's own time stamps."""

import numpy as np

from twinline.devices.cameras.stamp_gaps import StampGaps


def missing_in(stamps_s: list[float | None]) -> list[int]:
    gaps = StampGaps()
    return [gaps.missing(stamp_s) for stamp_s in stamps_s]


def regular(count: int, *, rate_hz: float = 25.0, start_s: float = 0.0) -> list[float | None]:
    return [start_s + number / rate_hz for number in range(count)]


def test_frames_left_out_are_counted_where_they_are_missing() -> None:
    stamps_s = [stamp for number, stamp in enumerate(regular(40)) if number not in {20, 30, 31, 32}]
    missing = missing_in(stamps_s)
    assert missing[20] == 1
    assert missing[29] == 3
    assert sum(missing) == 4


def test_jitter_of_the_stamps_is_no_loss() -> None:
    rng = np.random.default_rng(20261122)
    stamps_s: list[float | None] = (np.arange(200) / 25.0 + rng.uniform(-0.004, 0.004, 200)).tolist()
    assert not any(missing_in(stamps_s))


def test_a_slower_rate_is_learnt() -> None:
    missing = missing_in(regular(30) + regular(30, rate_hz=12.5, start_s=1.24))
    assert 0 < sum(missing) <= 8
    assert not any(missing[-20:])


def test_a_pause_that_is_no_whole_number_of_steps_is_no_loss() -> None:
    assert not any(missing_in(regular(20) + regular(20, start_s=0.86)))


def test_stamps_that_are_absent_or_run_back_are_no_loss() -> None:
    assert not any(missing_in([*regular(20), None, *regular(5, start_s=2.0), 0.0, 5.0]))
