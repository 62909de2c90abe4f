from dataclasses import replace

import numpy as np
import pytest

from tests.unit.calibration.thesis_scenes import THESIS, Height, Machine, dome, prism, raster, rig, scene, stripes
from twinline.arrays import FloatArray
from twinline.calibration.observations import StripePoints, TofReadings
from twinline.calibration.thesis import calibrate_thesis
from twinline.calibration.thesis_surface import laser_cloud, tof_cloud
from twinline.errors import CalibrationError


def both(machine: Machine, *, height: Height = scene, noise_px: float = 0.0) -> list[StripePoints]:
    return [stripes(machine, laser, height=height, noise_px=noise_px) for laser in (0, 1)]


def test_a_two_parameter_machine_is_found_from_its_passes_alone() -> None:
    machine = Machine()
    result = calibrate_thesis(rig(), both(machine), raster(machine))
    for fit, (baseline, degrees) in zip(result.fits, THESIS, strict=True):
        assert fit.baseline_mm == pytest.approx(baseline, abs=1e-6)
        assert np.degrees(fit.angle_rad) == pytest.approx(degrees, abs=1e-6)
    assert not result.notes
    assert result.shift is not None
    assert abs(result.shift.shift_mm) < 0.05
    # A step between two samples of a raster is known to a part of a cell of 1 mm, even without noise.
    np.testing.assert_allclose(result.alignment.shift_mm, 0.0, atol=0.1)
    np.testing.assert_allclose(result.rig.travel, [1.0, 0.0, 0.0], atol=1e-3)
    assert all(s.startswith("thesis") for k, s in result.rig.sources.items() if k in ("sheets", "travel", "tof"))


def test_a_displaced_sensor_and_a_rounded_travel_are_put_right() -> None:
    machine = Machine(travel=np.array([1.0053, 0.0, 0.0]), tof_error_mm=np.array([2.0, -1.5, 0.0]))
    parts, readings = both(machine, noise_px=0.1), raster(machine, noise_mm=0.01)
    result = calibrate_thesis(rig(), parts, readings)
    assert result.rig.travel[0] == pytest.approx(1.0053, abs=1e-3)
    np.testing.assert_allclose(result.alignment.shift_mm, [2.0, -1.5, 0.0], atol=0.15)
    for points in (tof_cloud(result.rig, readings), laser_cloud(result.rig, 0, parts[0])):
        error = points[:, 2] - scene(points[:, 0], points[:, 1])
        assert np.nanmedian(np.abs(error)) < 0.25


def test_a_shift_that_only_flat_tops_support_is_noted_and_left_out_of_the_rig() -> None:
    machine = Machine()
    result = calibrate_thesis(rig(), both(machine, height=prism, noise_px=0.1), raster(machine, height=prism))
    assert len(result.notes) == 1
    assert "scan an object with slopes" in result.notes[0]
    np.testing.assert_array_equal(result.rig.travel, rig().travel)


def test_one_laser_is_calibrated_without_a_shift() -> None:
    machine = Machine()
    single = replace(rig(), sheets=rig().sheets[:1])
    result = calibrate_thesis(single, [stripes(machine, 0)], raster(machine))
    assert result.shift is None
    assert len(result.fits) == 1


def test_points_picked_by_hand_are_used_as_they_are() -> None:
    machine = Machine()
    parts, readings = both(machine), raster(machine)
    automatic = calibrate_thesis(rig(), parts, readings, per_level=1)
    by_hand = calibrate_thesis(rig(), parts, readings, picks=[f.points for f in automatic.fits])
    np.testing.assert_array_equal(by_hand.fits[0].trace.values, automatic.fits[0].trace.values)
    assert len(by_hand.fits[0].points) < 20


def test_a_raster_of_nothing_but_missing_readings_is_refused() -> None:
    machine = Machine()
    readings = raster(machine, height=dome)
    blind = TofReadings(readings.time_s, readings.cart_mm, readings.slide_mm, np.full(len(readings), np.nan))
    with pytest.raises(CalibrationError, match="out of range") as caught:
        calibrate_thesis(rig(), both(machine), blind)
    assert caught.value.code == "no-points"


def test_readings_beyond_the_sensors_range_are_no_measurements() -> None:
    readings = TofReadings(np.arange(3.0), np.zeros(3), np.zeros(3), np.array([59.0, 100.0, 141.0]))
    heights: FloatArray = tof_cloud(rig(), readings)[:, 2]
    np.testing.assert_array_equal(np.isfinite(heights), [False, True, False])


def test_stripes_and_lasers_must_be_as_many() -> None:
    machine = Machine()
    with pytest.raises(CalibrationError, match="stripes of 1 lasers and the rig has 2"):
        calibrate_thesis(rig(), [stripes(machine, 0)], raster(machine))


def test_a_rig_without_a_sensor_is_refused() -> None:
    machine = Machine()
    with pytest.raises(CalibrationError, match="measures against one") as caught:
        calibrate_thesis(replace(rig(), tof=None), both(machine), raster(machine))
    assert caught.value.code == "no-tof"
