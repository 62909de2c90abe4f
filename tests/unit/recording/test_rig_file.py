from collections.abc import Callable
from pathlib import Path

import pytest

from twinline.errors import OutputError, RigError
from twinline.geometry.rig_json import rig_to_json
from twinline.recording.capture import open_capture
from twinline.recording.rig_file import read_rig, write_rig


def test_a_rig_survives_its_file(write_capture: Callable[..., Path], tmp_path: Path) -> None:
    rig = open_capture(write_capture()).rig()
    write_rig(tmp_path / "rig.json", rig)
    assert rig_to_json(read_rig(tmp_path / "rig.json")) == rig_to_json(rig)


def test_a_rig_is_not_half_written(write_capture: Callable[..., Path], tmp_path: Path) -> None:
    rig = open_capture(write_capture()).rig()
    with pytest.raises(OutputError, match=r"absent/rig\.json cannot be written: no such file"):
        write_rig(tmp_path / "absent" / "rig.json", rig)
    assert [p.name for p in tmp_path.iterdir()] == ["capture"]


@pytest.mark.parametrize(("data", "words"), [(b"{}", "format"), (b"\xff", "UTF-8"), (b"{", "JSON")])
def test_a_wrong_file_is_named(tmp_path: Path, data: bytes, words: str) -> None:
    (tmp_path / "rig.json").write_bytes(data)
    with pytest.raises(RigError, match=rf"rig\.json.*{words}"):
        read_rig(tmp_path / "rig.json")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(RigError, match=r"rig\.json cannot be read: No such file"):
        read_rig(tmp_path / "rig.json")
