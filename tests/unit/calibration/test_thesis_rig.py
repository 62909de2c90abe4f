from dataclasses import replace

import numpy as np
import pytest

from tests.unit.calibration.thesis_scenes import HEIGHT_MM, THESIS, Machine, dome, raster, rig, stripes
from twinline.calibration.thesis_align import LaserShift, TofAlignment, align_lasers
from twinline.calibration.thesis_fit import SheetFit, fit_sheet
from twinline.calibration.thesis_picks import PickedPoints
from twinline.calibration.thesis_rig import apply_laser_shift, apply_sheets, apply_tof, stripe_separation_mm
from twinline.calibration.thesis_simplex import NelderMeadTrace
from twinline.calibration.thesis_surface import laser_cloud, tof_cloud
from twinline.errors import CalibrationError
from twinline.geometry.camera import Camera
from twinline.geometry.rig import Covariance, Rig, Transform
from twinline.geometry.sheet import Side

TRACE = NelderMeadTrace(np.arange(1), np.zeros(1), np.zeros((1, 1)), np.zeros(1), ("shift_mm",))


def fitted(laser: int, side: Side, lens: str = "ignored") -> SheetFit:
    baseline, degrees = THESIS[laser]
    depth = np.array([430.0, 410.0])
    tangent = (baseline / depth - 1.0 / np.tan(np.radians(degrees))) * (1.0 if side == "+v" else -1.0)
    pixels = np.column_stack([np.full(2, 640.0), 1028.59061 * tangent + 363.64953])
    return fit_sheet(rig().camera, side, PickedPoints(pixels, depth), lens=lens)  # type: ignore[arg-type]


def shifted_by(shift_mm: float, *, height_mm: float = 0.0, indifferent_mm: float = 0.1) -> LaserShift:
    ends = (shift_mm - indifferent_mm, shift_mm + indifferent_mm)
    return LaserShift(shift_mm, 2.0, 1.0, 100, height_mm, ends, TRACE)


def aligned(shift_mm: list[float], yaw_rad: float = 0.0) -> TofAlignment:
    return TofAlignment(np.array(shift_mm), yaw_rad, np.array([12.0, -6.0]), 1.0, 0.1, 99, np.zeros((4, 2)), TRACE)


def tilted(lens: float = 0.0) -> Rig:
    start = rig()
    c, s = np.cos(0.02), np.sin(0.02)
    turn = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    pose = Transform(turn @ start.bed_from_camera.rotation, np.array([3.0, -2.0, HEIGHT_MM]))
    camera = Camera(start.camera.matrix, start.camera.size, np.array([lens, 0, 0, 0, 0]))
    covariance = Covariance(("travel.x",), np.eye(1))
    return replace(start, bed_from_camera=pose, camera=camera, covariance=covariance)


class TestApplySheets:
    def test_the_rig_measures_what_was_fitted(self) -> None:
        result = apply_sheets(tilted(lens=-0.2), [fitted(0, "+v"), fitted(1, "-v")])
        for sheet, (baseline, degrees) in zip(result.sheets, THESIS, strict=True):
            assert sheet.baseline_mm == pytest.approx(baseline, abs=1e-5)
            assert np.degrees(sheet.angle_rad) == pytest.approx(degrees, abs=1e-5)
        part = stripes(Machine(), 0, height=lambda x, y: 20.0 + 0.0 * x)
        np.testing.assert_allclose(laser_cloud(result, 0, part)[:, 2], 20.0, atol=1e-4)

    def test_the_camera_looks_down_without_a_lens_and_the_sources_say_so(self) -> None:
        before = tilted(lens=-0.2)
        result = apply_sheets(before, [fitted(0, "+v"), fitted(1, "-v")])
        assert not result.camera.distortion.any()
        assert result.covariance is None
        np.testing.assert_array_equal(result.bed_from_camera.rotation, rig().bed_from_camera.rotation)
        np.testing.assert_array_equal(result.bed_from_camera.translation_mm, before.bed_from_camera.translation_mm)
        assert result.sources["sheets"].startswith("thesis: Nelder-Mead")
        assert "without lens distortion" in result.sources["camera"]

    def test_fits_of_undistorted_rays_keep_the_lens(self) -> None:
        result = apply_sheets(tilted(lens=-0.2), [fitted(0, "+v", "undistorted"), fitted(1, "-v", "undistorted")])
        assert result.camera.distortion[0] == -0.2

    def test_a_fit_for_each_laser_is_asked_for(self) -> None:
        for fits in ([fitted(0, "+v")], [fitted(1, "-v"), fitted(0, "+v")], []):
            with pytest.raises(CalibrationError, match="fit every laser") as caught:
                apply_sheets(rig(), fits)
            assert caught.value.code == "bad-fits"
        with pytest.raises(CalibrationError, match="same lens setting"):
            apply_sheets(rig(), [fitted(0, "+v"), fitted(1, "-v", "undistorted")])


class TestApplyLaserShift:
    @pytest.mark.parametrize("scale", [0.995, 1.0053])
    def test_a_wrong_travel_tears_the_clouds_apart_and_the_shift_mends_it(self, scale: float) -> None:
        machine = Machine(travel=np.array([scale, 0.0, 0.0]))
        parts = [stripes(machine, k, height=dome) for k in (0, 1)]
        before = rig(THESIS)
        shift = align_lasers(*(laser_cloud(before, k, p) for k, p in enumerate(parts)))
        assert abs(shift.shift_mm) > 0.3
        after = apply_laser_shift(before, shift)
        assert after.travel[0] == pytest.approx(scale, abs=8e-4)
        left = align_lasers(*(laser_cloud(after, k, p) for k, p in enumerate(parts)))
        assert abs(left.shift_mm) < 0.1
        assert "thesis: Nelder-Mead shift of laser 1" in after.sources["travel"]

    def test_heights_stay_as_they_are(self) -> None:
        before, part = rig(THESIS), stripes(Machine(), 0)
        after = apply_laser_shift(before, shifted_by(0.4))
        np.testing.assert_allclose(laser_cloud(after, 0, part)[:, 2], laser_cloud(before, 0, part)[:, 2], atol=1e-9)

    def test_the_separation_is_that_of_the_stripes_on_the_bed(self) -> None:
        bed = [stripes(Machine(), k, height=lambda x, y: 0.0 * x, cart_mm=np.zeros(1)) for k in (0, 1)]
        first, second = (np.mean(laser_cloud(rig(THESIS), k, part)[:, 0]) for k, part in enumerate(bed))
        assert stripe_separation_mm(rig(THESIS), HEIGHT_MM) == pytest.approx(float(first - second))
        swapped = replace(rig(THESIS), sheets=rig(THESIS).sheets[::-1])
        assert stripe_separation_mm(swapped, HEIGHT_MM) == pytest.approx(float(second - first))

    def test_a_shift_that_the_clouds_do_not_determine_is_refused(self) -> None:
        with pytest.raises(CalibrationError, match=r"from -3.00 to 5.00 mm fits") as caught:
            apply_laser_shift(rig(THESIS), shifted_by(1.0, indifferent_mm=4.0))
        assert caught.value.code == "shift-undetermined"

    @pytest.mark.parametrize("shift_mm", [8.0, -70.0])
    def test_a_shift_that_no_travel_explains_is_refused(self, shift_mm: float) -> None:
        with pytest.raises(CalibrationError, match="more than 3 %") as caught:
            apply_laser_shift(rig(THESIS), shifted_by(shift_mm))
        assert caught.value.code == "shift-too-large"

    def test_one_laser_has_no_shift(self) -> None:
        with pytest.raises(CalibrationError, match="leave this step out"):
            apply_laser_shift(replace(rig(), sheets=rig().sheets[:1]), shifted_by(0.1))


class TestApplyTof:
    def test_readings_lie_where_the_alignment_put_them(self) -> None:
        readings, alignment = raster(Machine()), aligned([1.5, -0.5, 0.25])
        after = apply_tof(rig(), alignment)
        np.testing.assert_allclose(tof_cloud(after, readings), alignment.apply(tof_cloud(rig(), readings)), atol=1e-9)
        assert after.sources["tof"].startswith("thesis: Nelder-Mead alignment")

    def test_a_turn_is_exact_in_the_middle_of_the_raster_and_near_it_elsewhere(self) -> None:
        readings, alignment = raster(Machine()), aligned([1.5, -0.5, 0.25], yaw_rad=0.01)
        error = tof_cloud(apply_tof(rig(), alignment), readings) - alignment.apply(tof_cloud(rig(), readings))
        along = readings.cart_mm - 12.0
        np.testing.assert_allclose(error[:, 1], -0.01 * along, atol=1e-4)
        np.testing.assert_allclose(error[np.abs(along) < 0.1], 0.0, atol=0.01)
        np.testing.assert_allclose(error[:, [0, 2]], 0.0, atol=0.005)

    def test_a_rig_without_a_sensor_has_nothing_to_align(self) -> None:
        with pytest.raises(CalibrationError, match="no ToF sensor to align") as caught:
            apply_tof(replace(rig(), tof=None), aligned([0.0, 0.0, 0.0]))
        assert caught.value.code == "no-tof"
