import numpy as np
import pytest

from twinline.errors import RigError
from twinline.geometry.camera import Camera
from twinline.geometry.nominal import default_rig, nominal_pose, nominal_rig, nominal_tof
from twinline.geometry.rig import StripeRuns
from twinline.geometry.sheet import Side
from twinline.geometry.triangulation import stripe_points

CAMERA = Camera(np.array([[1030.0, 0, 640], [0, 1030.0, 360], [0, 0, 1]]), (1280, 720))


@pytest.mark.parametrize(
    ("runs", "image_u", "image_v"), [("along-u", [0, 1, 0], [1, 0, 0]), ("along-v", [1, 0, 0], [0, -1, 0])]
)
def test_the_nominal_camera_looks_down_with_its_axes_on_the_bed_s(
    runs: StripeRuns, image_u: list[int], image_v: list[int]
) -> None:
    pose = nominal_pose(runs, 430.0)
    np.testing.assert_array_equal(pose.rotation @ [1, 0, 0], image_u)
    np.testing.assert_array_equal(pose.rotation @ [0, 1, 0], image_v)
    np.testing.assert_array_equal(pose.rotation @ [0, 0, 1], [0, 0, -1])
    np.testing.assert_array_equal(pose.apply(np.array([[0.0, 0.0, 430.0]]))[0], [0, 0, 0])
    assert np.linalg.det(pose.rotation) == pytest.approx(1.0)


@pytest.mark.parametrize("runs", ["along-u", "along-v"])
def test_both_lasers_of_a_nominal_rig_agree_with_the_thesis_s_formula(runs: StripeRuns) -> None:
    angle = float(np.radians(64.0))
    sides: tuple[Side, Side] = ("+v", "-v") if runs == "along-u" else ("+u", "-u")
    rig = nominal_rig("test", CAMERA, runs, [(246.0, angle, sides[0]), (250.0, angle, sides[1])], 430.0)
    for laser, (baseline_mm, sign) in enumerate([(246.0, 1.0), (250.0, -1.0)]):
        away_px = 57.0
        alpha = np.arctan(away_px / 1030.0)
        depth = baseline_mm * np.sin(angle) * np.cos(alpha) / np.cos(alpha - angle)
        pixel = (
            [640.0 + 111.0, 360.0 + sign * away_px] if runs == "along-u" else [640.0 + sign * away_px, 360.0 - 111.0]
        )
        point = stripe_points(rig, laser, np.array([pixel]), np.array([0.1]), 20.0)[0][0]
        np.testing.assert_allclose(
            point, [sign * depth * np.tan(alpha) + 20.0, depth * 111.0 / 1030.0, 430.0 - depth], atol=1e-9
        )


@pytest.mark.parametrize(
    ("unit", "lowest", "middle", "highest"),
    [("adc", 0.0, 2047.5, 4095.0), ("volts", -4.0, 0.0, 4.0), ("distance_mm", 60.0, 100.0, 140.0)],
)
def test_each_unit_of_the_tof_sensor_covers_its_range(unit: str, lowest: float, middle: float, highest: float) -> None:
    tof = nominal_tof(np.array([-118.0, 0.0, 139.0]), (60.0, 140.0), unit)  # type: ignore[arg-type]
    found = [tof.offset_mm + tof.gain_mm_per_unit * reading for reading in (lowest, middle, highest)]
    np.testing.assert_allclose(found, [60.0, 100.0, 140.0])


def test_the_default_machine_has_the_documented_numbers() -> None:
    rig = default_rig()
    assert (rig.camera.fx, rig.camera.fy, rig.camera.cx, rig.camera.cy) == (1028.84412, 1028.59061, 648.4741, 363.64953)
    assert rig.camera.size == (1280, 720)
    assert [sheet.baseline_mm for sheet in rig.sheets] == pytest.approx([246.0, 246.0])
    assert [np.degrees(sheet.angle_rad) for sheet in rig.sheets] == pytest.approx([60.0, 60.0])
    assert [sheet.side for sheet in rig.sheets] == ["+v", "-v"]
    assert rig.bed_from_camera.translation_mm[2] == 430.0
    assert rig.tof is not None
    assert rig.tof.range_mm == (60.0, 140.0)
    assert 1 / rig.drives.cart_steps_per_mm == pytest.approx(0.10053, abs=5e-6)
    assert 1 / rig.drives.slide_steps_per_mm == pytest.approx(0.005)


@pytest.mark.parametrize("height_mm", [0.0, -430.0, float("nan")])
def test_a_camera_in_the_ground_is_refused(height_mm: float) -> None:
    with pytest.raises(RigError, match="height"):
        nominal_pose("along-u", height_mm)


def test_a_tof_range_that_does_not_ascend_is_refused() -> None:
    with pytest.raises(RigError, match="ascend"):
        nominal_tof(np.zeros(3), (140.0, 60.0), "adc")
    with pytest.raises(RigError, match="ascend"):
        nominal_tof(np.zeros(3), (60.0, 140.0), "volts", volts=(4.0, 4.0))
