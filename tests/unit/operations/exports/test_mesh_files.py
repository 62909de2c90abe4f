"""Mesh files as trimesh reads them back."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.unit.operations.exports.sample_clouds import PROVENANCE, random_cloud
from tests.unit.operations.exports.sample_meshes import exact_box, hill
from twinline.errors import OutputError
from twinline.fusion.cloud import PointCloud
from twinline.fusion.mesh import TriangleMesh
from twinline.operations.exports.glb_mesh import write_mesh_glb
from twinline.operations.exports.provenance import Provenance
from twinline.operations.exports.stl import write_stl
from twinline.operations.exports.text_geometry import write_obj, write_xyz

Writer = Callable[[Path, TriangleMesh, Provenance], None]
WRITERS: list[tuple[str, Writer]] = [("a.stl", write_stl), ("a.obj", write_obj), ("a.glb", write_mesh_glb)]


def read(path: Path) -> trimesh.Trimesh:
    loaded = trimesh.load(path, process=False)
    mesh = loaded.to_geometry() if isinstance(loaded, trimesh.Scene) else loaded
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh


@pytest.mark.parametrize(("name", "write"), WRITERS)
def test_the_same_triangles_come_back(tmp_path: Path, name: str, write: Writer) -> None:
    mesh = hill()
    write(tmp_path / name, mesh, PROVENANCE)
    found = np.asarray(read(tmp_path / name).triangles)
    expected = mesh.corners_mm()
    if name.endswith(".glb"):
        expected = expected[..., [0, 2, 1]] * [0.001, 0.001, -0.001]
    np.testing.assert_allclose(found, expected, atol=1e-4 if not name.endswith(".glb") else 1e-7)


@pytest.mark.parametrize(("name", "write"), WRITERS)
def test_a_closed_mesh_comes_back_closed_with_its_volume(tmp_path: Path, name: str, write: Writer) -> None:
    write(tmp_path / name, exact_box(), PROVENANCE)
    found = read(tmp_path / name)
    found.merge_vertices(merge_norm=True)
    assert found.is_volume
    assert found.volume == pytest.approx(24_000.0 * (1e-9 if name.endswith(".glb") else 1.0), rel=1e-6)


@pytest.mark.parametrize(("name", "write"), WRITERS)
def test_a_mesh_that_cannot_be_shown_leaves_nothing_behind(tmp_path: Path, name: str, write: Writer) -> None:
    (tmp_path / name).write_bytes(b"earlier")
    for mesh in (
        TriangleMesh(np.zeros((3, 3)), np.zeros((0, 3), int)),
        TriangleMesh(np.full((3, 3), np.nan), np.eye(3, dtype=int)),
    ):
        with pytest.raises(OutputError, match=name):
            write(tmp_path / name, mesh, PROVENANCE)
    assert (tmp_path / name).read_bytes() == b"earlier"
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_colours_and_normals_of_an_obj_come_back(tmp_path: Path) -> None:
    mesh = hill()
    assert mesh.colour is not None
    write_obj(tmp_path / "a.obj", mesh, PROVENANCE)
    found = read(tmp_path / "a.obj")
    assert isinstance(found.visual, trimesh.visual.ColorVisuals)
    np.testing.assert_allclose(found.visual.vertex_colors[:, :3].astype(int), mesh.colour.astype(int), atol=1)
    np.testing.assert_allclose(found.vertex_normals, mesh.vertex_normals(), atol=1e-3)


def test_colours_and_normals_of_a_glb_come_back(tmp_path: Path) -> None:
    mesh = hill()
    assert mesh.colour is not None
    write_mesh_glb(tmp_path / "a.glb", mesh, PROVENANCE)
    scene = trimesh.load(tmp_path / "a.glb", process=False)
    assert isinstance(scene, trimesh.Scene)
    found = scene.geometry["surface"]
    np.testing.assert_allclose(found.vertex_normals, mesh.vertex_normals(), atol=1e-6)
    np.testing.assert_array_equal(found.visual.vertex_attributes["color"][:, :3], mesh.colour)


@pytest.mark.parametrize(("name", "write"), WRITERS)
def test_the_file_says_where_it_came_from(tmp_path: Path, name: str, write: Writer) -> None:
    write(tmp_path / name, exact_box(), PROVENANCE)
    data = (tmp_path / name).read_bytes()
    for word in (b"3f2a9c", b"three objects", b"0.1.0"):
        assert word in data


def test_an_stl_does_not_begin_like_text(tmp_path: Path) -> None:
    write_stl(tmp_path / "a.stl", exact_box(), Provenance("solid", "solid", "solid"))
    assert not (tmp_path / "a.stl").read_bytes().startswith(b"solid")
    assert (tmp_path / "a.stl").stat().st_size == 84 + 50 * 12


def test_an_xyz_comes_back_as_numbers(tmp_path: Path) -> None:
    cloud = random_cloud(700)
    write_xyz(tmp_path / "a.xyz", cloud)
    found = np.loadtxt(tmp_path / "a.xyz")
    np.testing.assert_allclose(found[:, :3], cloud.points_mm, atol=5.1e-5)
    np.testing.assert_array_equal(found[:, 3:], cloud.colour)
    other = trimesh.load(tmp_path / "a.xyz")
    assert isinstance(other, trimesh.PointCloud)
    np.testing.assert_allclose(other.vertices, found[:, :3])


def test_an_empty_cloud_is_no_xyz(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="no points"):
        write_xyz(tmp_path / "a.xyz", PointCloud.empty())
    assert not list(tmp_path.iterdir())
