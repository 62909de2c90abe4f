"""A scene under a machine: where it lies, what is true of it, and a true mesh that can be taken away."""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from twinline.devices.simulator.machine import SimulatedRig, ideal_rig
from twinline.devices.simulator.tof import FrontEnd, TofSensor, full_scale_front_end
from twinline.devices.simulator.truth import true_rig
from twinline.devices.simulator.workspace import build_workspace
from twinline.errors import NotFoundError, OutputError, SettingsError


def test_a_laser_pass_over_a_placed_scene_begins_where_it_may() -> None:
    here = build_workspace("three-objects", start_mm=25.0)
    first, last = here.laser_pass_mm
    assert first == pytest.approx(25.0)
    assert 60.0 < last - first < 200.0


@pytest.mark.parametrize("name", ["three-objects", "five-pieces", "relief", "steps", "sphere", "board", "bed"])
def test_every_built_in_scene_can_be_photographed_and_measured(name: str) -> None:
    here = build_workspace(name, ideal_rig().cropped((96, 64)))
    middle = sum(here.laser_pass_mm) / 2
    assert here.renderer.render(0, middle).std() > 2.0
    assert 60.0 < here.tof_distance_mm(middle, 100.0) < 140.0


@pytest.mark.parametrize("ending", ["ply", "stl", "obj", "glb"])
def test_the_true_mesh_is_written_in_the_bed_frame(tmp_path: Path, ending: str) -> None:
    here = build_workspace("three-objects")
    path = tmp_path / f"truth.{ending}"
    here.export_mesh(path)
    mesh = trimesh.load_mesh(path)
    scale = 1000.0 if ending == "glb" else 1.0
    np.testing.assert_allclose(np.asarray(mesh.bounds) * scale, here.true_mesh().bounds, atol=1e-3)
    assert mesh.bounds[1][2] * scale == pytest.approx(28.0, abs=0.01)


def test_a_mesh_that_cannot_be_written_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"truth\.txt"):
        build_workspace("sphere").export_mesh(tmp_path / "truth.txt")
    with pytest.raises(SettingsError, match="bare"):
        build_workspace("bed").export_mesh(tmp_path / "truth.ply")
    with pytest.raises(OutputError, match="nowhere"):
        build_workspace("sphere").export_mesh(tmp_path / "nowhere" / "truth.ply")
    with pytest.raises(NotFoundError, match="three-objects"):
        build_workspace("the moon")


def test_the_true_rig_turns_true_pixels_into_true_places() -> None:
    """A point of the bed, its pixel by an explicit pinhole without distortion, and the rig's own ray back to it."""
    straight = replace(SimulatedRig(), lens=replace(SimulatedRig().lens, radial=(0.0, 0.0, 0.0), tangential=(0.0, 0.0)))
    here = build_workspace("sphere", straight)
    rig = here.true_rig()
    point, cart_mm = np.array([70.0, 20.0, 0.0]), 55.0
    in_camera = straight.bed_from_camera.T @ (point - straight.eye_mm(cart_mm))
    back = rig.bed_from_camera.apply(in_camera[np.newaxis])[0] + rig.travel * cart_mm
    np.testing.assert_allclose(back, point, atol=1e-9)
    for sheet, laser in zip(rig.sheets, straight.lasers, strict=True):
        on_sheet = straight.bed_from_camera.T @ laser.source_mm
        assert sheet.normal @ on_sheet == pytest.approx(sheet.offset_mm, abs=1e-9)


@pytest.mark.parametrize("front_end", [FrontEnd(), full_scale_front_end(TofSensor())])
def test_the_true_rig_reads_the_converter_that_it_is_for(front_end: FrontEnd) -> None:
    tof = true_rig("x", SimulatedRig(), front_end).tof
    assert tof is not None
    for distance in (60.0, 101.3, 140.0):
        count = front_end.count_of(distance, TofSensor())
        assert tof.offset_mm + tof.gain_mm_per_unit * count == pytest.approx(distance, abs=1e-9)


def test_a_workspace_goes_to_another_process_and_gives_the_same_picture() -> None:
    here = build_workspace("sphere", ideal_rig().cropped((64, 360)), seed=4)
    there = pickle.loads(pickle.dumps(here))
    np.testing.assert_array_equal(there.renderer.render(3, 20.0), here.renderer.render(3, 20.0))
