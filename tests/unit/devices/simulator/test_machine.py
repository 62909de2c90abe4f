"""The machine's geometry in words, turned into checks."""

import numpy as np
import pytest

from twinline.devices.simulator.machine import SimulatedLaser, SimulatedRig, ideal_rig
from twinline.errors import SettingsError


@pytest.mark.parametrize("side", ["+v", "-v"])
def test_a_straight_sheet_meets_the_bed_where_baseline_and_angle_say(side: str) -> None:
    laser = SimulatedLaser(side, 250.0, 60.0)  # type: ignore[arg-type]
    x = (250.0 - 430.0 / np.tan(np.pi / 3)) * (1 if side == "+v" else -1)
    for y in (-80.0, 0.0, 120.0):
        assert laser.normal @ (np.array([x, y, -430.0]) - laser.source_mm) == pytest.approx(0.0, abs=1e-9)


def test_raising_a_laser_leaves_its_sheet_where_it_was() -> None:
    low, high = SimulatedLaser("+v", 250.0, 60.0), SimulatedLaser("+v", 250.0, 60.0, above_mm=30.0)
    assert low.normal @ (high.source_mm - low.source_mm) == pytest.approx(0.0, abs=1e-9)
    assert high.source_mm[2] == 30.0


def test_yaw_turns_the_line_on_the_bed_by_its_own_angle() -> None:
    laser = SimulatedLaser("+v", 250.0, 60.0, yaw_deg=2.0)
    # The line on the bed runs along the cross product of the sheet's normal and the vertical.
    line = np.cross(laser.normal, (0.0, 0.0, 1.0))
    assert abs(np.degrees(np.arctan(line[0] / line[1]))) == pytest.approx(2.0, abs=0.01)


def test_the_upright_camera_sees_the_travel_along_v_or_along_u() -> None:
    np.testing.assert_allclose(ideal_rig().bed_from_camera @ [0, 1, 0], [1, 0, 0], atol=1e-12)
    turned = SimulatedRig(stripe_runs="along-v", lasers=(SimulatedLaser("+u", 250.0, 65.0),), tilt_deg=(0, 0, 0))
    np.testing.assert_allclose(turned.bed_from_camera @ [1, 0, 0], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(turned.bed_from_camera @ [0, 0, 1], [0, 0, -1], atol=1e-12)


def test_cropping_keeps_the_ray_of_each_remaining_pixel() -> None:
    whole, part = SimulatedRig(), SimulatedRig().cropped((320, 240))
    offset = np.array([480.0, 240.0])
    np.testing.assert_allclose(
        part.lens.slopes(np.array([10.0]), np.array([20.0])),
        whole.lens.slopes(np.array([10.0 + offset[0]]), np.array([20.0 + offset[1]])),
    )
    assert part.image_size == (320, 240)


@pytest.mark.parametrize("sides", [(), ("+u",), ("+v", "+v")])
def test_lasers_that_do_not_fit_the_camera_are_refused(sides: tuple[str, ...]) -> None:
    lasers = tuple(SimulatedLaser(side, 250.0, 65.0) for side in sides)  # type: ignore[arg-type]
    with pytest.raises(SettingsError, match=r"\+v"):
        SimulatedRig(lasers=lasers)
