import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.unit.operations.exports.sample_clouds import PROVENANCE, random_cloud
from twinline.errors import OutputError
from twinline.fusion.cloud import PointCloud
from twinline.operations.exports.glb import write_glb


def document_of(path: Path) -> dict[str, object]:
    data = path.read_bytes()
    magic, version, total, length, kind = struct.unpack_from("<4sII I4s", data)
    assert (magic, version, total, kind) == (b"glTF", 2, len(data), b"JSON")
    assert length % 4 == 0
    document = json.loads(data[20 : 20 + length])
    body, kind = struct.unpack_from("<I4s", data, 20 + length)
    assert (body, kind) == (len(data) - 28 - length, b"BIN\0")
    assert document["buffers"] == [{"byteLength": body}]
    assert isinstance(document, dict)
    return document


@pytest.mark.parametrize("normals", [False, True])
def test_points_are_metres_with_y_up(tmp_path: Path, normals: bool) -> None:
    cloud = random_cloud(500, normals=normals)
    write_glb(tmp_path / "cloud.glb", cloud, PROVENANCE)
    scene = trimesh.load(tmp_path / "cloud.glb")
    assert isinstance(scene, trimesh.Scene)
    read = scene.to_geometry()
    assert isinstance(read, trimesh.PointCloud)
    x, y, z = cloud.points_mm.T / 1000.0
    np.testing.assert_allclose(read.vertices, np.column_stack([x, z, -y]), atol=1e-7)
    np.testing.assert_array_equal(read.colors[:, :3], cloud.colour)


def test_the_file_says_where_it_came_from(tmp_path: Path) -> None:
    write_glb(tmp_path / "cloud.glb", random_cloud(3), PROVENANCE)
    asset = document_of(tmp_path / "cloud.glb")["asset"]
    assert isinstance(asset, dict)
    assert asset["version"] == "2.0"
    expected = {"units": "m", "rig_id": "3f2a9c", "recording_id": "three objects", "software_version": "0.1.0"}
    assert expected.items() <= asset["extras"].items()


def test_normals_are_there_if_the_cloud_has_them(tmp_path: Path) -> None:
    for normals in (False, True):
        write_glb(tmp_path / "cloud.glb", random_cloud(3, normals=normals), PROVENANCE)
        assert ('"NORMAL"' in json.dumps(document_of(tmp_path / "cloud.glb"))) is normals


def test_positions_state_their_bounds(tmp_path: Path) -> None:
    cloud = random_cloud(50)
    write_glb(tmp_path / "cloud.glb", cloud, PROVENANCE)
    accessors = document_of(tmp_path / "cloud.glb")["accessors"]
    assert isinstance(accessors, list)
    np.testing.assert_allclose(accessors[0]["min"], cloud.points_mm.min(axis=0) / 1000.0, rtol=1e-6)
    np.testing.assert_allclose(accessors[0]["max"], cloud.points_mm.max(axis=0) / 1000.0, rtol=1e-6)


def test_an_empty_cloud_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"cloud\.glb cannot be written: the cloud has no points"):
        write_glb(tmp_path / "cloud.glb", PointCloud.empty(), PROVENANCE)
    assert not list(tmp_path.iterdir())


def test_points_that_are_not_finite_are_an_error(tmp_path: Path) -> None:
    cloud = random_cloud(3)
    cloud.points_mm[1, 2] = np.nan
    with pytest.raises(OutputError, match="not finite"):
        write_glb(tmp_path / "cloud.glb", cloud, PROVENANCE)
