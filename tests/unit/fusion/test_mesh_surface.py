"""Meshes from height maps, looked at by trimesh as well."""

import numpy as np
import pytest
import trimesh

from twinline.arrays import FloatArray
from twinline.errors import InputError
from twinline.fusion.mesh import TriangleMesh, merged, require_triangles, wholeness
from twinline.fusion.mesh_surface import border_edges, small_gaps_filled, solid_mesh, surface_mesh


def seen_by_trimesh(mesh: TriangleMesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)


def dome(ny: int = 41, nx: int = 51, pitch_mm: float = 0.5) -> FloatArray:
    y, x = np.mgrid[:ny, :nx] * pitch_mm
    return np.asarray(10.0 - 0.02 * (x - 12.0) ** 2 - 0.03 * (y - 10.0) ** 2)


def holed(share: float, seed: int = 5) -> FloatArray:
    z = dome()
    z[np.random.default_rng(seed).random(z.shape) < share] = np.nan
    return z


class TestSurface:
    def test_its_corners_are_the_cells_and_its_normals_point_up(self) -> None:
        z = dome()
        mesh = surface_mesh(z, -3.0, 7.0, 0.5)
        assert len(mesh.faces) == 2 * 40 * 50
        assert (mesh.face_vectors_mm2()[:, 2] > 0).all()
        expected = [-3.0 + 0.5 * 50, 7.0 + 0.5 * 40, z[40, 50]]
        np.testing.assert_allclose(mesh.vertices_mm[-1], expected)
        assert seen_by_trimesh(mesh).is_winding_consistent

    @pytest.mark.parametrize("share", [0.02, 0.3, 0.6])
    def test_it_is_manifold_whatever_is_missing(self, share: float) -> None:
        mesh = surface_mesh(holed(share), 0.0, 0.0, 0.5)
        assert wholeness(mesh).manifold
        # One way out of each border corner: nothing touches itself in a single point.
        assert np.bincount(border_edges(mesh)[:, 0]).max() == 1

    def test_no_triangle_bridges_a_step_in_depth(self) -> None:
        z = np.zeros((20, 20))
        z[:, 10:] = 15.0
        mesh = surface_mesh(z, 0.0, 0.0, 0.5)
        heights = mesh.corners_mm()[..., 2]
        assert (np.ptp(heights, axis=1) == 0.0).all()
        assert len(mesh.faces) == 2 * 19 * 18
        bridged = surface_mesh(z, 0.0, 0.0, 0.5, steepest_deg=None)
        assert len(bridged.faces) == 2 * 19 * 19

    def test_a_slope_below_the_limit_is_kept_whole(self) -> None:
        z = np.tan(np.radians(75.0)) * 0.5 * np.mgrid[:10, :10].sum(axis=0) / np.sqrt(2.0)
        assert len(surface_mesh(z, 0.0, 0.0, 0.5).faces) == 2 * 81
        with pytest.raises(InputError, match="no three neighbouring cells"):
            surface_mesh(z, 0.0, 0.0, 0.5, steepest_deg=70.0)

    def test_colours_stay_with_their_cells(self) -> None:
        z = holed(0.3)
        colour = np.zeros((*z.shape, 3), np.uint8)
        colour[..., 0] = np.arange(z.shape[1])
        colour[..., 1] = np.arange(z.shape[0])[:, None]
        mesh = surface_mesh(z, 0.0, 0.0, 1.0, colour=colour)
        assert mesh.colour is not None
        np.testing.assert_array_equal(mesh.colour[:, :2], mesh.vertices_mm[:, :2])

    @pytest.mark.parametrize("z", [np.full((5, 5), np.nan), np.zeros((1, 9)), np.zeros((0, 0))])
    def test_an_empty_map_is_refused(self, z: FloatArray) -> None:
        with pytest.raises(InputError, match="makes no mesh"):
            surface_mesh(z, 0.0, 0.0, 0.5)


class TestSolid:
    @pytest.mark.parametrize("share", [0.0, 0.3, 0.6])
    def test_it_is_closed_and_its_volume_is_that_under_the_surface(self, share: float) -> None:
        z = holed(share)
        mesh = solid_mesh(z, 0.0, 0.0, 0.5)
        assert wholeness(mesh).watertight
        assert seen_by_trimesh(mesh).is_volume
        assert mesh.volume_mm3() == pytest.approx(float(seen_by_trimesh(mesh).volume), rel=1e-9)
        top = surface_mesh(z, 0.0, 0.0, 0.5, steepest_deg=None)
        under = (top.face_vectors_mm2()[:, 2] / 2 * top.corners_mm()[..., 2].mean(axis=1)).sum()
        assert mesh.volume_mm3() == pytest.approx(float(under), rel=1e-9)

    def test_a_block_on_the_bed_has_its_volume_and_area(self) -> None:
        z = np.full((21, 41), np.nan)
        z[5:16, 10:31] = 8.0
        mesh = solid_mesh(z, 0.0, 0.0, 0.5)
        assert mesh.volume_mm3() == pytest.approx(10.0 * 5.0 * 8.0)
        assert mesh.area_mm2() == pytest.approx(2 * 50.0 + 2 * 8.0 * 15.0)

    def test_noise_below_the_base_does_not_pinch_the_body(self) -> None:
        z = np.random.default_rng(2).normal(0.02, 0.05, (30, 30))
        mesh = solid_mesh(z, 0.0, 0.0, 0.5)
        assert mesh.volume_mm3() > 0.0
        assert (mesh.face_vectors_mm2()[: len(mesh.faces) // 3, 2] > 0.0).all()

    def test_nothing_above_the_base_is_refused(self) -> None:
        with pytest.raises(InputError, match="Nothing rises above the base at 0 mm"):
            solid_mesh(np.full((9, 9), -1.0), 0.0, 0.0, 0.5)


class TestGaps:
    def test_small_gaps_are_filled_smoothly_and_large_ones_and_the_outside_stay(self) -> None:
        z = dome()
        truth = z.copy()
        z[10:13, 10:13] = np.nan
        z[20:30, 20:40] = np.nan
        z[:, :3] = np.nan
        filled = small_gaps_filled(z, 20)
        np.testing.assert_allclose(filled[10:13, 10:13], truth[10:13, 10:13], atol=0.15)
        assert np.isnan(filled[20:30, 20:40]).all()
        assert np.isnan(filled[:, :3]).all()
        known = ~np.isnan(z)
        np.testing.assert_array_equal(filled[known], z[known])

    def test_narrow_gaps_are_filled_however_long_they_are(self) -> None:
        z = dome()
        truth = z.copy()
        z[::2] = np.nan
        z[:, 40:46] = np.nan
        filled = small_gaps_filled(z, 4, 1)
        np.testing.assert_allclose(filled[2:-2, 1:38], truth[2:-2, 1:38], atol=0.1)
        assert np.isnan(filled[:, 42:44]).all()
        assert np.isnan(small_gaps_filled(z, 4)[::2]).all()

    def test_gaps_at_a_step_stay(self) -> None:
        z = np.where(np.arange(40) < 20, 0.0, 15.0) * np.ones((30, 1))
        z[:, 19] = np.nan
        z[:, 5] = np.nan
        filled = small_gaps_filled(z, 4, 1, step_mm=1.0)
        assert np.isnan(filled[:, 19]).all()
        np.testing.assert_allclose(filled[:, 5], 0.0)


class TestMesh:
    def test_soup_becomes_whole_by_merging(self) -> None:
        box = trimesh.creation.box((2.0, 3.0, 4.0))
        soup = TriangleMesh(np.asarray(box.triangles).reshape(-1, 3), np.arange(36).reshape(12, 3))
        assert not wholeness(soup).watertight
        assert wholeness(merged(soup)).watertight
        assert merged(soup).volume_mm3() == pytest.approx(24.0)

    def test_wrong_edges_are_told_apart(self) -> None:
        box = trimesh.creation.box()
        faces = np.array(box.faces)
        faces[0] = faces[0, ::-1]
        assert wholeness(TriangleMesh(box.vertices, faces)).twisted_edges == 3
        assert wholeness(TriangleMesh(box.vertices, box.faces[1:])).open_edges == 3
        assert wholeness(TriangleMesh(box.vertices, np.vstack([box.faces, box.faces[:1]]))).crowded_edges == 3

    def test_vertex_normals_of_a_sphere_point_outwards(self) -> None:
        sphere = trimesh.creation.icosphere(3)
        normals = TriangleMesh(sphere.vertices, sphere.faces).vertex_normals()
        np.testing.assert_allclose(normals, sphere.vertices, atol=0.02)

    def test_what_is_no_mesh_is_refused(self) -> None:
        with pytest.raises(InputError, match="no triangles"):
            require_triangles(TriangleMesh(np.zeros((4, 3)), np.zeros((0, 3), int)), "a.stl")
        with pytest.raises(InputError, match="1 of 1 triangles"):
            require_triangles(TriangleMesh(np.full((3, 3), np.nan), np.array([[0, 1, 2]])), "a.stl")
