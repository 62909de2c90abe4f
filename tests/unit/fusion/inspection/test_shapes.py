"""Planes, spheres and cylinders against shapes of known size; uncertainties against the errors really made."""

import numpy as np
import pytest

from tests.unit.fusion.inspection.surfaces import cylinder_points, flat_points, sphere_points, turned
from twinline.arrays import FloatArray
from twinline.errors import InputError
from twinline.fusion.inspection.cylinder import fit_cylinder
from twinline.fusion.inspection.plane import fit_plane
from twinline.fusion.inspection.sphere import fit_sphere

PLACE = np.array([180.0, -45.0, 60.0])
# The spread of 40 values is known to 11 %; three times that.
CALIBRATED = (0.67, 1.33)


class TestPlane:
    def test_an_exact_plane_is_found_exactly(self) -> None:
        fit = fit_plane(turned(flat_points(200), (20.0, 10.0, 5.0)) + PLACE)
        assert fit.flatness.value < 1e-9
        expected = np.degrees(np.arccos(np.cos(np.radians(20.0)) * np.cos(np.radians(10.0))))
        assert fit.tilt.value == pytest.approx(expected, abs=1e-7)
        assert abs(fit.distance(PLACE).value) < 1e-9
        assert len(fit.used) == fit.measured == 200

    def test_its_uncertainty_is_the_error_really_made(self) -> None:
        ratios = []
        for seed in range(40):
            fit = fit_plane(turned(flat_points(500, noise_mm=0.05, seed=seed), (20.0, 10.0, 5.0)) + PLACE)
            far = fit.distance(PLACE + turned(np.array([[15.0, 15.0, 0.0]]), (20.0, 10.0, 5.0))[0])
            ratios.append(far.value / far.sigma)
        assert CALIBRATED[0] < np.std(ratios) < CALIBRATED[1]

    def test_noise_that_neighbours_share_makes_it_less_certain(self) -> None:
        ratios, factors = [], []
        for seed in range(40):
            rng = np.random.default_rng(seed)
            points = flat_points(4000, noise_mm=0.02, seed=seed)
            # Patches of 4 mm that lie too high or too low as a whole, as a speckled or textured surface gives them.
            patch = np.floor((points[:, :2] + 20.0) / 4.0).astype(int) @ [1, 10]
            points[:, 2] += rng.normal(0.0, 0.05, 100)[patch]
            height = fit_plane(points).distance(np.zeros(3))
            ratios.append(height.value / height.sigma)
            factors.append(height.sigma)
        assert np.std(ratios) < 1.4, "the claimed uncertainty is too small by more than a statistical accident"
        assert np.mean(factors) > 4.0 * 0.054 / np.sqrt(4000), "patches count as if each point were a measurement"

    def test_points_of_other_surfaces_are_left_out_of_the_fit_and_stay_in_the_flatness(self) -> None:
        points = flat_points(1000, noise_mm=0.02)
        points[:200, 2] += 5.0
        fit = fit_plane(points)
        assert not np.isin(np.arange(200), fit.used).any()
        assert fit.distance(np.zeros(3)).value == pytest.approx(0.0, abs=0.005)
        assert fit.flatness.value == pytest.approx(5.0, abs=0.15)

    def test_flatness_of_noise_is_the_range_without_the_outermost_points(self) -> None:
        fit = fit_plane(flat_points(50_000, noise_mm=0.05))
        # Of a normal distribution 99.7 % lie within 2.968 sd on either side.
        assert fit.flatness.value == pytest.approx(2 * 2.968 * 0.05, abs=4 * fit.flatness.sigma)
        assert 0.0005 < fit.flatness.sigma < 0.01

    def test_unmeasured_points_keep_their_rows(self) -> None:
        points = flat_points(300, noise_mm=0.02)
        points[::3] = np.nan
        fit = fit_plane(points)
        assert np.isnan(fit.deviation_mm[::3]).all()
        assert not (fit.used % 3 == 0).any()
        assert fit.measured == 200

    @pytest.mark.parametrize(
        ("points", "words"),
        [
            (np.empty((0, 3)), "there are 0"),
            (np.full((50, 3), np.nan), "50 more have no measurement"),
            (np.outer(np.arange(50.0), [1.0, 2.0, 0.0]), "on a line"),
        ],
    )
    def test_what_determines_no_plane_is_refused(self, points: FloatArray, words: str) -> None:
        with pytest.raises(InputError, match=words):
            fit_plane(points)

    def test_better_points_weigh_more(self) -> None:
        points = flat_points(2000)
        sigma = np.where(np.arange(2000) % 2 == 0, 0.01, 0.5)
        points[:, 2] = np.random.default_rng(3).normal(0.0, sigma)
        assert fit_plane(points, sigma).distance(np.zeros(3)).sigma < 0.001


class TestSphere:
    def test_an_exact_cap_gives_the_whole_sphere(self) -> None:
        fit = fit_sphere(sphere_points(100, radius_mm=12.7) + PLACE)
        assert fit.diameter.value == pytest.approx(25.4, abs=1e-6)
        np.testing.assert_allclose(fit.centre_mm, PLACE, atol=1e-6)
        assert fit.form.value < 1e-6

    def test_its_uncertainty_is_the_error_really_made_among_outliers(self) -> None:
        ratios = []
        for seed in range(40):
            points = sphere_points(800, noise_mm=0.05, seed=seed) + PLACE
            points[:200] += np.random.default_rng(seed).normal(0.0, 3.0, (200, 3))
            fit = fit_sphere(points)
            ratios.append((fit.diameter.value - 25.4) / fit.diameter.sigma)
        assert CALIBRATED[0] < np.std(ratios) < CALIBRATED[1]

    def test_the_spacing_of_two_spheres_has_its_uncertainty(self) -> None:
        ratios = []
        for seed in range(40):
            first = fit_sphere(sphere_points(400, noise_mm=0.05, seed=seed))
            second = fit_sphere(sphere_points(400, noise_mm=0.05, seed=1000 + seed) + np.array([60.0, 25.0, 0.0]))
            spacing = first.centre_distance(second)
            ratios.append((spacing.value - 65.0) / spacing.sigma)
        assert CALIBRATED[0] < np.std(ratios) < CALIBRATED[1]

    def test_a_plane_is_no_sphere(self) -> None:
        with pytest.raises(InputError, match=r"do(es)? not determine|no sphere"):
            fit_sphere(flat_points(500))
        with pytest.raises(InputError, match=r"do(es)? not determine|no sphere"):
            fit_sphere(flat_points(500, noise_mm=0.05))


class TestCylinder:
    def test_an_exact_part_of_a_cylinder_gives_the_whole(self) -> None:
        fit = fit_cylinder(turned(cylinder_points(400), (0.0, 10.0, 35.0)) + PLACE)
        assert fit.diameter.value == pytest.approx(16.0, abs=1e-6)
        expected = turned(np.array([[1.0, 0.0, 0.0]]), (0.0, 10.0, 35.0))[0]
        np.testing.assert_allclose(fit.axis, expected, atol=1e-7)
        across = np.cross(fit.point_mm - PLACE, expected)
        np.testing.assert_allclose(across, 0.0, atol=1e-6)

    def test_its_uncertainty_is_the_error_really_made_among_outliers(self) -> None:
        ratios = []
        for seed in range(20):
            points = turned(cylinder_points(1000, noise_mm=0.05, seed=seed), (0.0, 10.0, 35.0)) + PLACE
            points[:150] += np.random.default_rng(seed).normal(0.0, 3.0, (150, 3))
            fit = fit_cylinder(points)
            ratios.append((fit.diameter.value - 16.0) / fit.diameter.sigma)
        assert 0.55 < np.std(ratios) < 1.5

    def test_a_plane_is_no_cylinder(self) -> None:
        with pytest.raises(InputError, match="no cylinder"):
            fit_cylinder(flat_points(500))
