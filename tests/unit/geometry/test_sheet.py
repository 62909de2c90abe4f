import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinline.errors import RigError
from twinline.geometry.sheet import SIDES, LaserSheet, Side


@given(st.floats(10, 1000), st.floats(0.1, 3.0), st.sampled_from(SIDES))
def test_baseline_and_angle_come_back_from_the_plane(baseline_mm: float, angle_rad: float, side: Side) -> None:
    sheet = LaserSheet.from_baseline_angle(baseline_mm, angle_rad, side)
    assert sheet.baseline_mm == pytest.approx(baseline_mm, rel=1e-12)
    assert sheet.angle_rad == pytest.approx(angle_rad, rel=1e-12)


@pytest.mark.parametrize("side", SIDES)
def test_the_laser_and_the_axis_crossing_lie_on_the_sheet_and_the_camera_before_it(side: Side) -> None:
    sheet = LaserSheet.from_baseline_angle(246.0, np.radians(60.0), side)
    towards = {"+u": [1, 0, 0], "-u": [-1, 0, 0], "+v": [0, 1, 0], "-v": [0, -1, 0]}[side]
    laser, crossing = 246.0 * np.array(towards), np.array([0.0, 0.0, 246.0 * np.tan(np.radians(60.0))])
    np.testing.assert_allclose(sheet.signed_distance_mm(np.array([laser, crossing])), 0.0, atol=1e-12)
    assert sheet.signed_distance_mm(np.zeros((1, 3)))[0] < 0


@pytest.mark.parametrize("side", SIDES)
def test_a_higher_surface_moves_the_stripe_to_the_named_side(side: Side) -> None:
    sheet = LaserSheet.from_baseline_angle(246.0, np.radians(62.0), side)
    sign = 1 if side[0] == "+" else -1
    axis = "uv".index(side[1])
    at = {z: (sheet.offset_mm - sheet.normal[2] * z) / sheet.normal[axis] / z for z in (430.0, 400.0)}
    assert sign * (at[400.0] - at[430.0]) > 0


def test_the_sign_and_length_of_a_given_normal_do_not_matter() -> None:
    one = LaserSheet(np.array([0.1, 0.9, 0.4]), 220.0, "+v")
    other = LaserSheet(np.array([-0.3, -2.7, -1.2]), -660.0, "+v")
    np.testing.assert_allclose(one.normal, other.normal, atol=1e-15)
    assert one.offset_mm == pytest.approx(other.offset_mm)
    assert np.linalg.norm(one.normal) == pytest.approx(1.0)


def test_making_a_sheet_from_its_own_numbers_changes_no_bit() -> None:
    rng = np.random.default_rng(5)
    for normal in rng.normal(size=(200, 3)):
        once = LaserSheet(normal, 215.2, "+v")
        twice = LaserSheet(once.normal, once.offset_mm, "+v")
        assert once.normal.tobytes() == twice.normal.tobytes()
        assert once.offset_mm == twice.offset_mm


def test_inverse_depth_gives_the_depth_on_a_ray() -> None:
    sheet = LaserSheet(np.array([0.02, 0.9, 0.4]), 220.0, "+v")
    ray = np.array([0.2, -0.1, 1.0])
    depth = 1.0 / (sheet.inverse_depth @ ray)
    assert sheet.signed_distance_mm(depth * ray[None]) == pytest.approx(0.0, abs=1e-10)


@pytest.mark.parametrize(
    ("normal", "offset_mm", "side"),
    [
        ([0, 0, 0], 200, "+v"),
        ([0, 1, np.nan], 200, "+v"),
        ([0, 1], 200, "+v"),
        ([0, 1, 0], 0, "+v"),
        ([0, 1, 0], 9, "up"),
    ],
)
def test_an_impossible_sheet_is_refused(normal: list[float], offset_mm: float, side: Side) -> None:
    with pytest.raises(RigError):
        LaserSheet(np.array(normal), offset_mm, side)


@pytest.mark.parametrize(("baseline_mm", "angle_rad"), [(0.0, 1.0), (-5.0, 1.0), (246.0, 0.0), (246.0, np.pi)])
def test_an_impossible_baseline_or_angle_is_refused(baseline_mm: float, angle_rad: float) -> None:
    with pytest.raises(RigError, match="baseline"):
        LaserSheet.from_baseline_angle(baseline_mm, angle_rad, "+v")
