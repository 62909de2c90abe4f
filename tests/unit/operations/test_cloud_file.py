from pathlib import Path

import numpy as np
import pytest

from tests.unit.operations.fakes import some_points
from twinline.errors import InputError
from twinline.fusion.cloud import PointCloud
from twinline.operations.cloud_file import read_cloud
from twinline.operations.exports.ply import write_ply
from twinline.operations.exports.provenance import Provenance

PROVENANCE = Provenance("rig", "recording", "1")


@pytest.mark.parametrize("count", [0, 1, 1000])
def test_what_was_written_is_read_exactly(tmp_path: Path, count: int) -> None:
    cloud = some_points(count)
    write_ply(tmp_path / "cloud.ply", cloud, PROVENANCE)
    back = read_cloud(tmp_path / "cloud.ply")
    for name in ("points_mm", "sigma_mm", "intensity", "colour", "source"):
        np.testing.assert_array_equal(getattr(back, name), getattr(cloud, name))


def test_normals_in_the_file_are_passed_over(tmp_path: Path) -> None:
    plain = some_points(10)
    normals = np.tile(np.array([0, 0, 1], np.float32), (10, 1))
    cloud = PointCloud(plain.points_mm, plain.sigma_mm, plain.intensity, plain.colour, plain.source, normals)
    write_ply(tmp_path / "cloud.ply", cloud, PROVENANCE)
    np.testing.assert_array_equal(read_cloud(tmp_path / "cloud.ply").points_mm, plain.points_mm)


def test_a_file_that_ends_early_says_after_how_many_points(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    write_ply(path, some_points(10), PROVENANCE)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(InputError, match="ends after 9 of 10 points"):
        read_cloud(path)


def test_other_files_are_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    write_ply(path, some_points(3), PROVENANCE, ascii=True)
    for data in (path.read_bytes(), b"", b"\xff" * 5000, b"ply\nend_header\n"):
        path.write_bytes(data)
        with pytest.raises(InputError, match=r"cloud\.ply is not a cloud"):
            read_cloud(path)
    with pytest.raises(InputError, match="cannot be read"):
        read_cloud(tmp_path / "missing.ply")
