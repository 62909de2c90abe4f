"""Positions at any moment from telemetry, against motions that are known exactly."""

from collections.abc import Callable

import numpy as np
import pytest

from twinline.arrays import FloatArray
from twinline.recording.cart_track import CartTrack, cart_at

SPEED_MM_S = 50.0
RAMP_MM_S2 = 200.0
START_S = 1.0
LENGTH_S = 6.0
OFFSET_S = 1000.0
BUDGET_MM = 0.05
"""What the thesis's machine may add to a point that is found to 0.1 mm."""


def ramps(time_s: FloatArray) -> FloatArray:
    """A cart that stands, runs up, runs evenly, brakes and stands."""
    up_s = SPEED_MM_S / RAMP_MM_S2
    up_mm = 0.5 * RAMP_MM_S2 * up_s**2
    t = np.clip(time_s - START_S, 0.0, 2 * up_s + LENGTH_S)
    brake = np.clip(t - up_s - LENGTH_S, 0.0, None)
    running = up_mm + SPEED_MM_S * (t - up_s) - 0.5 * RAMP_MM_S2 * brake**2
    return np.asarray(np.where(t < up_s, 0.5 * RAMP_MM_S2 * t**2, running))


def track_of(
    motion: Callable[[FloatArray], FloatArray],
    *,
    rate_hz: float = 100.0,
    jitter_s: float = 0.001,
    drift: float = 30e-6,
    lost: float = 0.0,
    seconds: float = 9.0,
    seed: int = 1,
) -> CartTrack:
    """Telemetry of a motion: exact by the board's clock, noisy in host time."""
    rng = np.random.default_rng(seed)
    board = np.arange(rng.uniform(0, 1 / rate_hz), seconds, 1 / rate_hz)
    board = board[rng.uniform(size=len(board)) >= lost]
    host = OFFSET_S + board * (1 + drift) + rng.normal(0, jitter_s, len(board))
    return CartTrack(host, board, motion(board))


def errors(track: CartTrack, motion: Callable[[FloatArray], FloatArray], drift: float = 30e-6) -> FloatArray:
    """Errors at the times of a camera at 25 frames a second."""
    board = np.arange(0.21, track.board_time_s[-1] - 0.1, 0.04)
    return cart_at(track, OFFSET_S + board * (1 + drift)) - motion(board)


class TestAccuracy:
    @pytest.mark.parametrize("rate_hz", [50.0, 100.0, 200.0])
    @pytest.mark.parametrize("seed", range(5))
    def test_with_a_millisecond_of_jitter_and_ramps_it_stays_within_the_budget(self, rate_hz: float, seed: int) -> None:
        worst = float(np.abs(errors(track_of(ramps, rate_hz=rate_hz, seed=seed), ramps)).max())
        assert worst < 0.5 * BUDGET_MM

    def test_straight_interpolation_in_host_time_would_not(self) -> None:
        track = track_of(ramps)
        order = np.argsort(track.host_time_s)
        board = np.arange(0.2, 8.8, 0.04)
        plain = np.interp(OFFSET_S + board * (1 + 30e-6), track.host_time_s[order], track.cart_mm[order])
        assert np.abs(plain - ramps(board)).max() > 2 * BUDGET_MM

    def test_it_is_exact_at_constant_speed_without_jitter(self) -> None:
        def even(time_s: FloatArray) -> FloatArray:
            return SPEED_MM_S * time_s

        track = track_of(even, jitter_s=0.0, drift=0.0)
        assert np.abs(errors(track, even, drift=0.0)).max() < 1e-8

    def test_sixteenths_of_a_step_do_not_matter(self) -> None:
        step = 0.10053 / 16
        track = track_of(ramps)
        coarse = CartTrack(track.host_time_s, track.board_time_s, np.round(track.cart_mm / step) * step)
        assert np.abs(errors(coarse, ramps)).max() < 0.5 * BUDGET_MM

    @pytest.mark.parametrize("speed_mm_s", [12.5, 47.3])
    def test_positions_in_whole_steps_are_smoothed(self, speed_mm_s: float) -> None:
        def even(time_s: FloatArray) -> FloatArray:
            return speed_mm_s * time_s

        step = 0.10053
        track = track_of(even)
        coarse = CartTrack(track.host_time_s, track.board_time_s, np.round(track.cart_mm / step) * step)
        # Straight from sample to sample it would be 0.04 mm. Near a whole number of steps per sample nothing helps.
        assert np.abs(errors(coarse, even)).max() < 0.4 * BUDGET_MM

    def test_lost_lines_cost_little(self) -> None:
        assert np.abs(errors(track_of(ramps, lost=0.2), ramps)).max() < BUDGET_MM

    def test_lines_that_come_much_too_late_do_not_pull_the_clock(self) -> None:
        track = track_of(ramps)
        late = track.host_time_s.copy()
        late[::17] += 0.05
        assert np.abs(errors(CartTrack(late, track.board_time_s, track.cart_mm), ramps)).max() < BUDGET_MM

    def test_a_speed_that_ripples_is_followed(self) -> None:
        def ripple(time_s: FloatArray) -> FloatArray:
            return np.asarray(SPEED_MM_S * time_s + 0.3 * np.sin(2 * np.pi * 2.0 * time_s))

        assert np.abs(errors(track_of(ripple), ripple)).max() < 0.5 * BUDGET_MM

    def test_clocks_that_drift_unevenly_for_minutes_are_followed(self) -> None:
        def even(time_s: FloatArray) -> FloatArray:
            return SPEED_MM_S * time_s

        rng = np.random.default_rng(3)
        board = np.arange(0.0, 600.0, 0.02)
        warming = OFFSET_S + board + 0.02 * (1 - np.exp(-board / 200.0))
        track = CartTrack(warming + rng.normal(0, 0.001, len(board)), board, even(board))
        at = np.arange(1.0, 599.0, 0.37)
        found = cart_at(track, OFFSET_S + at + 0.02 * (1 - np.exp(-at / 200.0)))
        assert np.abs(found - even(at)).max() < BUDGET_MM

    @pytest.mark.parametrize("order", [[3, 1, 2, 0], [0, 1, 2, 3]])
    def test_the_order_of_the_moments_does_not_matter(self, order: list[int]) -> None:
        track = track_of(ramps)
        moments = OFFSET_S + np.array([1.0, 2.5, 3.0, 7.0])
        assert cart_at(track, moments[order]).tolist() == cart_at(track, moments)[order].tolist()


class TestUnknown:
    def test_before_and_after_the_telemetry_nothing_is_known(self) -> None:
        found = cart_at(track_of(ramps), OFFSET_S + np.array([-1.0, 4.0, 20.0, np.nan]))
        assert np.isfinite(found).tolist() == [False, True, False, False]

    def test_in_a_gap_it_is_known_only_if_the_cart_stood(self) -> None:
        track = track_of(ramps, jitter_s=0.0, drift=0.0)
        for low, high, known in ((3.0, 4.0, False), (0.1, 0.9, True)):
            kept = (track.board_time_s < low) | (track.board_time_s > high)
            gap = CartTrack(track.host_time_s[kept], track.board_time_s[kept], track.cart_mm[kept])
            middle = 0.5 * (low + high)
            found = cart_at(gap, np.array([OFFSET_S + middle, OFFSET_S + 6.0]))
            assert np.isfinite(found).tolist() == [known, True]

    def test_a_board_that_starts_again_begins_another_count(self) -> None:
        first = track_of(ramps, jitter_s=0.0, drift=0.0, seconds=4.0)
        second = track_of(ramps, jitter_s=0.0, drift=0.0, seconds=4.0, seed=2)
        joined = CartTrack(
            np.concatenate([first.host_time_s, second.host_time_s + 10.0]),
            np.concatenate([first.board_time_s, second.board_time_s]),
            np.concatenate([first.cart_mm, second.cart_mm]),
        )
        moments = OFFSET_S + np.array([2.0, 7.0, 12.0])
        found = cart_at(joined, moments)
        np.testing.assert_allclose(found[[0, 2]], ramps(np.array([2.0, 2.0])), atol=1e-6)
        assert np.isnan(found[1])

    @pytest.mark.parametrize("samples", [0, 1, 2, 3, 4])
    def test_a_few_samples_give_what_they_can(self, samples: int) -> None:
        times = np.arange(samples) * 0.01
        found = cart_at(CartTrack(OFFSET_S + times, times, 2.0 * times), np.array([OFFSET_S + 0.005]))
        assert np.isnan(found[0]) if samples < 2 else found[0] == pytest.approx(0.01)
