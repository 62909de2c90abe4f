"""The thesis's own numbers where they are right; independent derivations where its printed forms are not."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from twinline.geometry import two_parameter as tp

THETA = np.radians(60.0)
FY, CY = 1028.59061, 363.64953


class TestDrives:
    def test_a_step_moves_the_cart_by_a_tenth_of_a_millimetre_and_a_half_percent(self) -> None:
        advance = tp.cart_advance_mm(np.radians(0.36), 64.0, 8.0, 32.0)
        assert advance == pytest.approx(0.10053, abs=5e-6)
        assert advance == pytest.approx(2 * 64.0 * 3.14159265358979 * 0.36 / 360 * 8 / 32)
        assert advance / 0.1 - 1 == pytest.approx(0.0053, abs=5e-5)

    def test_a_step_moves_the_slide_by_five_micrometres_and_not_the_printed_fifty(self) -> None:
        advance = tp.slide_advance_mm(np.radians(0.72), 2.5)
        assert advance == pytest.approx(2.5 / 500)
        assert advance != pytest.approx(0.05, rel=0.5)


class TestFocalLength:
    def test_the_field_of_view_gives_the_focal_length(self) -> None:
        focal = tp.focal_length_px(1280, np.radians(63.7))
        assert focal == pytest.approx(1030.2, abs=0.5)
        assert focal * 4.35e-3 == pytest.approx(4.48, abs=0.005)

    def test_the_lens_s_millimetres_give_1029_9_pixels(self) -> None:
        lens_mm, pixel_mm = 4.48, 4.35e-3
        assert lens_mm / pixel_mm == pytest.approx(1029.9, abs=0.05)
        field = 2 * np.arctan(640 / 1029.9)
        assert tp.focal_length_px(1280, field) == pytest.approx(1029.9)


class TestTriangulation:
    @given(st.floats(100, 400), st.floats(0.6, 1.5), st.floats(-0.3, 0.5))
    def test_both_forms_of_the_depth_agree_and_the_point_is_on_ray_and_sheet(
        self, baseline_mm: float, angle_rad: float, alpha_rad: float
    ) -> None:
        depth = tp.depth_mm(baseline_mm, angle_rad, alpha_rad)
        if np.isnan(depth):
            return
        thesis = baseline_mm * np.sin(angle_rad) * np.cos(alpha_rad) / np.cos(alpha_rad - angle_rad)
        assert depth == pytest.approx(thesis, rel=1e-9)
        # The sheet as a line through the laser at (baseline, 0), written without tangents.
        along = tp.along_mm(depth, alpha_rad)
        to_point = np.array([along - baseline_mm, depth])
        sheet = np.array([-np.cos(angle_rad), np.sin(angle_rad)])
        cross = to_point[0] * sheet[1] - to_point[1] * sheet[0]
        assert cross == pytest.approx(0.0, abs=1e-8 * float(np.linalg.norm(to_point)))

    def test_a_ray_past_the_sheet_has_no_depth(self) -> None:
        depths = tp.depth_mm(246.0, THETA, np.radians([-40.0, -31.0, -29.0, 0.0]))
        assert np.isnan(depths).tolist() == [True, True, False, False]

    def test_across_the_bed_similar_triangles_hold(self) -> None:
        assert tp.across_mm(430.0, 748.4741, 648.4741, 1028.84412) == pytest.approx(430.0 * 100 / 1028.84412)

    def test_the_ray_angle_grows_towards_plus_v(self) -> None:
        assert tp.ray_angle_rad(CY + FY, CY, FY) == pytest.approx(np.pi / 4)


class TestDepthRange:
    def test_the_thesis_s_angles_give_the_thesis_s_range(self) -> None:
        quarter = np.radians(63.7 / 4)
        near, far = tp.depth_range_mm(250.0, THETA, quarter, quarter)
        assert near == pytest.approx(290.0, abs=0.5)
        assert far == pytest.approx(856.0, abs=1.5)
        assert far - near == pytest.approx(566.0, abs=1.5)

    def test_the_vertical_image_axis_gives_267_to_1099(self) -> None:
        towards, away = -tp.ray_angle_rad(0.0, CY, FY), tp.ray_angle_rad(719.0, CY, FY)
        near, _ = tp.depth_range_mm(246.0, THETA, float(away), float(towards))
        _, far = tp.depth_range_mm(246.0, THETA, float(away), float(towards))
        assert near == pytest.approx(267.0, abs=0.5)
        assert far == pytest.approx(1099.0, abs=0.5)

    def test_a_sheet_steeper_than_the_edge_of_the_view_stays_in_view(self) -> None:
        assert tp.depth_range_mm(246.0, np.radians(80.0), 0.34, 0.34)[1] == np.inf


class TestResolution:
    @pytest.mark.parametrize(("depth", "expected"), [(430.0, 0.731), (290.0, 0.332)])
    def test_depth_per_pixel(self, depth: float, expected: float) -> None:
        assert tp.depth_per_pixel_mm(depth, 246.0, FY) == pytest.approx(expected, abs=5e-4)

    @pytest.mark.parametrize("depth", [290.0, 350.0, 430.0])
    def test_depth_per_pixel_is_the_derivative_of_the_depth(self, depth: float) -> None:
        v = brentq(lambda v: float(tp.depth_mm(246.0, THETA, tp.ray_angle_rad(v, CY, FY))) - depth, 100.0, 719.0)
        near, far = (float(tp.depth_mm(246.0, THETA, tp.ray_angle_rad(v + h, CY, FY))) for h in (1e-3, -1e-3))
        assert tp.depth_per_pixel_mm(depth, 246.0, FY) == pytest.approx((far - near) / 2e-3, rel=1e-6)

    def test_the_printed_form_is_right_on_the_axis_only(self) -> None:
        on_axis = tp.crossing_depth_mm(246.0, THETA)
        assert tp.depth_per_pixel_mm(on_axis, 246.0, FY) == pytest.approx(0.0017 * on_axis, rel=0.02)
        printed = 0.0017 * 290.0
        assert tp.depth_per_pixel_mm(290.0, 246.0, FY) < 0.7 * printed

    def test_a_pixel_across_the_bed_is_0_42_mm(self) -> None:
        assert tp.across_per_pixel_mm(430.0, 1028.84412) == pytest.approx(0.42, abs=0.005)
        assert tp.across_per_pixel_mm(1.0, 1028.84412) == pytest.approx(0.00097, abs=5e-6)


class TestSensitivities:
    def test_ignoring_the_principal_point_costs_2_7_mm(self) -> None:
        alpha = np.arctan((246.0 / 430.0) - 1 / np.tan(THETA))
        v = CY + FY * np.tan(alpha)
        wrong = float(tp.depth_mm(246.0, THETA, tp.ray_angle_rad(v, 360.0, FY)))
        assert abs(wrong - 430.0) == pytest.approx(2.7, abs=0.05)
        assert 3.65 * tp.depth_per_pixel_mm(430.0, 246.0, FY) == pytest.approx(2.7, abs=0.05)

    def test_a_hundredth_of_a_degree_of_laser_tilt_is_0_175_mm(self) -> None:
        tilt = np.radians(0.01)
        alpha = np.arctan((246.0 / 430.0) - 1 / np.tan(THETA))
        moved = float(tp.depth_mm(246.0, THETA + tilt, alpha)) - 430.0
        assert tilt * tp.depth_per_angle_mm(430.0, 246.0, THETA) == pytest.approx(0.175, abs=5e-4)
        assert tilt * tp.depth_per_angle_mm(430.0, 246.0, THETA) == pytest.approx(moved, rel=1e-3)

    def test_a_millimetre_of_baseline_is_1_75_mm(self) -> None:
        alpha = np.arctan((246.0 / 430.0) - 1 / np.tan(THETA))
        moved = float(tp.depth_mm(247.0, THETA, alpha)) - 430.0
        assert tp.depth_per_baseline(430.0, 246.0) == pytest.approx(1.75, abs=0.005)
        assert tp.depth_per_baseline(430.0, 246.0) == pytest.approx(moved, rel=1e-9)


class TestCrossing:
    @pytest.mark.parametrize(
        ("baseline_mm", "angle_deg", "expected"),
        [(246.0, 60.0, 426.0), (251.6284, 65.7536, 559.0), (251.4805, 62.4899, 483.0)],
    )
    def test_the_stripe_crosses_the_axis_where_the_thesis_says(
        self, baseline_mm: float, angle_deg: float, expected: float
    ) -> None:
        assert tp.crossing_depth_mm(baseline_mm, np.radians(angle_deg)) == pytest.approx(expected, abs=0.5)

    def test_a_sheet_that_leans_away_never_crosses_the_axis(self) -> None:
        assert tp.crossing_depth_mm(246.0, np.radians(95.0)) == np.inf

    def test_two_stripes_meet_where_their_positions_along_the_travel_are_equal(self) -> None:
        baselines, angles = (251.6284, 251.4805), (np.radians(65.7536), np.radians(62.4899))

        def apart(z: float) -> float:
            return float(baselines[0] - z / np.tan(angles[0])) + float(baselines[1] - z / np.tan(angles[1]))

        met = tp.meeting_depth_mm(baselines, angles)
        assert met == pytest.approx(brentq(apart, 300.0, 900.0))
        assert 483 < met < 559
        assert tp.meeting_depth_mm((246.0, 246.0), (np.radians(100.0), np.radians(85.0))) == np.inf


class TestShadows:
    def test_the_prism_hides_11_2_mm_from_the_laser(self) -> None:
        assert tp.laser_shadow_mm(19.35, THETA) == pytest.approx(11.2, abs=0.05)
        assert tp.laser_shadow_mm(19.35, np.radians(100.0)) == 0.0

    @given(st.floats(1.0, 100.0), st.floats(-0.34, 0.34))
    def test_the_camera_s_shadow_is_where_the_ray_over_the_edge_reaches_the_bed(
        self, height_mm: float, alpha_rad: float
    ) -> None:
        bed = 430.0
        edge = (bed - height_mm) * np.tan(alpha_rad)
        reaches = bed * np.tan(alpha_rad)
        assert tp.camera_shadow_along_mm(height_mm, alpha_rad) == pytest.approx(abs(reaches - edge), abs=1e-9)
        across = tp.camera_shadow_across_mm(height_mm, edge, bed)
        assert across == pytest.approx(abs(reaches - edge), abs=1e-9)

    def test_the_shadow_has_no_sign_and_none_under_the_camera(self) -> None:
        assert tp.camera_shadow_along_mm(20.0, -0.2) == tp.camera_shadow_along_mm(20.0, 0.2) > 0
        assert tp.camera_shadow_along_mm(20.0, 0.0) == 0.0
        assert tp.camera_shadow_across_mm(20.0, 0.0, 430.0) == 0.0
