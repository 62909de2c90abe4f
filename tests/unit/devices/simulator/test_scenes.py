"""Built-in scenes are what their dimensions say."""

import numpy as np
import pytest
import trimesh

from twinline.devices.simulator.relief import SLAB_MM, relief_height_mm, relief_mesh
from twinline.devices.simulator.scenes import box, mesh_scene, named_scene
from twinline.devices.simulator.world import Material, build_world
from twinline.errors import NotFoundError, SettingsError


@pytest.mark.parametrize("name", ["three-objects", "five-pieces", "steps", "sphere", "relief", "board"])
def test_things_stand_on_the_bed_and_look_outwards(name: str) -> None:
    for thing in named_scene(name).things:
        assert thing.mesh.bounds[0][2] == pytest.approx(0.0, abs=1e-9)
        up = thing.mesh.face_normals[thing.mesh.triangles_center[:, 2].argmax()]
        assert up[2] > 0.5


def test_the_prism_is_the_one_of_the_thesis() -> None:
    prism = named_scene("three-objects").things[0]
    assert prism.mesh.volume == pytest.approx(25.4 * 24.2 * 19.35, rel=1e-9)


def test_a_moved_scene_moves_meshes_dimensions_and_span() -> None:
    here, there = named_scene("sphere"), named_scene("sphere").moved(70.0, -3.0)
    np.testing.assert_allclose(
        there.things[0].mesh.vertices - here.things[0].mesh.vertices, [[70.0, -3.0, 0.0]] * 10242
    )
    assert there.things[0].dimensions_mm["x"] == 70.0
    assert there.span_mm[0] - here.span_mm[0] == 70.0


def test_the_ceiling_is_never_below_a_surface() -> None:
    scene = named_scene("relief")
    ceiling = build_world(scene.things, scene.bed, seed=0).ceiling
    mesh = scene.things[0].mesh
    points = np.concatenate([mesh.vertices[mesh.referenced_vertices], mesh.triangles_center])
    for shift in ((0.0, 0.0), (7.5, 0.0), (-5.0, 5.5)):
        cells = np.floor((points[:, :2] + shift - ceiling.origin_mm) / ceiling.cell_mm).astype(int)
        assert (ceiling.heights_mm[cells[:, 0], cells[:, 1]] >= points[:, 2]).all()


def test_any_mesh_is_centred_and_stood_on_the_bed() -> None:
    mesh = trimesh.creation.torus(20.0, 5.0)
    mesh.apply_translation((100.0, 50.0, -30.0))
    thing = mesh_scene("ring", mesh).things[0]
    np.testing.assert_allclose(thing.mesh.bounds[0][:2], -thing.mesh.bounds[1][:2], atol=1e-9)
    assert thing.mesh.bounds[0][2] == pytest.approx(0.0, abs=1e-9)
    assert mesh.bounds[0][2] < 0


def test_unknown_scenes_and_empty_meshes_are_refused_by_name() -> None:
    with pytest.raises(NotFoundError, match="three-objects"):
        named_scene("mona lisa")
    with pytest.raises(SettingsError, match="hollow"):
        mesh_scene("hollow", trimesh.Trimesh())


@pytest.mark.parametrize("name", ["three-objects", "five-pieces", "steps", "sphere", "relief", "board"])
def test_things_are_closed_solids_that_do_not_touch_each_other(name: str) -> None:
    things = named_scene(name).things
    for thing in things:
        assert thing.mesh.is_watertight
        assert thing.mesh.volume > 1000.0
    for number, thing in enumerate(things):
        for other in things[:number]:
            # No corner of one, drawn in a little, lies within the other.
            hull = trimesh.convex.convex_hull(thing.mesh.vertices)
            assert not trimesh.convex.convex_hull(other.mesh.vertices).contains(hull.vertices * [1, 1, 0.9]).any()


def test_the_relief_is_as_high_as_its_formula_and_smooth_up_to_its_rim() -> None:
    mesh = relief_mesh()
    top = mesh.vertices[mesh.vertices[:, 2] > SLAB_MM - 0.5]
    np.testing.assert_allclose(top[:, 2], relief_height_mm(top[:, 0], top[:, 1]), atol=1e-12)
    assert 18.0 < mesh.bounds[1][2] < 28.0
    upward = mesh.face_normals[mesh.triangles_center[:, 2] > SLAB_MM]
    # No step: the steepest place between two columns of the grid is a slope of 4 to 1.
    assert upward[:, 2].min() > 1.0 / np.sqrt(17.0)


def test_what_lies_flat_on_the_bed_is_not_among_the_triangles_that_rays_meet() -> None:
    block = box("block", (20.0, 20.0, 10.0), 0.0, 0.0, 0.0, Material())
    world = build_world((block,), Material(), seed=0)
    assert len(world.normals) == 10
    assert (world.normals[:, 2] > -0.5).all()
