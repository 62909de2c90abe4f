"""Durations and densities against kinematics computed step by step."""

import numpy as np
import pytest

from twinline.devices.board import Drive
from twinline.errors import InputError
from twinline.operations.passes.forecast import laser_forecast, movement_s, tof_forecast
from twinline.operations.passes.requests import LaserPassRequest, TofPassRequest
from twinline.recording.capture_json import CaptureInfo, parse_capture_json

CART = Drive(0.1, -100.0, 1000.0, 100.0, 200.0)
SLIDE = Drive(0.005, 0.0, 200.0, 40.0, 200.0)


@pytest.fixture
def info(tmp_path: object) -> CaptureInfo:
    from pathlib import Path

    text = (
        b'{"name": "x", "image_size": [1280, 720], "stripe_runs": "along-u", "camera_height_mm": 430.0,'
        b'"camera_matrix_guess": [[1000, 0, 640], [0, 1000, 360], [0, 0, 1]],'
        b'"lasers": [{"baseline_mm": 246, "angle_deg": 60, "side": "+v"}]}'
    )
    return parse_capture_json(text, Path("capture.json"))


def simulated_s(distance: float, speed: float, acceleration: float) -> float:
    """Time of a trapezoid, by small steps of time."""
    dt, v, x, t = 1e-4, 0.0, 0.0, 0.0
    while x < distance:
        braking = v * v / (2 * acceleration) >= distance - x
        v = max(v - acceleration * dt, acceleration * dt) if braking else min(v + acceleration * dt, speed)
        x += v * dt
        t += dt
    return t


@pytest.mark.parametrize(("distance", "speed"), [(0.5, 40.0), (5.0, 20.0), (100.0, 12.5), (-30.0, 100.0)])
def test_movements_last_as_long_as_their_trapezoids(distance: float, speed: float) -> None:
    assert movement_s(distance, speed, 200.0) == pytest.approx(simulated_s(abs(distance), speed, 200.0), rel=0.01)


def test_a_laser_pass_has_its_frames_and_pitch(info: CaptureInfo) -> None:
    forecast = laser_forecast(LaserPassRequest(0.0, 200.0, 12.5), CART, info, rate_hz=25.0)
    assert forecast.samples == 401
    assert forecast.along_mm == pytest.approx(0.5)
    assert forecast.across_mm == pytest.approx(0.43)
    assert 16.0 < forecast.duration_s < 17.0


def test_alternating_lasers_see_half_as_many_lines_each(info: CaptureInfo) -> None:
    forecast = laser_forecast(LaserPassRequest(0.0, 200.0, 12.5, alternating=True), CART, info, rate_hz=25.0)
    assert forecast.along_mm == pytest.approx(1.0)


def test_a_tof_pass_counts_its_rows_to_the_end_of_the_range() -> None:
    request = TofPassRequest(0.0, 10.0, 20.0, 80.0, advance_mm=2.5)
    assert request.row_places_mm(CART) == pytest.approx((0.0, 2.5, 5.0, 7.5, 10.0))
    forecast = tof_forecast(request, CART, SLIDE, samples_hz=400.0)
    sweep, advance = simulated_s(60.0, 20.0, 200.0), simulated_s(2.5, 100.0, 200.0)
    assert forecast.duration_s == pytest.approx(5 * sweep + 4 * advance, rel=0.01)
    assert forecast.across_mm == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: LaserPassRequest(5.0, 5.0), "has no length"),
        (lambda: LaserPassRequest(0.0, 5.0, 0.0), "above 0"),
        (lambda: LaserPassRequest(float("nan"), 5.0), "from_mm"),
        (lambda: TofPassRequest(0.0, 5.0, 3.0, 3.0), "no length"),
        (lambda: TofPassRequest(0.0, 5.0, 3.0, 9.0, advance_mm=0.0), "above 0"),
    ],
)
def test_impossible_passes_are_refused_in_a_sentence(make: object, match: str) -> None:
    with pytest.raises(InputError, match=match):
        make()  # type: ignore[operator]


def test_requests_survive_being_written_down() -> None:
    laser, tof = LaserPassRequest(0.0, 5.0, 3.0, alternating=True), TofPassRequest(0.0, 5.0, 3.0, 9.0)
    assert LaserPassRequest.from_json(laser.to_json()) == laser
    assert TofPassRequest.from_json(tof.to_json()) == tof
    assert np.isfinite(list(tof.to_json().values())).all()


def test_rows_lie_where_whole_steps_of_the_cart_take_them() -> None:
    coarse = Drive(0.3, -100.0, 1000.0, 100.0, 200.0)
    assert TofPassRequest(0.0, 4.0, 20.0, 80.0, advance_mm=1.0).row_places_mm(coarse) == pytest.approx(
        (0.0, 0.9, 1.8, 2.7, 3.6)
    )
    assert TofPassRequest(4.0, 0.0, 20.0, 80.0, advance_mm=2.0).row_places_mm(coarse) == pytest.approx((3.9, 1.8))


def test_a_background_frame_takes_its_time(info: CaptureInfo) -> None:
    with_one, without = (
        laser_forecast(LaserPassRequest(0.0, 200.0, 50.0, background=wanted), CART, info, rate_hz=25.0)
        for wanted in (True, False)
    )
    assert 0.2 < with_one.duration_s - without.duration_s < 1.0
