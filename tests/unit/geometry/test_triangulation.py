import dataclasses

import numba
import numpy as np
import pytest
from scipy.optimize import least_squares

from twinline.errors import RigError
from twinline.geometry.camera import Camera
from twinline.geometry.nominal import default_rig
from twinline.geometry.rig import Covariance, Rig, Transform
from twinline.geometry.sheet import LaserSheet
from twinline.geometry.triangulation import (
    PackedLaser,
    intersect,
    pack_laser,
    point_covariance,
    stripe_point,
    stripe_points,
)

CART_MM = 137.25


def random_rays(count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-0.6, 0.6, count), rng.uniform(-0.35, 0.35, count), rng.uniform(0.5, 3, count)])


def pixels_in_view(rig: Rig, count: int = 60, seed: int = 3) -> np.ndarray:
    # On a camera turned by 90 degrees the sheets never come as far as the ends of the rows.
    low, high = ([0, 0], [1279, 719]) if rig.stripe_runs == "along-u" else ([380, 0], [900, 719])
    return np.random.default_rng(seed).uniform(low, high, (count, 2))


def perturbed(rig: Rig, name: str, change: float) -> Rig:
    """The rig with one parameter changed, written without the analytic derivatives in mind."""
    group, part = name.split(".")
    if group == "camera":
        matrix, lens = rig.camera.matrix.copy(), rig.camera.distortion.copy()
        places = {"fx": (0, 0), "fy": (1, 1), "cx": (0, 2), "cy": (1, 2)}
        if part in places:
            matrix[places[part]] += change
        else:
            lens[["k1", "k2", "p1", "p2", "k3"].index(part)] += change
        return dataclasses.replace(rig, camera=Camera(matrix, rig.camera.size, lens))
    if group.startswith("sheet"):
        index = int(group[-1]) - 1
        abc = rig.sheets[index].normal / rig.sheets[index].offset_mm
        abc["abc".index(part)] += change
        sheets = list(rig.sheets)
        sheets[index] = LaserSheet(abc, 1.0, sheets[index].side)
        return dataclasses.replace(rig, sheets=tuple(sheets))
    axis = "xyz".index(part[-1])
    step = change * np.eye(3)[axis]
    if group == "travel":
        return dataclasses.replace(rig, travel=rig.travel + step)
    rotation, translation = rig.bed_from_camera.rotation, rig.bed_from_camera.translation_mm
    if len(part) == 2:
        c, s = np.cos(change), np.sin(change)
        turn = {
            "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
            "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
            "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
        }[part[-1]]
        return dataclasses.replace(rig, bed_from_camera=Transform(np.array(turn) @ rotation, translation))
    return dataclasses.replace(rig, bed_from_camera=Transform(rotation, translation + step))


class TestIntersect:
    SHEET = LaserSheet.from_baseline_angle(246.0, np.radians(60.0), "+v")

    def test_points_lie_on_the_sheet_and_on_their_ray(self) -> None:
        rays = random_rays(500, seed=20240607)
        points_mm = intersect(self.SHEET, rays)
        assert np.isfinite(points_mm).all()
        np.testing.assert_allclose(self.SHEET.signed_distance_mm(points_mm), 0.0, atol=1e-10)
        np.testing.assert_allclose(np.cross(points_mm, rays), 0.0, atol=1e-9)
        assert (points_mm[:, 2] > 0).all()

    @pytest.mark.parametrize(
        ("case", "ray"),
        [
            ("parallel", [0.3, -np.cos(np.radians(60.0)), np.sin(np.radians(60.0))]),
            ("meets it behind the camera", [0.0, -3.0, 1.0]),
            ("looks backwards", [0.0, 3.0, -1.0]),
            ("no ray", [np.nan, 0.0, 1.0]),
        ],
    )
    def test_rays_that_never_meet_the_sheet_give_nan(self, case: str, ray: list[float]) -> None:
        assert np.isnan(intersect(self.SHEET, np.array([ray]))).all(), case

    def test_rounding_does_not_bring_parallel_rays_to_a_point(self) -> None:
        rng = np.random.default_rng(11)
        in_sheet = np.array([[1.0, 0.0, 0.0], [0.0, -np.cos(np.radians(60.0)), np.sin(np.radians(60.0))]])
        rays = np.column_stack([rng.normal(size=300), rng.uniform(0.1, 2.0, 300)]) @ in_sheet
        assert (rays @ self.SHEET.normal > 0).any()
        assert np.isnan(intersect(self.SHEET, rays)).all()

    def test_no_rays_give_no_points(self) -> None:
        assert intersect(self.SHEET, np.empty((0, 3))).shape == (0, 3)


class TestStripePoints:
    def test_they_solve_projection_sheet_and_pose_at_once(self, crooked_rig: Rig) -> None:
        pixels = pixels_in_view(crooked_rig, 20)
        for laser, sheet in enumerate(crooked_rig.sheets):
            points, _ = stripe_points(crooked_rig, laser, pixels, np.full(20, 0.1), CART_MM)
            for pixel, point in zip(pixels, points, strict=True):

                def misfit(p_in_bed: np.ndarray, pixel: np.ndarray = pixel, sheet: LaserSheet = sheet) -> np.ndarray:
                    at_cart_0 = p_in_bed - CART_MM * crooked_rig.travel
                    p = crooked_rig.bed_from_camera.rotation.T @ (
                        at_cart_0 - crooked_rig.bed_from_camera.translation_mm
                    )
                    x, y = p[0] / p[2], p[1] / p[2]
                    k1, k2, p1, p2, k3 = crooked_rig.camera.distortion
                    r = np.hypot(x, y)
                    ring = 1 + k1 * r**2 + k2 * r**4 + k3 * r**6
                    u = 633.9 + 1041.3 * (x * ring + 2 * p1 * x * y + p2 * (3 * x**2 + y**2))
                    v = 371.2 + 1038.7 * (y * ring + p1 * (x**2 + 3 * y**2) + 2 * p2 * x * y)
                    return np.array([u - pixel[0], v - pixel[1], np.dot(sheet.normal, p) - sheet.offset_mm])

                solution = least_squares(misfit, point + 1.0, xtol=1e-15, ftol=1e-15, gtol=1e-15)
                np.testing.assert_allclose(solution.x, point, atol=1e-6)

    def test_they_agree_with_rays_sheet_and_pose_one_after_the_other(self, crooked_rig: Rig) -> None:
        pixels = pixels_in_view(crooked_rig, 2560)
        in_camera = intersect(crooked_rig.sheets[1], crooked_rig.camera.rays(pixels))
        expected = crooked_rig.bed_from_camera.apply(in_camera) + crooked_rig.travel * CART_MM
        points, _ = stripe_points(crooked_rig, 1, pixels, np.full(2560, 0.1), CART_MM)
        np.testing.assert_allclose(points, expected, rtol=1e-12, atol=1e-9)

    def test_sigma_is_the_length_of_the_derivative_across_the_stripe(self, crooked_rig: Rig) -> None:
        pixels, h = pixels_in_view(crooked_rig), 1e-4
        sd_px = np.linspace(0.01, 0.3, len(pixels))
        step = np.array([0.0, h]) if crooked_rig.stripe_runs == "along-u" else np.array([h, 0.0])
        for laser in (0, 1):
            _, sigma = stripe_points(crooked_rig, laser, pixels, sd_px, CART_MM)
            ahead, _ = stripe_points(crooked_rig, laser, pixels + step, sd_px, CART_MM)
            behind, _ = stripe_points(crooked_rig, laser, pixels - step, sd_px, CART_MM)
            moved = np.linalg.norm(ahead - behind, axis=1) / (2 * h)
            np.testing.assert_allclose(sigma, moved * sd_px, rtol=1e-6)

    def test_on_the_nominal_axis_sigma_is_depth_per_pixel_along_the_sheet(self) -> None:
        rig = default_rig()
        _, sigma = stripe_points(rig, 0, np.array([[rig.camera.cx, rig.camera.cy]]), np.array([0.1]), 0.0)
        depth = 246.0 * np.tan(np.radians(60.0))
        along_the_sheet = 1.0 / np.sin(np.radians(60.0))
        assert sigma[0] == pytest.approx(0.1 * depth**2 / (246.0 * rig.camera.fy) * along_the_sheet)

    def test_a_simulated_scatter_has_the_reported_sigma(self, crooked_rig: Rig) -> None:
        rng = np.random.default_rng(8)
        across = 1 if crooked_rig.stripe_runs == "along-u" else 0
        pixels = np.tile([[300.0, 500.0]], (20000, 1))
        _, sigma = stripe_points(crooked_rig, 0, pixels[:1], np.array([0.08]), 0.0)
        pixels[:, across] += rng.normal(scale=0.08, size=len(pixels))
        points, _ = stripe_points(crooked_rig, 0, pixels, np.zeros(len(pixels)), 0.0)
        assert np.sqrt(np.trace(np.cov(points.T))) == pytest.approx(sigma[0], rel=0.03)

    def test_missing_centres_and_impossible_rays_keep_their_row_as_nan(self) -> None:
        rig = default_rig()
        pixels = np.array([[640.0, 400.0], [640.0, np.nan], [np.nan, 400.0], [640.0, -3000.0]])
        points, sigma = stripe_points(rig, 0, pixels, np.full(4, 0.1), 0.0)
        assert np.isfinite(points).all(axis=1).tolist() == [True, False, False, False]
        assert np.isfinite(sigma).tolist() == [True, False, False, False]

    def test_the_cart_moves_points_by_the_travel_alone(self, crooked_rig: Rig) -> None:
        pixels, sd_px = pixels_in_view(crooked_rig), np.full(60, 0.1)
        here, _ = stripe_points(crooked_rig, 0, pixels, sd_px, 0.0)
        there, _ = stripe_points(crooked_rig, 0, pixels, sd_px, 50.0)
        np.testing.assert_allclose(there - here, np.tile(50.0 * crooked_rig.travel, (60, 1)), atol=1e-10)

    def test_single_precision_and_strided_input_is_taken(self) -> None:
        rig, pixels = default_rig(), pixels_in_view(default_rig())
        expected, _ = stripe_points(rig, 0, pixels.astype(np.float32).astype(np.float64), np.full(60, 0.1), 0.0)
        wide = np.zeros((120, 2), np.float32)
        wide[::2] = pixels
        points, _ = stripe_points(rig, 0, wide[::2], np.full(60, 0.1, np.float32), 0)
        np.testing.assert_array_equal(points, expected)

    def test_no_pixels_give_no_points(self) -> None:
        points, sigma = stripe_points(default_rig(), 0, np.empty((0, 2)), np.empty(0), 0.0)
        assert points.shape == (0, 3)
        assert sigma.shape == (0,)

    @pytest.mark.parametrize("laser", [-1, 2])
    def test_a_laser_that_is_not_there_is_named(self, laser: int) -> None:
        with pytest.raises(RigError, match=f"Laser {laser + 1} .*has 2"):
            stripe_points(default_rig(), laser, np.zeros((1, 2)), np.zeros(1), 0.0)

    def test_compiled_code_can_call_the_kernel(self, crooked_rig: Rig) -> None:
        @numba.njit
        def highest(packed: PackedLaser, pixels: np.ndarray) -> float:
            best = -1e9
            for i in range(pixels.shape[0]):
                _, _, z, _ = stripe_point(packed, pixels[i, 0], pixels[i, 1], 0.1, 0.0)
                best = max(best, z)
            return best

        points, _ = stripe_points(crooked_rig, 0, pixels_in_view(crooked_rig), np.full(60, 0.1), 0.0)
        found = highest(pack_laser(crooked_rig, 0), pixels_in_view(crooked_rig))
        assert found == pytest.approx(float(points[:, 2].max()), abs=1e-9)


NAMES = (
    *(f"camera.{part}" for part in ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")),
    *(f"sheet1.{part}" for part in "abc"),
    *(f"bed.{part}" for part in ("rx", "ry", "rz", "x", "y", "z")),
    *(f"travel.{part}" for part in "xyz"),
)
SD = {"camera.f": 0.5, "camera.c": 0.5, "camera.k": 1e-3, "camera.p": 1e-4, "sheet1": 1e-7, "bed.r": 1e-4, "bed": 0.05}


def plausible_sd(name: str) -> float:
    return next((sd for prefix, sd in SD.items() if name.startswith(prefix)), 1e-4)


class TestPointCovariance:
    @pytest.mark.parametrize("name", NAMES)
    def test_each_parameter_moves_points_as_differences_say(self, crooked_rig: Rig, name: str) -> None:
        pixels, sd = pixels_in_view(crooked_rig), plausible_sd(name)
        rig = dataclasses.replace(crooked_rig, covariance=Covariance((name,), np.array([[sd**2]])))
        h = sd * 1e-2
        ahead, _ = stripe_points(perturbed(rig, name, h), 0, pixels, np.zeros(60), CART_MM)
        behind, _ = stripe_points(perturbed(rig, name, -h), 0, pixels, np.zeros(60), CART_MM)
        slope = (ahead - behind) / (2 * h)
        expected = sd**2 * slope[:, :, None] * slope[:, None, :]
        found = point_covariance(rig, 0, pixels, CART_MM)
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5 * np.abs(expected).max())

    def test_correlated_parameters_are_propagated_together(self, crooked_rig: Rig) -> None:
        rng = np.random.default_rng(4)
        names = ("camera.fy", "sheet1.c", "bed.rx", "travel.x", "tof.gain", "sheet2.a")
        scale = np.array([plausible_sd(name) for name in names])
        mix = rng.normal(size=(6, 6))
        matrix = scale[:, None] * (mix @ mix.T / 6) * scale
        rig = dataclasses.replace(crooked_rig, covariance=Covariance(names, matrix))
        pixel = np.array([[700.0, 520.0]])
        draws = rng.multivariate_normal(np.zeros(6), matrix, size=3000, method="cholesky")
        points = []
        for draw in draws:
            changed = rig
            for name, change in zip(names[:4], draw[:4], strict=True):
                changed = perturbed(changed, name, change)
            points.append(stripe_points(changed, 0, pixel, np.zeros(1), CART_MM)[0][0])
        found = point_covariance(rig, 0, pixel, CART_MM)[0]
        np.testing.assert_allclose(found, np.cov(np.array(points).T), atol=0.08 * np.abs(found).max())

    def test_a_rig_without_covariance_adds_nothing_and_missing_points_stay_nan(self) -> None:
        found = point_covariance(default_rig(), 0, np.array([[640.0, 400.0], [640.0, np.nan]]), 0.0)
        assert (found[0] == 0).all()
        assert np.isnan(found[1]).all()

    @pytest.mark.parametrize("name", ["camera.f", "sheet3.a", "sheet1.d", "bed.q", "nonsense"])
    def test_a_name_that_is_no_parameter_is_refused(self, name: str) -> None:
        rig = dataclasses.replace(default_rig(), covariance=Covariance((name,), np.eye(1)))
        with pytest.raises(RigError, match=name):
            point_covariance(rig, 0, np.array([[640.0, 400.0]]), 0.0)
