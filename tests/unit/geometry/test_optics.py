import dataclasses

import numpy as np
import pytest
from scipy.optimize import brentq

from twinline.errors import RigError
from twinline.geometry import two_parameter as tp
from twinline.geometry.camera import Camera
from twinline.geometry.nominal import default_rig, nominal_rig
from twinline.geometry.optics import (
    axis_depth_mm,
    check_stripes_separable,
    depth_limits,
    meeting_depths,
    stripe_positions,
    stripe_rows,
)
from twinline.geometry.rig import Rig
from twinline.geometry.triangulation import stripe_points


def calibrated_rig() -> Rig:
    """The default machine with the baselines and angles that the thesis's calibration found."""
    lasers = [(251.6284, float(np.radians(65.7536)), "+v"), (251.4805, float(np.radians(62.4899)), "-v")]
    return nominal_rig("calibrated", default_rig().camera, "along-u", lasers, 430.0)  # type: ignore[arg-type]


def lanes(rig: Rig) -> int:
    return rig.camera.size[0 if rig.stripe_runs == "along-u" else 1]


def in_lanes(rig: Rig, positions: np.ndarray) -> np.ndarray:
    pixels = np.column_stack([np.arange(len(positions)), positions])
    return pixels if rig.stripe_runs == "along-u" else pixels[:, ::-1]


def height_of(rig: Rig, laser: int, pixels: np.ndarray) -> np.ndarray:
    return stripe_points(rig, laser, pixels, np.zeros(len(pixels)), 0.0)[0][:, 2]


class TestStripePositions:
    @pytest.mark.parametrize("z_bed_mm", [-5.0, 0.0, 37.0])
    def test_triangulating_them_gives_the_height_back(self, crooked_rig: Rig, z_bed_mm: float) -> None:
        for laser in (0, 1):
            positions = stripe_positions(crooked_rig, laser, z_bed_mm)
            assert positions.shape == (lanes(crooked_rig),)
            heights = height_of(crooked_rig, laser, in_lanes(crooked_rig, positions))
            np.testing.assert_allclose(heights, z_bed_mm, atol=1e-8)

    def test_they_agree_with_root_finding_along_a_column(self, crooked_rig: Rig) -> None:
        positions = stripe_positions(crooked_rig, 0, 12.0)
        for lane in (0, 313, lanes(crooked_rig) - 1):

            def above(position: float, lane: int = lane) -> float:
                pixel = [lane, position] if crooked_rig.stripe_runs == "along-u" else [position, lane]
                return float(height_of(crooked_rig, 0, np.array([pixel], dtype=float))[0]) - 12.0

            found = brentq(above, positions[lane] - 40, positions[lane] + 40, xtol=1e-10)
            assert positions[lane] == pytest.approx(found, abs=1e-8)

    def test_a_plane_beyond_the_lens_model_lies_infinitely_far_on_its_side(self) -> None:
        rig = calibrated_rig()
        lens = Camera(rig.camera.matrix, rig.camera.size, np.array([-0.3, 0.0, 0.0, 0.0, 0.0]))
        rig = dataclasses.replace(rig, camera=lens)
        assert (stripe_positions(rig, 0, 330.0) == np.inf).all()
        assert (stripe_positions(rig, 1, 330.0) == -np.inf).all()

    def test_a_plane_above_the_camera_is_refused(self) -> None:
        with pytest.raises(RigError, match="430 mm above"):
            stripe_positions(default_rig(), 0, 430.0)

    def test_a_laser_that_is_not_there_is_named(self) -> None:
        with pytest.raises(RigError, match="Laser 3"):
            stripe_positions(default_rig(), 2, 0.0)


class TestStripeRows:
    def test_the_true_rig_s_band_holds_exactly_the_heights_it_was_asked_for(self, rendered_rig: Rig) -> None:
        for laser in (0, 1):
            low, high = stripe_rows(rendered_rig, laser, -2.0, 40.0)
            columns = np.arange(1280)
            v = np.arange(720.0)
            for u in columns[::97]:
                heights = height_of(rendered_rig, laser, np.column_stack([np.full(720, u), v]))
                expected = np.flatnonzero((heights >= -2.0) & (heights <= 40.0))
                assert low[u] <= expected[0] <= low[u] + 1
                assert high[u] - 2 <= expected[-1] <= high[u] - 1

    def test_the_bands_of_both_lasers_are_apart(self, rendered_rig: Rig) -> None:
        first, second = (stripe_rows(rendered_rig, laser, -5.0, 60.0) for laser in (0, 1))
        assert (second[1] < first[0]).all()

    def test_at_the_calibrated_bed_the_stripes_are_205_px_apart(self) -> None:
        bands = [stripe_rows(calibrated_rig(), laser, 0.0, 0.0) for laser in (0, 1)]
        gap = stripe_positions(calibrated_rig(), 0, 0.0) - stripe_positions(calibrated_rig(), 1, 0.0)
        np.testing.assert_allclose(gap, 205.0, atol=0.5)
        assert all((high - low == 2).all() for low, high in bands)

    def test_they_are_whole_numbers_within_the_image_and_empty_outside(self) -> None:
        low, high = stripe_rows(calibrated_rig(), 0, 0.0, 200.0)
        assert low.dtype == high.dtype == np.int64
        assert (high == 720).all()
        low, high = stripe_rows(calibrated_rig(), 0, 150.0, 200.0)
        assert (low == high).all()
        low, high = stripe_rows(calibrated_rig(), 1, 180.0, 200.0)
        assert (low == high).all()

    def test_stripes_along_v_give_one_band_per_row(self) -> None:
        angle = float(np.radians(65.0))
        rig = nominal_rig("turned", default_rig().camera, "along-v", [(246.0, angle, "-u")], 430.0)
        low, high = stripe_rows(rig, 0, 0.0, 20.0)
        assert low.shape == (720,)
        expected = [648.4741 - 1028.84412 * (246.0 / z - 1 / np.tan(angle)) for z in (410.0, 430.0)]
        assert (low == np.floor(expected[0])).all()
        assert (high == np.ceil(expected[1]) + 1).all()

    def test_heights_that_do_not_ascend_are_refused(self) -> None:
        with pytest.raises(RigError, match="ascend"):
            stripe_rows(default_rig(), 0, 20.0, 0.0)


class TestDepthLimits:
    def test_the_nominal_rig_sees_267_to_1099_mm(self) -> None:
        near, far = depth_limits(default_rig(), 0)
        np.testing.assert_allclose(near, 267.0, atol=0.5)
        np.testing.assert_allclose(far, 1099.0, atol=0.5)

    def test_the_calibrated_lasers_see_from_316_and_288_mm(self) -> None:
        assert [depth_limits(calibrated_rig(), laser)[0][640] for laser in (0, 1)] == pytest.approx([316, 288], abs=0.5)

    def test_the_limits_are_seen_in_the_first_and_last_pixel_of_a_lane(self, crooked_rig: Rig) -> None:
        near, far = depth_limits(crooked_rig, 0)
        for depths in (near, far):
            seen = np.isfinite(depths)
            points = np.column_stack([np.zeros(seen.sum()), np.zeros(seen.sum()), depths[seen]])
            assert (points[:, 2] > 0).all()
        across = crooked_rig.camera.size[1 if crooked_rig.stripe_runs == "along-u" else 0]
        rays = crooked_rig.camera.rays(in_lanes(crooked_rig, np.full(lanes(crooked_rig), across - 1.0)))
        in_camera = rays * near[:, None]
        np.testing.assert_allclose(crooked_rig.sheets[0].signed_distance_mm(in_camera), 0.0, atol=1e-9)

    def test_a_steep_sheet_is_seen_for_ever(self) -> None:
        rig = nominal_rig("steep", default_rig().camera, "along-u", [(246.0, float(np.radians(85.0)), "+v")], 430.0)
        assert (depth_limits(rig, 0)[1] == np.inf).all()

    def test_a_sheet_that_is_never_in_view_has_no_limits(self) -> None:
        rig = nominal_rig("away", default_rig().camera, "along-u", [(246.0, float(np.radians(170.0)), "+v")], 430.0)
        near, far = depth_limits(rig, 0)
        assert np.isnan(near).all()
        assert np.isnan(far).all()


class TestSeparation:
    def test_the_nominal_stripes_cross_above_the_bed(self) -> None:
        verdict = check_stripes_separable(default_rig())
        assert not verdict.separable
        assert verdict.axis_depths_mm == pytest.approx((426.0, 426.0), abs=0.5)
        assert verdict.meeting_depth_mm == pytest.approx(426.0, abs=0.5)
        assert verdict.gap_px < 0
        with pytest.raises(RigError, match=r"426 mm .*430 mm.*alternate the lasers"):
            verdict.require()

    def test_the_calibrated_stripes_do_not(self) -> None:
        verdict = check_stripes_separable(calibrated_rig())
        verdict.require()
        assert verdict.separable
        assert verdict.axis_depths_mm == pytest.approx((559.0, 483.0), abs=0.5)
        assert verdict.gap_px == pytest.approx(205.0, abs=0.5)
        expected = tp.meeting_depth_mm((251.6284, 251.4805), (np.radians(65.7536), np.radians(62.4899)))
        assert verdict.meeting_depth_mm == pytest.approx(expected)

    def test_the_margin_below_the_lowest_surface_counts(self) -> None:
        rig = calibrated_rig()
        room = tp.meeting_depth_mm((251.6284, 251.4805), (np.radians(65.7536), np.radians(62.4899))) - 430.0
        assert check_stripes_separable(rig, margin_mm=room - 0.5).separable
        verdict = check_stripes_separable(rig, margin_mm=room + 0.5)
        assert not verdict.separable
        assert "less than 88." in verdict.sentence
        assert not check_stripes_separable(rig, lowest_mm=-room - 0.5, margin_mm=0.0).separable

    def test_on_a_raised_floor_the_nominal_stripes_are_separable(self) -> None:
        assert check_stripes_separable(default_rig(), lowest_mm=30.0).separable

    def test_the_real_machine_is_judged_by_its_planes(self, rendered_rig: Rig) -> None:
        verdict = check_stripes_separable(rendered_rig)
        assert verdict.separable
        gap = stripe_positions(rendered_rig, 0, 0.0) - stripe_positions(rendered_rig, 1, 0.0)
        assert verdict.gap_px == pytest.approx(gap.min())

    def test_one_laser_is_always_separable(self) -> None:
        rig = dataclasses.replace(default_rig(), sheets=default_rig().sheets[:1])
        assert check_stripes_separable(rig).separable
        with pytest.raises(RigError, match="one laser"):
            meeting_depths(rig)

    def test_the_meeting_line_lies_on_both_sheets(self, crooked_rig: Rig) -> None:
        depths = meeting_depths(crooked_rig)
        assert np.isfinite(depths).any()
        first, second = crooked_rig.sheets
        direction = np.cross(first.normal, second.normal)
        # A point of the line, then the point of it at each depth: a different route to the same depths.
        start = np.linalg.lstsq(
            np.array([first.normal, second.normal, direction]), [first.offset_mm, second.offset_mm, 0.0], rcond=None
        )[0]
        for lane in np.flatnonzero(np.isfinite(depths))[::200]:
            point = start + direction * (depths[lane] - start[2]) / direction[2]
            pixel = crooked_rig.camera.project(point[None])[0]
            assert pixel[0 if crooked_rig.stripe_runs == "along-u" else 1] == pytest.approx(lane, abs=1e-5)

    def test_stripes_that_meet_outside_the_image_do_not_meet(self) -> None:
        lasers = [(246.0, float(np.radians(85.0)), "+v"), (100.0, float(np.radians(30.0)), "-v")]
        rig = nominal_rig("odd", default_rig().camera, "along-u", lasers, 60.0)  # type: ignore[arg-type]
        assert np.isnan(meeting_depths(rig)).all()
        assert check_stripes_separable(rig).meeting_depth_mm == np.inf

    def test_a_sheet_across_the_travel_meets_the_axis_at_its_offset(self) -> None:
        assert axis_depth_mm(calibrated_rig().sheets[0]) == pytest.approx(251.6284 * np.tan(np.radians(65.7536)))


def test_sheets_that_do_not_fit_stripe_runs_are_reported() -> None:
    rig = default_rig()
    sheet = dataclasses.replace(rig.sheets[0], normal=np.array([0.9, 0.0, 0.4]))
    with pytest.raises(RigError, match="check stripe_runs"):
        stripe_positions(dataclasses.replace(rig, sheets=(sheet,)), 0, 0.0)
