import numpy as np
import pytest
import trimesh

from tests.unit.operations.exports.sample_meshes import exact_box, hill
from twinline.errors import InputError
from twinline.fusion.inspection.nearest import MeshSurface
from twinline.fusion.mesh import TriangleMesh, wholeness
from twinline.operations.mesh_simplify import simplify_to_count, simplify_to_tolerance


def furthest(of: TriangleMesh, from_mesh: TriangleMesh) -> float:
    return float(np.abs(MeshSurface(from_mesh).nearest(of.vertices_mm).signed_mm).max())


@pytest.mark.parametrize("closed", [False, True])
def test_within_a_tolerance_the_surface_stays_and_stays_whole(closed: bool) -> None:
    mesh = hill(closed=closed)
    found = simplify_to_tolerance(mesh, 0.05)
    assert len(found.faces) < 0.5 * len(mesh.faces)
    assert wholeness(found).manifold
    assert wholeness(found).watertight is closed
    # The tolerance holds for each collapse; several in a row may add up a little.
    assert furthest(mesh, found) < 0.1
    assert furthest(found, mesh) < 0.1


@pytest.mark.parametrize("closed", [False, True])
def test_a_count_is_kept_and_used(closed: bool) -> None:
    found = simplify_to_count(hill(closed=closed), 800)
    assert 500 < len(found.faces) <= 800
    assert wholeness(found).watertight is closed
    assert wholeness(found).manifold


def test_an_open_surface_stays_open_and_looks_up() -> None:
    found = simplify_to_tolerance(hill(), 0.05)
    assert (found.face_vectors_mm2()[:, 2] > 0.0).mean() > 0.999
    low, high = found.vertices_mm.min(axis=0), found.vertices_mm.max(axis=0)
    np.testing.assert_allclose(low, hill().vertices_mm.min(axis=0), atol=0.06)
    np.testing.assert_allclose(high, hill().vertices_mm.max(axis=0), atol=0.06)


def test_colours_stay_where_they_are() -> None:
    mesh = hill(colour=False)
    shade = np.clip(mesh.vertices_mm[:, [0, 1, 0]] * 4.0 + 50.0, 0, 255).astype(np.uint8)
    found = simplify_to_tolerance(TriangleMesh(mesh.vertices_mm, mesh.faces, shade), 0.05)
    assert found.colour is not None
    np.testing.assert_allclose(found.colour[:, 0], found.vertices_mm[:, 0] * 4.0 + 50.0, atol=1.5)


def test_a_mesh_of_few_triangles_is_left_alone() -> None:
    assert simplify_to_count(exact_box(), 20).faces is not None
    assert len(simplify_to_count(exact_box(), 12).faces) == 12


def test_what_cannot_be_simplified_is_refused() -> None:
    crowded = TriangleMesh(exact_box().vertices_mm, np.vstack([exact_box().faces, exact_box().faces[:1]]))
    with pytest.raises(InputError, match="more than two triangles"):
        simplify_to_tolerance(crowded, 0.1)
    with pytest.raises(InputError, match="not above zero"):
        simplify_to_tolerance(exact_box(), 0.0)
    with pytest.raises(InputError, match="3 triangles only"):
        simplify_to_count(exact_box(), 3)


def test_trimesh_finds_the_result_closed() -> None:
    found = simplify_to_tolerance(hill(closed=True), 0.05)
    other = trimesh.Trimesh(found.vertices_mm, found.faces, process=False)
    assert other.is_volume
    assert other.volume == pytest.approx(hill(closed=True).volume_mm3(), rel=0.005)
