"""Inspection of a capture that another program rendered, against its true solids; and of a printed part's mesh.

The machine's true rig is used, so that what is wrong is the stripes' doing and the inspection's. Sides are not judged
here: the cloud leaves out what straddles an edge, so that every top face is too small by some tenths of a millimetre,
and the inspection measures what it is given.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from tests.accuracy.rendered_truth import RenderedTruth, Solid, read_truth
from twinline.arrays import BoolArray, FloatArray
from twinline.fusion.cloud import PointCloud
from twinline.fusion.inspection.deviation import deviation_from_mesh
from twinline.fusion.inspection.lengths import step_height
from twinline.fusion.inspection.nearest import MeshSurface
from twinline.fusion.inspection.placing import place_on_mesh
from twinline.fusion.inspection.plane import fit_plane
from twinline.fusion.inspection.prism import fit_prism
from twinline.fusion.inspection.sphere import fit_sphere
from twinline.fusion.mesh_cloud import mesh_of_cloud
from twinline.operations.geometry_file import read_geometry
from twinline.reconstruction.offline import reconstruct
from twinline.recording.capture import open_capture

# Of blocks of 18 and 32 mm whose bed is seen in a ring of 6 mm, dimmed by their shadows.
HEIGHT_MM = 0.03


@pytest.fixture(scope="module")
def truth(shared_data: Callable[[str], Path]) -> RenderedTruth:
    return read_truth(shared_data("rendered_sample"))


@pytest.fixture(scope="module")
def cloud(shared_data: Callable[[str], Path], truth: RenderedTruth) -> PointCloud:
    return reconstruct(open_capture(shared_data("rendered_sample")), truth.rig).cloud


@pytest.fixture(scope="module")
def points(cloud: PointCloud) -> FloatArray:
    return cloud.points_mm.astype(np.float64)


def around(points: FloatArray, solid: Solid, radius_mm: float) -> BoolArray:
    return np.asarray(np.hypot(*(points[:, :2] - solid.centre[:2]).T) < radius_mm)


def solid_of(truth: RenderedTruth, kind: str, number: int = 0) -> Solid:
    return [solid for solid in truth.solids if solid.kind == kind][number]


@pytest.mark.parametrize("number", [0, 1])
def test_the_blocks_have_their_heights_and_directions(
    truth: RenderedTruth, cloud: PointCloud, points: FloatArray, number: int
) -> None:
    block = solid_of(truth, "box", number)
    region = around(points, block, float(np.hypot(*block.half[:2])) + 6.0)
    found = fit_prism(points[region], cloud.sigma_mm[region])
    assert found.height.value == pytest.approx(2 * block.half[2], abs=HEIGHT_MM)
    longer = np.degrees(block.yaw_rad) + (90.0 if block.half[1] > block.half[0] else 0.0)
    assert (found.angle_deg - longer + 90.0) % 180.0 - 90.0 == pytest.approx(0.0, abs=0.5)


def test_the_cylinder_stands_its_height_above_the_bed_around_it(truth: RenderedTruth, points: FloatArray) -> None:
    cylinder = solid_of(truth, "cylinder")
    top = around(points, cylinder, cylinder.half[0] - 2.0) & (points[:, 2] > 20.0)
    bed = around(points, cylinder, 26.0) & ~around(points, cylinder, 18.0) & (points[:, 2] < 1.0)
    found = step_height(points[bed], points[top])
    # The top's texture shifts all of its stripes a little, which no scatter on it shows.
    assert found.height.value == pytest.approx(2 * cylinder.half[2], abs=0.03)
    assert found.parallel_deg < 0.2


def test_the_ball_has_its_place_and_its_size(truth: RenderedTruth, points: FloatArray) -> None:
    ball = solid_of(truth, "sphere")
    found = fit_sphere(points[around(points, ball, 15.0) & (points[:, 2] > 20.0)])
    np.testing.assert_allclose(found.centre_mm, ball.centre, atol=0.12)
    # 0.5 % of the size: stripes on its slopes are pulled inwards by some hundredths of a millimetre.
    assert found.diameter.value == pytest.approx(2 * ball.half[0], abs=0.25)
    assert found.rms_mm < 0.1


def test_the_bed_is_flat_and_where_it_should_be(points: FloatArray) -> None:
    bed = (points[:, 2] < 1.0) & (np.abs(points[:, 0]) < 50.0) & (np.abs(points[:, 1]) < 80.0)
    found = fit_plane(points[bed])
    assert found.distance(np.zeros(3)).value == pytest.approx(0.0, abs=0.01)
    assert found.tilt.value < 0.02
    assert found.rms_mm < 0.1


class TestPrintedPart:
    """A printer's test part of 75 x 70 x 92 mm, sampled by trimesh as a scan from above would show it."""

    NOISE_MM = 0.04

    def test_a_scan_turned_by_131_degrees_is_laid_on_it(self, shared_data: Callable[[str], Path]) -> None:
        mesh_file = shared_data("meshes") / "ksr_fdmtest_v4.stl"
        other = trimesh.load_mesh(mesh_file)
        points, face = trimesh.sample.sample_surface(other, 20_000, seed=1)
        normals = other.face_normals[face]
        seen = normals[:, 2] > 0.05
        noise = np.random.default_rng(1).normal(0.0, self.NOISE_MM, (int(seen.sum()), 1))
        true_points = points[seen] + noise * normals[seen]
        turn = Rotation.from_euler("zyx", [131.0, 2.0, -1.0], degrees=True)
        scan = turn.apply(true_points) + np.array([200.0, -40.0, 10.0])
        mesh = read_geometry(mesh_file).mesh
        assert mesh is not None
        surface = MeshSurface(mesh)
        placed = place_on_mesh(scan, surface)
        assert placed.held == ()
        # Seen from above hardly anything holds the part sideways, and the alignment says by how much it may be off.
        apart = placed.motion.apply(scan) - true_points
        assert float(np.sqrt(np.mean(apart**2))) < 3.0 * placed.sigma_mm < self.NOISE_MM
        found = deviation_from_mesh(scan, surface, motion=placed.motion, alignment_sigma_mm=placed.sigma_mm)
        assert found.rms_mm == pytest.approx(self.NOISE_MM, rel=0.03)
        assert found.mean_mm == pytest.approx(0.0, abs=0.002)

    @pytest.mark.parametrize(
        ("name", "volume"), [("trimesh_20mm-xyz-cube.stl", 7938.68), ("ksr_fdmtest_v4.stl", 51_011.0)]
    )
    def test_stated_volumes_are_found(self, shared_data: Callable[[str], Path], name: str, volume: float) -> None:
        mesh = read_geometry(shared_data("meshes") / name).mesh
        assert mesh is not None
        assert mesh.volume_mm3() == pytest.approx(volume, rel=1e-4)


def test_the_mesh_is_no_further_from_the_truth_than_its_cloud(
    truth: RenderedTruth, cloud: PointCloud, points: FloatArray
) -> None:
    near = (np.abs(points[:, 0]) < 55.0) & (np.abs(points[:, 1]) < 90.0)
    mesh = mesh_of_cloud(cloud.select(near), 0.5)
    assert truth.score(mesh.vertices_mm).rms_mm <= 1.1 * truth.score(points).rms_mm
    # Frames lie 1 mm apart; the mesh of half that closes the gaps between them: two triangles a cell of the area.
    assert len(mesh.faces) > 0.85 * 2 * (110.0 / 0.5) * (180.0 / 0.5)
    # Also between its corners, where a triangle over an edge would leave the surface.
    middles = mesh.corners_mm().mean(axis=1)
    assert truth.score(middles).rms_mm <= 1.1 * truth.score(points).rms_mm
