"""From arrivals and the camera's stamps to times of mid-exposure."""

from itertools import pairwise

import numpy as np
import pytest

from twinline.devices.cameras.host_times import HostTimes


def test_without_stamps_it_is_the_arrival_less_latency_and_half_the_exposure() -> None:
    times = HostTimes(0.030)
    assert times.mid_exposure_s(10.0, None, 0.008) == pytest.approx(9.966)
    assert times.mid_exposure_s(10.04, None, None) == pytest.approx(10.010)


def test_stamps_take_the_jitter_of_the_network_out() -> None:
    rng = np.random.default_rng(20261122)
    times = HostTimes(0.0)
    stamps_s = 500.0 + np.arange(400) / 25.0
    # Most frames come at once, some are held up by as much as 200 ms.
    arrivals_s = stamps_s + 1234.5 + rng.exponential(0.005, 400) + (rng.random(400) < 0.05) * 0.2
    found_s = [times.mid_exposure_s(a, s, None) for a, s in zip(arrivals_s, stamps_s, strict=True)]
    error_s = np.array(found_s)[100:] - (stamps_s + 1234.5)[100:]
    # 125 frames lie in the window; the smallest of so many delays is 5 ms / 125 on average.
    assert error_s.min() >= 0.0
    assert error_s.max() < 0.0005


@pytest.mark.parametrize("off_ppm", [-100.0, 100.0])
def test_a_camera_clock_that_runs_wrong_is_followed(off_ppm: float) -> None:
    times = HostTimes(0.0)
    true_s = np.arange(3000) / 25.0
    found_s = [times.mid_exposure_s(t, 7.0 + t * (1 + 1e-6 * off_ppm), None) for t in true_s]
    # Over the window of 5 s such a clock goes wrong by 0.5 ms.
    assert np.abs(np.array(found_s) - true_s).max() < 0.00051


def test_a_camera_that_starts_again_gets_a_new_offset() -> None:
    times = HostTimes(0.0)
    for number in range(50):
        times.mid_exposure_s(100.0 + number / 25, 9000.0 + number / 25, None)
    assert times.mid_exposure_s(103.0, 0.5, None) == pytest.approx(103.0)
    assert times.mid_exposure_s(103.04, 0.54, None) == pytest.approx(103.04)


def test_stamps_that_stand_still_are_not_believed() -> None:
    times = HostTimes(0.0)
    found_s = [times.mid_exposure_s(10.0 + number / 25, 77.0, None) for number in range(10)]
    np.testing.assert_allclose(found_s, 10.0 + np.arange(10) / 25)


def test_times_never_stand_still_or_run_back() -> None:
    times = HostTimes(0.0)
    found_s = [times.mid_exposure_s(arrival_s, None, None) for arrival_s in (5.0, 5.0, 4.9, 5.1)]
    assert all(a < b for a, b in pairwise(found_s))
    assert found_s[-1] == 5.1


def test_after_a_restart_the_old_offset_is_forgotten() -> None:
    times = HostTimes(0.0)
    times.mid_exposure_s(10.0, 3.0, None)
    times.restart()
    assert times.mid_exposure_s(11.0, 3.5, None) == pytest.approx(11.0)
