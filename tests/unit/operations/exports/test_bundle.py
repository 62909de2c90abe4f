import json
import zipfile
from pathlib import Path

import pytest

from tests.unit.operations.exports.sample_clouds import PROVENANCE
from twinline.errors import InputError, OutputError
from twinline.operations.exports.bundle import write_zip


@pytest.fixture
def files(tmp_path: Path) -> dict[str, Path]:
    (tmp_path / "cloud.ply").write_bytes(b"ply\n" * 1000)
    (tmp_path / "laser.mcap").write_bytes(bytes(range(256)) * 20)
    return {"cloud.ply": tmp_path / "cloud.ply", "recordings/laser.mcap": tmp_path / "laser.mcap"}


def test_every_file_comes_back_with_a_manifest(tmp_path: Path, files: dict[str, Path]) -> None:
    write_zip(tmp_path / "scan.zip", files, PROVENANCE)
    with zipfile.ZipFile(tmp_path / "scan.zip") as archive:
        assert archive.testzip() is None
        assert archive.read("recordings/laser.mcap") == files["recordings/laser.mcap"].read_bytes()
        assert archive.getinfo("recordings/laser.mcap").compress_type == zipfile.ZIP_STORED
        assert archive.getinfo("cloud.ply").compress_size < 1000
        manifest = json.loads(archive.read("manifest.json"))
    assert manifest["files"] == {"cloud.ply": 4000, "recordings/laser.mcap": 5120}
    assert manifest["rig_id"] == "3f2a9c"


@pytest.mark.parametrize("name", ["/etc/passwd", "../up", "a/../../up", "", "manifest.json", "a\\b"])
def test_names_that_lead_elsewhere_are_refused(tmp_path: Path, files: dict[str, Path], name: str) -> None:
    with pytest.raises(InputError, match="cannot be the name"):
        write_zip(tmp_path / "scan.zip", {name: files["cloud.ply"]}, PROVENANCE)
    assert not (tmp_path / "scan.zip").exists()


def test_a_missing_file_is_named_and_nothing_is_left_behind(tmp_path: Path, files: dict[str, Path]) -> None:
    before = set(tmp_path.iterdir())
    with pytest.raises(InputError, match=r"gone\.ply is not there"):
        write_zip(tmp_path / "scan.zip", {**files, "x": tmp_path / "gone.ply"}, PROVENANCE)
    with pytest.raises(OutputError, match="make its folder"):
        write_zip(tmp_path / "no" / "scan.zip", files, PROVENANCE)
    assert set(tmp_path.iterdir()) == before
