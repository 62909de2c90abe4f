import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.calibration.thesis_scenes import THESIS, Height, Machine, dome, prism, rig, scene, stripes
from twinline.arrays import FloatArray
from twinline.calibration.thesis_align import TofAlignment, align_lasers, align_tof
from twinline.calibration.thesis_simplex import NelderMeadTrace
from twinline.calibration.thesis_surface import Surface, laser_cloud
from twinline.errors import CalibrationError

EMPTY = NelderMeadTrace(np.arange(1), np.zeros(1), np.zeros((1, 4)), np.zeros(1), ("x", "y", "z", "yaw"))


def cloud(
    height: Height = scene,
    *,
    step: tuple[float, float] = (0.83, 0.42),
    offset: float = 0.31,
    half: tuple[float, float] = (45.0, 26.0),
) -> FloatArray:
    rows, columns = np.meshgrid(
        np.arange(-half[0], half[0], step[0]) + offset, np.arange(-half[1], half[1], step[1]), indexing="ij"
    )
    x, y = rows.ravel(), columns.ravel()
    return np.column_stack([x, y, height(x, y)])


def noisy(points: FloatArray, sd_mm: float, seed: int = 3) -> FloatArray:
    out = points.copy()
    out[:, 2] += np.random.default_rng(seed).normal(0.0, sd_mm, len(out))
    return out


class TestAlignLasers:
    @settings(max_examples=15, deadline=None)
    @given(st.floats(-3.0, 3.0))
    def test_a_shift_along_the_travel_is_found(self, shift_mm: float) -> None:
        moved = noisy(cloud(dome, offset=0.1), 0.05, seed=4) - [shift_mm, 0.0, 0.0]
        result = align_lasers(moved, noisy(cloud(dome), 0.05))
        assert result.shift_mm == pytest.approx(shift_mm, abs=0.1)
        assert result.trace.names == ("shift_mm",)
        assert (np.diff(result.trace.values) <= 0).all()
        assert result.after_mm <= result.before_mm * (1.0 + 1e-12)
        assert result.after_mm == result.trace.values[-1]
        assert result.determined

    def test_the_sums_are_those_of_the_heights_at_common_places(self) -> None:
        flat = cloud(lambda x, y: 0.0 * x)
        result = align_lasers(flat + np.array([0.0, 0.0, 0.25]), flat)
        assert result.before_mm == pytest.approx(0.25 * result.places)
        assert result.after_mm == pytest.approx(result.before_mm)

    def test_a_bare_bed_determines_no_shift_and_the_result_says_so(self) -> None:
        flat = cloud(lambda x, y: 0.0 * x)
        result = align_lasers(noisy(flat, 0.05, seed=1), noisy(flat, 0.05, seed=2))
        assert not result.determined
        assert result.indifferent_mm[1] - result.indifferent_mm[0] > 5.0

    def test_a_prism_with_both_shadows_allows_a_range_of_shifts_and_the_result_says_so(self) -> None:
        machine = Machine()
        clouds = [laser_cloud(rig(THESIS), k, stripes(machine, k, height=prism, noise_px=0.1)) for k in (0, 1)]
        result = align_lasers(*clouds)
        assert not result.determined
        low, high = result.indifferent_mm
        assert high - low > 3.0

    def test_a_dome_seen_by_two_lasers_determines_the_shift(self) -> None:
        machine = Machine()
        clouds = [laser_cloud(rig(THESIS), k, stripes(machine, k, height=dome, noise_px=0.1)) for k in (0, 1)]
        result = align_lasers(clouds[0] - [1.2, 0.0, 0.0], clouds[1])
        assert result.shift_mm == pytest.approx(1.2, abs=0.1)

    def test_missing_points_do_not_count(self) -> None:
        first = cloud(dome)
        torn = first.copy()
        torn[::5] = np.nan
        result = align_lasers(torn - [0.7, 0.0, 0.0], first)
        assert result.shift_mm == pytest.approx(0.7, abs=0.1)

    def test_clouds_of_different_places_are_refused(self) -> None:
        with pytest.raises(CalibrationError, match="Only 0 places are in both the clouds of laser 1") as caught:
            align_lasers(cloud() + np.array([200.0, 0.0, 0.0]), cloud())
        assert caught.value.code == "no-overlap"

    def test_a_cloud_without_a_point_is_refused_by_name(self) -> None:
        with pytest.raises(CalibrationError, match="The cloud of laser 2 holds no measurement"):
            align_lasers(cloud(), np.full((10, 3), np.nan))

    def test_a_cloud_with_a_point_far_away_is_refused_rather_than_gridded(self) -> None:
        with pytest.raises(CalibrationError, match="The cloud spans") as caught:
            align_lasers(cloud(), np.vstack([cloud(), [1e7, 1e7, 0.0]]))
        assert caught.value.code == "cloud-too-wide"


class TestAlignTof:
    @settings(max_examples=8, deadline=None)
    @given(st.floats(-2.5, 2.5), st.floats(-2.5, 2.5), st.floats(-2.0, 2.0))
    def test_the_raster_is_laid_on_the_lasers(self, x: float, y: float, z: float) -> None:
        raster = noisy(cloud(step=(1.0, 0.5), half=(40.0, 22.0)), 0.02) - [x, y, z]
        result = align_tof(raster, noisy(cloud(), 0.05, seed=9))
        np.testing.assert_allclose(result.shift_mm[:2], [x, y], atol=0.15)
        assert result.shift_mm[2] == pytest.approx(z, abs=0.05)
        assert (np.diff(result.trace.values) <= 0).all()
        assert result.after_mm <= result.before_mm
        assert result.yaw_rad == 0.0

    def test_a_turn_is_found_where_it_is_asked_for(self) -> None:
        raster = cloud(step=(1.0, 0.5), half=(40.0, 22.0))
        turned = TofAlignment(
            np.array([0.8, -0.5, 0.3]), np.radians(-1.0), np.zeros(2), 0.0, 0.0, 0, np.zeros((4, 2)), EMPTY
        ).apply(raster)
        result = align_tof(turned, cloud(), with_yaw=True)
        assert np.degrees(result.yaw_rad) == pytest.approx(1.0, abs=0.1)
        assert result.trace.names[-1] == "yaw_deg"
        np.testing.assert_allclose(result.apply(turned), raster, atol=0.15)

    def test_what_the_scene_does_not_show_has_a_wide_interval(self) -> None:
        flat = cloud(lambda x, y: 0.0 * x)
        result = align_tof(noisy(flat, 0.02)[::2], noisy(flat, 0.02, seed=8))
        width = np.diff(result.indifferent, axis=1)[:, 0]
        assert (width[:2] > 5.0).all()
        assert width[2] < 0.1

    def test_a_raster_beside_the_laser_pass_is_refused(self) -> None:
        with pytest.raises(CalibrationError, match="places are in both the ToF raster and the laser pass") as caught:
            align_tof(cloud() + np.array([0.0, 300.0, 0.0]), cloud())
        assert caught.value.code == "no-overlap"

    def test_a_raster_without_a_reading_is_refused(self) -> None:
        with pytest.raises(CalibrationError, match="The ToF raster holds no measurement"):
            align_tof(np.full((30, 3), np.nan), cloud())


class TestSurface:
    @pytest.mark.parametrize("offset", [0.0, 0.13, 0.4])
    def test_a_slope_stays_where_it_is_wherever_the_frames_fall_in_their_cells(self, offset: float) -> None:
        points = cloud(lambda x, y: 0.4 * x - 0.2 * y, step=(1.0, 0.42), offset=offset)
        surface = Surface.of_points(points, 1.0)
        x, y = np.array([-3.3, 0.2, 8.7]), np.array([1.1, -4.6, 9.0])
        np.testing.assert_allclose(surface.at(x, y), 0.4 * x - 0.2 * y, atol=1e-9)

    def test_gaps_are_not_bridged_and_beyond_the_grid_there_is_nothing(self) -> None:
        points = cloud()
        points = points[np.abs(points[:, 0]) > 4.0]
        surface = Surface.of_points(points, 1.0)
        assert np.isnan(surface.at(np.array([0.0, 3.0, 80.0, -80.0]), np.zeros(4))).all()
        assert np.isfinite(surface.at(np.array([6.0]), np.zeros(1))).all()


def test_a_large_tilted_bed_does_not_drown_what_one_object_says() -> None:
    """Sheets of two parameters leave clouds that are tilted against each other by a millimetre and more."""
    half = (120.0, 100.0)
    first = noisy(cloud(dome, half=half, offset=0.1), 0.05, seed=4) - [1.5, 0.0, 0.0]
    first[:, 2] += 0.02 * first[:, 1]
    result = align_lasers(first, noisy(cloud(dome, half=half), 0.05))
    assert result.shift_mm == pytest.approx(1.5, abs=0.1)
    assert result.places < 0.1 * 4 * half[0] * half[1]
    assert result.determined
