"""Alignment against motions that are known, and in scenes that do not show all of them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.unit.fusion.inspection.surfaces import block_points, flat_points, turned
from twinline.arrays import FloatArray
from twinline.errors import InputError
from twinline.fusion.inspection.alignment import align_to_cloud, align_to_mesh
from twinline.fusion.inspection.nearest import MeshSurface
from twinline.fusion.inspection.placing import place_on_mesh
from twinline.fusion.inspection.rigid import RigidMotion, small_motion
from twinline.fusion.mesh import TriangleMesh


def box_surface(size_mm: tuple[float, float, float]) -> MeshSurface:
    box = trimesh.creation.box(size_mm)
    return MeshSurface(TriangleMesh(np.asarray(box.vertices), np.asarray(box.faces)))


def wedge(count: int, seed: int = 1) -> tuple[FloatArray, MeshSurface]:
    """Points seen from above on a body without symmetry, and the body."""
    corners = np.array([[0, 0, 0], [40, 0, 0], [0, 25, 0], [4, 5, 18], [30, 4, 7]], float)
    hull = trimesh.convex.convex_hull(corners)
    points, face = trimesh.sample.sample_surface(hull, count, seed=seed)
    seen = hull.face_normals[face][:, 2] > 0.05
    return np.asarray(points)[seen], MeshSurface(TriangleMesh(np.asarray(hull.vertices), np.asarray(hull.faces)))


class TestMotion:
    def test_one_motion_after_another(self) -> None:
        first = small_motion(np.array([0.3, -0.2, 0.1]), np.array([1.0, 2.0, 3.0]))
        second = small_motion(np.array([0.1, 0.2, 0.4]), np.array([-4.0, 1.0, 0.0]))
        points = flat_points(10)
        np.testing.assert_allclose(second.after(first).apply(points), second.apply(first.apply(points)), atol=1e-12)
        assert first.angle_deg == pytest.approx(np.degrees(np.linalg.norm([0.3, -0.2, 0.1])))

    def test_about_a_centre_leaves_the_centre(self) -> None:
        centre = np.array([[5.0, 6.0, 7.0]])
        motion = small_motion(np.array([0.0, 0.0, 0.5]), np.zeros(3)).about(centre[0])
        np.testing.assert_allclose(motion.apply(centre), centre, atol=1e-12)


class TestAlignment:
    def test_a_known_motion_onto_a_mesh_is_found(self) -> None:
        points, surface = wedge(8000)
        known = small_motion(np.radians([2.0, -1.0, 4.0]), np.array([0.5, -0.8, 0.3]))
        found = align_to_mesh(known.apply(points), surface)
        np.testing.assert_allclose(found.motion.after(known).rotation, np.eye(3), atol=1e-6)
        np.testing.assert_allclose(found.motion.after(known).translation_mm, 0.0, atol=1e-4)
        assert found.held == ()

    def test_its_uncertainty_is_the_error_really_made(self) -> None:
        ratios = []
        for seed in range(25):
            points, surface = wedge(1500, seed=seed)
            noise = np.random.default_rng(seed).normal(0.0, 0.05, points.shape)
            found = align_to_mesh(points + noise, surface)
            at = points.mean(axis=0)
            ratios.append((found.motion.apply(at[None])[0] - at) / np.sqrt(np.diag(found.covariance)[3:]))
        assert 0.7 < np.std(ratios) < 1.4

    def test_a_flat_scene_is_moved_in_height_and_tilt_only(self) -> None:
        plate = box_surface((200.0, 200.0, 10.0))
        points = flat_points(4000, noise_mm=0.05) + np.array([3.0, 4.0, 5.4])
        found = align_to_mesh(turned(points, (0.5, 0.0, 0.0)), plate)
        assert sorted(found.held) == ["shift along x", "shift along y", "turn about z"]
        moved = found.motion.apply(turned(points, (0.5, 0.0, 0.0)))
        np.testing.assert_allclose(moved[:, 2].mean(), 5.0, atol=0.005)
        # The scene does not tell where it lies sideways, so nothing may move it there.
        np.testing.assert_allclose((moved - turned(points, (0.5, 0.0, 0.0)))[:, :2], 0.0, atol=0.1)

    def test_two_flat_clouds_are_not_moved_sideways_by_their_noise(self) -> None:
        first, second = flat_points(6000, noise_mm=0.05, seed=1), flat_points(6000, noise_mm=0.05, seed=2)
        found = align_to_cloud(first + np.array([0.0, 0.0, 0.3]), second)
        assert len(found.held) == 3
        np.testing.assert_allclose(found.motion.translation_mm[2], -0.3, atol=0.02)
        np.testing.assert_allclose(found.motion.translation_mm[:2], 0.0, atol=0.02)

    def test_points_of_another_object_do_not_pull(self) -> None:
        points, surface = wedge(6000)
        known = small_motion(np.radians([1.0, -1.0, 2.0]), np.array([0.3, -0.4, 0.2]))
        strangers = np.random.default_rng(2).uniform(-10.0, 50.0, (len(points) // 4, 3))
        found = align_to_mesh(np.concatenate([known.apply(points), strangers]), surface)
        np.testing.assert_allclose(found.motion.after(known).translation_mm, 0.0, atol=1e-3)

    def test_too_few_points_near_the_reference_are_refused(self) -> None:
        points, surface = wedge(500)
        with pytest.raises(InputError, match="Only 0 of"):
            align_to_mesh(points + np.array([500.0, 0.0, 0.0]), surface, reach_mm=5.0)

    def test_the_known_motion_of_the_dragon_is_found(self, shared_data: Callable[[str], Path]) -> None:
        # 100 000 points moved rigidly; its publisher states the motion. 0.02 degrees is what was asked for.
        folder = shared_data("icp_pairs")
        reference, moved = np.loadtxt(folder / "dragon1.xyz"), np.loadtxt(folder / "dragon2.xyz")
        found = align_to_cloud(moved[::5], reference)
        assert found.motion.angle_deg == pytest.approx(3.755459, abs=0.0005)
        np.testing.assert_allclose(found.motion.translation_mm, [-0.20041906, -0.40047009, -0.59954649], atol=1e-4)
        residual = np.linalg.norm(found.motion.apply(moved) - reference, axis=1)
        assert residual.max() < 1e-3


class TestPlacing:
    @pytest.mark.parametrize("angles_deg", [(0.0, 0.0, 130.0), (0.0, 0.0, -77.0), (90.0, 30.0, 10.0)])
    def test_a_scan_is_laid_on_its_mesh_from_anywhere(self, angles_deg: tuple[float, float, float]) -> None:
        points, surface = wedge(6000)
        far = turned(points, angles_deg) + np.array([150.0, -80.0, 20.0])
        found = place_on_mesh(far, surface)
        np.testing.assert_allclose(found.motion.apply(far), points, atol=0.01)

    def test_without_a_search_it_stays_near(self) -> None:
        points, surface = wedge(3000)
        found = place_on_mesh(points + np.array([0.3, 0.2, 0.1]), surface, search=False)
        np.testing.assert_allclose(found.motion.translation_mm, [-0.3, -0.2, -0.1], atol=1e-4)

    def test_a_block_scanned_from_above_finds_its_height(self) -> None:
        points = block_points((25.4, 24.2, 19.35), noise_mm=0.02, bed_mm=0.0)
        points = points[points[:, 2] > 10.0]
        found = place_on_mesh(points, box_surface((25.4, 24.2, 19.35)))
        top = found.motion.apply(points)
        assert np.sqrt(np.mean((np.abs(top) - np.array([12.7, 12.1, 9.675]))[:, 2] ** 2)) < 0.03
        assert isinstance(found.motion, RigidMotion)
