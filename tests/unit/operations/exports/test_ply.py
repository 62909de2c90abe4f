import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.unit.operations.exports.sample_clouds import PROVENANCE, random_cloud
from twinline.errors import OutputError
from twinline.fusion.cloud import PointCloud
from twinline.operations.exports.ply import write_ply
from twinline.operations.exports.provenance import Provenance

SIZES = {"float": ("f", 4), "uchar": ("B", 1)}


def parse_ply(path: Path) -> tuple[list[str], dict[str, list[float]]]:
    """Header lines and columns of a PLY, read by nothing but the format's own words."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    lines = head.decode("utf-8").splitlines()
    count = next(int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    properties = [line.split()[1:] for line in lines if line.startswith("property")]
    if lines[1] == "format ascii 1.0":
        kinds = [np.float32 if kind == "float" else np.uint8 for kind, _ in properties]
        cells = [line.split() for line in body.decode().splitlines()]
        rows = [[kind(cell).item() for kind, cell in zip(kinds, row, strict=True)] for row in cells]
    else:
        assert lines[1] == "format binary_little_endian 1.0"
        layout = struct.Struct("<" + "".join(SIZES[kind][0] for kind, _ in properties))
        assert len(body) == count * layout.size
        rows = [list(values) for values in layout.iter_unpack(body)]
    assert len(rows) == count
    return lines, {name: [row[i] for row in rows] for i, (_, name) in enumerate(properties)}


def columns_of(cloud: PointCloud) -> dict[str, list[float]]:
    columns = {name: cloud.points_mm[:, i].tolist() for i, name in enumerate("xyz")}
    if cloud.normals is not None:
        columns |= {name: cloud.normals[:, i].tolist() for i, name in enumerate(("nx", "ny", "nz"))}
    columns |= {name: cloud.colour[:, i].tolist() for i, name in enumerate(("red", "green", "blue"))}
    return columns | {
        "source": cloud.source.tolist(),
        "sigma": cloud.sigma_mm.tolist(),
        "intensity": cloud.intensity.tolist(),
    }


@pytest.mark.parametrize("ascii", [False, True])
@pytest.mark.parametrize("normals", [False, True])
@pytest.mark.parametrize("count", [0, 1, 777])
def test_everything_known_of_each_point_reads_back_exactly(
    tmp_path: Path, count: int, normals: bool, ascii: bool
) -> None:
    cloud = random_cloud(count, normals=normals)
    write_ply(tmp_path / "cloud.ply", cloud, PROVENANCE, ascii=ascii)
    _, columns = parse_ply(tmp_path / "cloud.ply")
    assert columns == columns_of(cloud)
    assert list(columns) == list(columns_of(cloud))


def test_a_cloud_of_several_blocks_is_whole(tmp_path: Path) -> None:
    cloud = random_cloud(300_001)
    write_ply(tmp_path / "cloud.ply", cloud, PROVENANCE)
    read = trimesh.load(tmp_path / "cloud.ply")
    assert isinstance(read, trimesh.PointCloud)
    np.testing.assert_array_equal(read.vertices, cloud.points_mm)


def test_another_program_reads_points_and_colours(tmp_path: Path) -> None:
    cloud = random_cloud(500, normals=True)
    for text in (False, True):
        write_ply(tmp_path / "cloud.ply", cloud, PROVENANCE, ascii=text)
        read = trimesh.load(tmp_path / "cloud.ply")
        assert isinstance(read, trimesh.PointCloud)
        np.testing.assert_array_equal(read.vertices, cloud.points_mm)
        np.testing.assert_array_equal(read.colors[:, :3], cloud.colour)


def test_comments_carry_units_and_provenance(tmp_path: Path) -> None:
    write_ply(tmp_path / "cloud.ply", random_cloud(1), PROVENANCE)
    lines, _ = parse_ply(tmp_path / "cloud.ply")
    for comment in ("units mm", "rig_id 3f2a9c", "recording_id three objects", "software_version 0.1.0"):
        assert f"comment {comment}" in lines
    assert lines[0] == "ply"


def test_a_name_with_line_breaks_cannot_change_the_header(tmp_path: Path) -> None:
    provenance = Provenance("a\nend_header\n", "Prüfstand\r\nelement vertex 9", "1")
    write_ply(tmp_path / "cloud.ply", random_cloud(3), provenance)
    lines, columns = parse_ply(tmp_path / "cloud.ply")
    assert "comment rig_id a end_header " in lines
    assert "comment recording_id Prüfstand  element vertex 9" in lines
    assert len(columns["x"]) == 3


def test_a_folder_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"absent/cloud\.ply cannot be written: no such file"):
        write_ply(tmp_path / "absent" / "cloud.ply", random_cloud(3), PROVENANCE)
