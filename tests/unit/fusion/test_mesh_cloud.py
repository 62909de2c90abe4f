import numpy as np
import pytest

from tests.unit.fusion.inspection.surfaces import block_points
from twinline.errors import InputError
from twinline.fusion.cloud import PointCloud
from twinline.fusion.mesh import wholeness
from twinline.fusion.mesh_cloud import mesh_of_cloud


def block_cloud(noise_mm: float = 0.02) -> PointCloud:
    """A red block of 30 x 20 x 15 mm on a blue bed."""
    points = block_points((30.0, 20.0, 15.0), noise_mm=noise_mm, bed_mm=10.0)
    n = len(points)
    colour = np.where(points[:, 2:] > 7.0, [200, 0, 0], [0, 0, 200]).astype(np.uint8)
    sigma, source = np.full(n, 0.02, np.float32), np.ones(n, np.uint8)
    return PointCloud(points.astype(np.float32), sigma, np.full(n, 90, np.float32), colour, source)


def test_the_surface_is_that_of_the_block_without_bridging_its_edges() -> None:
    mesh = mesh_of_cloud(block_cloud(), 0.4)
    assert wholeness(mesh).manifold
    assert (mesh.face_vectors_mm2()[:, 2] > 0.0).all()
    assert (np.ptp(mesh.corners_mm()[..., 2], axis=1) < 1.0).all()
    top = mesh.vertices_mm[:, 2] > 7.0
    # Corners stand at the cells' middles over the block, and carry its colour.
    assert np.abs(mesh.vertices_mm[top, :2]).max(axis=0) == pytest.approx([15.0, 10.0], abs=0.3)
    assert mesh.colour is not None
    assert (mesh.colour[top, 0] == 200).all()
    assert (mesh.colour[~top, 2] == 200).all()


def test_the_mesh_is_no_noisier_than_the_cloud() -> None:
    mesh = mesh_of_cloud(block_cloud(noise_mm=0.05), 0.4)
    z = mesh.vertices_mm[:, 2]
    assert np.sqrt(np.mean((z - np.where(z > 7.0, 15.0, 0.0)) ** 2)) < 0.05


def test_the_solid_is_closed_and_has_the_volume_of_block_and_base() -> None:
    mesh = mesh_of_cloud(block_cloud(), 0.4, solid=True, floor_mm=-2.0)
    assert wholeness(mesh).watertight
    extent = np.ptp(mesh.vertices_mm, axis=0)
    assert mesh.volume_mm3() == pytest.approx(30 * 20 * 15 + extent[0] * extent[1] * 2.0, rel=0.03)


def test_a_cloud_without_points_makes_no_mesh() -> None:
    with pytest.raises(InputError, match="has no points"):
        mesh_of_cloud(PointCloud.empty(), 0.4)
