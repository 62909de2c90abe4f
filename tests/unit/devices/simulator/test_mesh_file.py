"""Mesh files: every format, its unit and its colours, and one sentence for what cannot be used."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from twinline.devices.simulator.mesh_file import read_mesh
from twinline.devices.simulator.scenes import named_scene
from twinline.errors import NotFoundError, SettingsError, TwinlineError


def saved(path: Path, *, scale: float = 1.0, size: tuple[float, float, float] = (30.0, 20.0, 10.0)) -> Path:
    mesh = trimesh.creation.box(size)
    mesh.apply_scale(scale)
    mesh.export(path)
    return path


@pytest.mark.parametrize(("ending", "scale"), [("stl", 1.0), ("ply", 1.0), ("obj", 1.0), ("off", 1.0), ("glb", 0.001)])
def test_a_mesh_of_each_format_lies_on_the_bed_in_millimetres(tmp_path: Path, ending: str, scale: float) -> None:
    scene = named_scene(str(saved(tmp_path / f"part.{ending}", scale=scale)))
    assert scene.name == "part"
    np.testing.assert_allclose(scene.things[0].mesh.bounds, [[-15.0, -10.0, 0.0], [15.0, 10.0, 10.0]], atol=1e-4)


def test_an_ending_in_capitals_is_as_good(tmp_path: Path) -> None:
    saved(tmp_path / "part.stl").rename(tmp_path / "PART.STL")
    assert len(named_scene(str(tmp_path / "PART.STL")).things) == 1


def test_colours_of_vertices_become_albedo_in_the_order_blue_green_red(tmp_path: Path) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=15.0)
    mesh.visual.vertex_colors = np.tile(np.array([255, 128, 0, 255], dtype=np.uint8), (len(mesh.vertices), 1))
    mesh.export(tmp_path / "ball.ply")
    _, colours = read_mesh(tmp_path / "ball.ply")
    assert colours is not None
    np.testing.assert_allclose(colours[0], [0.02, 0.9 * (128 / 255) ** 2.2, 0.9], rtol=1e-6)
    _, none = read_mesh(saved(tmp_path / "plain.stl"))
    assert none is None


def bad_files(folder: Path) -> dict[str, Path]:
    (folder / "empty.stl").write_bytes(b"")
    (folder / "noise.ply").write_bytes(b"ply\nformat nonsense\n")
    (folder / "half.glb").write_bytes(saved(folder / "whole.glb").read_bytes()[:100])
    (folder / "words.obj").write_text("these are not the vertices\n")
    (folder / "folder.stl").mkdir()
    return {
        "empty": folder / "empty.stl",
        "noise": folder / "noise.ply",
        "truncated": folder / "half.glb",
        "words": folder / "words.obj",
        "folder": folder / "folder.stl",
        "missing": folder / "missing.stl",
        "giant": saved(folder / "giant.stl", scale=100.0),
        "tall": saved(folder / "tall.stl", size=(10.0, 10.0, 300.0)),
        "speck": saved(folder / "speck.stl", scale=0.001),
        "not a mesh": folder / "picture.png",
    }


@pytest.mark.parametrize(
    ("case", "error", "words"),
    [
        ("empty", SettingsError, "empty.stl"),
        ("noise", SettingsError, "noise.ply"),
        ("truncated", SettingsError, "half.glb"),
        ("words", SettingsError, "words.obj"),
        ("folder", NotFoundError, "folder.stl"),
        ("missing", NotFoundError, "no mesh file"),
        ("giant", SettingsError, "3000 x 2000 x 1000 mm"),
        ("tall", SettingsError, "250 mm high"),
        ("speck", SettingsError, "scale it to millimetres"),
        ("not a mesh", SettingsError, "ending in .stl"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_sentence_that_names_it(
    tmp_path: Path, case: str, error: type[TwinlineError], words: str
) -> None:
    with pytest.raises(error, match=words) as caught:
        read_mesh(bad_files(tmp_path)[case])
    assert "\n" not in caught.value.detail
    assert caught.value.detail.count(". ") == 0
