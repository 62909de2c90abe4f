import numpy as np
import pytest
import trimesh

from twinline.arrays import FloatArray
from twinline.errors import InputError
from twinline.fusion.inspection.nearest import MeshSurface
from twinline.fusion.mesh import TriangleMesh


def test_it_finds_what_trying_every_triangle_finds() -> None:
    rng = np.random.default_rng(7)
    soup = rng.uniform(0.0, 10.0, (200, 3))
    mesh = TriangleMesh(soup, rng.permutation(200)[:198].reshape(66, 3))
    points = rng.uniform(-3.0, 13.0, (300, 3))
    found = MeshSurface(mesh).nearest(points)
    every = np.stack([np.linalg.norm(points - _on_triangle(t, points), axis=1) for t in mesh.corners_mm()])
    np.testing.assert_allclose(np.linalg.norm(points - found.points_mm, axis=1), every.min(axis=0), atol=1e-9)


def _on_triangle(triangle: FloatArray, points: FloatArray) -> FloatArray:
    return np.asarray(trimesh.triangles.closest_point(np.repeat(triangle[None], len(points), axis=0), points))


def test_distances_to_a_box_are_exact_and_negative_inside_also_at_its_corners_and_edges() -> None:
    box = trimesh.creation.box((10.0, 20.0, 30.0))
    surface = MeshSurface(TriangleMesh(box.vertices, box.faces))
    rng = np.random.default_rng(3)
    points = rng.uniform(-25.0, 25.0, (5000, 3))
    outside = np.abs(points) - [5.0, 10.0, 15.0]
    # I. Quilez's distance to a box: outside the rest beyond each face, inside the nearest face.
    expected = np.linalg.norm(np.maximum(outside, 0.0), axis=1) + np.minimum(outside.max(axis=1), 0.0)
    found = surface.nearest(points)
    np.testing.assert_allclose(found.signed_mm, expected, atol=1e-9)
    assert not found.on_border.any()


def test_points_beside_an_open_mesh_are_marked() -> None:
    square = TriangleMesh(
        np.array([[0.0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0]]), np.array([[0, 1, 2], [0, 2, 3]])
    )
    found = MeshSurface(square).nearest(np.array([[5.0, 4.0, 1.0], [12.0, 5.0, 1.0], [-1.0, -1.0, -1.0]]))
    np.testing.assert_array_equal(found.on_border, [False, True, True])
    assert found.signed_mm[0] == pytest.approx(1.0)


def test_unmeasured_points_have_no_nearest_point() -> None:
    box = trimesh.creation.box()
    found = MeshSurface(TriangleMesh(box.vertices, box.faces)).nearest(np.array([[np.nan, 0, 0], [2.0, 0, 0]]))
    assert np.isnan(found.signed_mm[0])
    assert np.isnan(found.points_mm[0]).all()
    assert found.faces[0] == -1
    assert found.signed_mm[1] == pytest.approx(1.5)


def test_triangles_without_area_are_passed_over() -> None:
    box = trimesh.creation.box()
    faces = np.vstack([[[0, 0, 1]], box.faces])
    assert MeshSurface(TriangleMesh(box.vertices, faces)).nearest(np.array([[2.0, 0, 0]])).signed_mm[0] == 1.5
    with pytest.raises(InputError, match="no triangles"):
        MeshSurface(TriangleMesh(box.vertices, np.array([[0, 0, 1]])))
