import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.calibration.thesis_scenes import CENTRE, FOCAL, HEIGHT_MM, THESIS, camera
from twinline.arrays import FloatArray
from twinline.calibration.thesis_fit import fit_sheet
from twinline.calibration.thesis_picks import PickedPoints
from twinline.errors import CalibrationError
from twinline.geometry.camera import Camera
from twinline.geometry.sheet import SIDES, LaserSheet, Side


def seen(baseline: float, degrees: float, side: Side, depth: FloatArray, seed: int = 1) -> PickedPoints:
    """Where a two-parameter machine's stripe lies on surfaces of the given depths."""
    tangent = baseline / depth - 1.0 / np.tan(np.radians(degrees))
    tangent = tangent if side[0] == "+" else -tangent
    other = np.random.default_rng(seed).uniform(-0.3, 0.3, len(depth))
    x, y = (tangent, other) if side[1] == "u" else (other, tangent)
    return PickedPoints(np.column_stack([FOCAL[0] * x + CENTRE[0], FOCAL[1] * y + CENTRE[1]]), depth)


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize(("baseline", "degrees"), THESIS)
def test_two_points_give_an_exact_machine_back(baseline: float, degrees: float, side: Side) -> None:
    points = seen(baseline, degrees, side, np.array([430.0, 430.0 - 19.35]))
    fit = fit_sheet(camera(), side, points)
    assert fit.baseline_mm == pytest.approx(baseline, abs=1e-6)
    assert np.degrees(fit.angle_rad) == pytest.approx(degrees, abs=1e-6)
    assert fit.sum_mm < 1e-6
    assert fit.sheet.side == side
    assert fit.sheet.baseline_mm == pytest.approx(fit.baseline_mm)
    assert fit.trace.names == ("baseline_mm", "angle_deg")
    np.testing.assert_array_equal(fit.trace.parameters[0], [246.0, 60.0])
    assert (np.diff(fit.trace.values) <= 0).all()
    assert 10 < len(fit.trace) < 400


@settings(max_examples=40)
@given(st.floats(200, 300), st.floats(52, 70), st.sampled_from(SIDES))
def test_any_plausible_machine_is_found_from_the_nominal_one(baseline: float, degrees: float, side: Side) -> None:
    depth = np.array([430.0, 420.0, 400.0, 350.0])
    fit = fit_sheet(camera(), side, seen(baseline, degrees, side, depth))
    assert fit.baseline_mm == pytest.approx(baseline, abs=1e-5)
    assert np.degrees(fit.angle_rad) == pytest.approx(degrees, abs=1e-5)


def test_the_sum_is_that_of_the_points_and_the_majority_outvotes_a_stray() -> None:
    points = seen(*THESIS[0], "+v", np.repeat([430.0, 410.65, 380.0], 5))
    strays = points.depth_mm.copy()
    strays[3] -= 12.0
    fit = fit_sheet(camera(), "+v", PickedPoints(points.pixels, strays))
    assert fit.baseline_mm == pytest.approx(THESIS[0][0], abs=1e-5)
    assert fit.sum_mm == pytest.approx(12.0, abs=1e-5)
    assert fit.trace.values[-1] == pytest.approx(fit.sum_mm)


def test_points_without_a_depth_or_a_stripe_do_not_count() -> None:
    points = seen(*THESIS[1], "-v", np.array([430.0, 425.0, 410.65, 400.0]))
    depth, pixels = points.depth_mm.copy(), points.pixels.copy()
    depth[0], pixels[2] = np.nan, np.nan
    fit = fit_sheet(camera(), "-v", PickedPoints(pixels, depth))
    assert len(fit.points) == len(fit.residual_mm) == 2
    assert fit.baseline_mm == pytest.approx(THESIS[1][0], abs=1e-6)


def test_the_lens_is_ignored_unless_undistorted_rays_are_asked_for() -> None:
    lens = Camera(camera().matrix, (1280, 720), np.array([-0.2, 0.1, 0.0, 0.0, 0.0]))
    points = seen(*THESIS[0], "+v", np.array([430.0, 410.65, 360.0]))
    x = (points.pixels - CENTRE) / FOCAL
    bent = lens.project(np.column_stack([x, np.ones(3)]))
    bent_points = PickedPoints(bent, points.depth_mm)
    faithful, better = (fit_sheet(lens, "+v", bent_points, lens=choice) for choice in ("ignored", "undistorted"))
    assert better.baseline_mm == pytest.approx(THESIS[0][0], abs=1e-6)
    assert better.lens == "undistorted"
    assert abs(faithful.baseline_mm - THESIS[0][0]) > 1.0
    np.testing.assert_allclose(
        fit_sheet(camera(), "+v", bent_points).trace.values, faithful.trace.values, err_msg="rays of a pinhole"
    )


def test_a_search_may_start_at_the_nominal_rig() -> None:
    start = LaserSheet.from_baseline_angle(230.0, np.radians(57.0), "+v")
    fit = fit_sheet(camera(), "+v", seen(*THESIS[0], "+v", np.array([430.0, 400.0])), start=start)
    np.testing.assert_allclose(fit.trace.parameters[0], [230.0, 57.0])
    assert fit.baseline_mm == pytest.approx(THESIS[0][0], abs=1e-6)


@pytest.mark.parametrize(
    ("depth", "code", "message"),
    [
        ([430.0, np.nan, np.nan], "too-few-points", "Of 3 picked points 1 have"),
        ([np.nan, np.nan], "too-few-points", "Of 2 picked points 0 have"),
        ([430.0, 430.0, 430.0], "sheet-unobservable", "at least 10 mm high"),
        ([430.0, -20.0], "bad-picks", "behind the camera"),
    ],
)
def test_points_that_determine_nothing_are_refused_with_the_next_step(
    depth: list[float], code: str, message: str
) -> None:
    pixels = seen(*THESIS[0], "+v", np.nan_to_num(np.abs(depth), nan=430.0)).pixels
    with pytest.raises(CalibrationError, match=message) as caught:
        fit_sheet(camera(), "+v", PickedPoints(pixels, np.array(depth)))
    assert caught.value.code == code


def test_a_depth_for_each_pixel_is_asked_for() -> None:
    with pytest.raises(CalibrationError, match="2 picked pixels have 1 ToF depths"):
        PickedPoints(np.zeros((2, 2)), np.array([430.0]))


def test_heights_above_the_bed_become_depths_below_the_camera() -> None:
    points = PickedPoints.from_heights(np.zeros((2, 2)), np.array([0.0, 19.35]), HEIGHT_MM)
    np.testing.assert_allclose(points.depth_mm, [430.0, 410.65])
