from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.unit.operations.exports.sample_clouds import PROVENANCE, random_cloud
from tests.unit.operations.exports.sample_meshes import exact_box, hill
from twinline.errors import InputError
from twinline.fusion.mesh import wholeness
from twinline.operations.exports.glb_mesh import write_mesh_glb
from twinline.operations.exports.ply import write_ply
from twinline.operations.exports.stl import write_stl
from twinline.operations.exports.text_geometry import write_obj
from twinline.operations.geometry_file import read_geometry


@pytest.mark.parametrize("normals", [False, True])
def test_an_own_cloud_comes_with_its_sigma(tmp_path: Path, normals: bool) -> None:
    cloud = random_cloud(300, normals=normals)
    write_ply(tmp_path / "a.ply", cloud, PROVENANCE)
    found = read_geometry(tmp_path / "a.ply")
    np.testing.assert_array_equal(found.points, cloud.points_mm)
    np.testing.assert_array_equal(found.sigma_mm, cloud.sigma_mm)
    assert (found.mesh, found.unit) == (None, "mm")


def test_an_own_cloud_as_text_is_read_too(tmp_path: Path) -> None:
    cloud = random_cloud(300)
    write_ply(tmp_path / "a.ply", cloud, PROVENANCE, ascii=True)
    np.testing.assert_allclose(read_geometry(tmp_path / "a.ply").points, cloud.points_mm, rtol=1e-6)


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".glb", ".ply", ".off"])
def test_meshes_of_every_kind_come_back_closed_and_in_millimetres(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    writers = {".stl": write_stl, ".obj": write_obj, ".glb": write_mesh_glb}
    if suffix in writers:
        writers[suffix](path, exact_box(), PROVENANCE)
    else:
        trimesh.Trimesh(exact_box().vertices_mm, exact_box().faces).export(path)
    found = read_geometry(path)
    assert found.mesh is not None
    assert wholeness(found.mesh).watertight
    assert found.mesh.volume_mm3() == pytest.approx(24_000.0, rel=1e-6)
    np.testing.assert_allclose(found.points.max(axis=0), [40.0, 30.0, 20.0], atol=1e-4)
    assert found.unit == ("mm" if suffix == ".glb" else None)


def test_text_may_have_a_header_commas_and_unmeasured_points(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x,y,z,sigma\n# a remark\n1,2,3,0.1\n\n4,5,nan,0.1\n6;7;8\n")
    np.testing.assert_array_equal(read_geometry(tmp_path / "a.csv").points, [[1, 2, 3], [4, 5, np.nan], [6, 7, 8]])


def cut_stl(path: Path) -> None:
    write_stl(path, hill(), PROVENANCE)
    path.write_bytes(path.read_bytes()[:-120])


def cut_text_stl(path: Path) -> None:
    trimesh.Trimesh(exact_box().vertices_mm, exact_box().faces).export(path, file_type="stl_ascii")
    path.write_bytes(path.read_bytes()[:-90])


def cut_glb(path: Path) -> None:
    write_mesh_glb(path, hill(), PROVENANCE)
    path.write_bytes(path.read_bytes()[:-3000])


def cut_ply(path: Path) -> None:
    write_ply(path, random_cloud(300), PROVENANCE)
    path.write_bytes(path.read_bytes()[:-100])


@pytest.mark.parametrize(
    ("name", "make", "words"),
    [
        ("a.stl", cut_stl, "cut off: it announces 4536 triangles and holds 4533"),
        ("a.stl", cut_text_stl, "no endsolid"),
        ("a.stl", lambda path: path.write_bytes(b"x" * 30), "30 bytes are no STL"),
        ("a.glb", cut_glb, "cannot be read as GLB"),
        ("a.ply", cut_ply, "ends after 295 of 300 points"),
        ("a.obj", lambda path: path.write_bytes(b"# nothing\n"), "a.obj"),
        ("a.xyz", lambda path: path.write_bytes(b""), "is empty"),
        ("a.xyz", lambda path: path.write_text("to be\nor not\nto be\n" * 9), "0 lines of x y z and 27 others"),
        ("a.step", lambda path: path.write_text("x"), "no known kind"),
        ("a.stl", lambda path: None, "no such file"),
    ],
)
def test_a_broken_file_is_refused_in_a_sentence_that_names_it(
    tmp_path: Path, name: str, make: Callable[[Path], None], words: str
) -> None:
    make(tmp_path / name)
    with pytest.raises(InputError, match=words) as caught:
        read_geometry(tmp_path / name)
    assert name in caught.value.detail
    assert "\n" not in caught.value.detail
    assert caught.value.detail.endswith(".")
