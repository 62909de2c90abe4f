"""A recording on the server's shelf of captures."""

from pathlib import Path

from tests.unit.operations.fakes import FakeClock
from tests.unit.recording.recorded_passes import write_recording
from twinline.geometry.rig_json import rig_to_json
from twinline.operations.captures import CaptureShelf
from twinline.recording.capture import open_capture
from twinline.recording.rig_file import read_rig


def test_a_recording_is_used_in_place_like_a_folder_and_found_again(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "laser.mcap", 6)
    rig = rig_to_json(open_capture(path).rig())
    other = write_recording(tmp_path / "with-rig.mcap", 3, rig=rig)
    shelf = CaptureShelf(tmp_path / "shelf", FakeClock(), open_capture, read_rig)
    plain, calibrated = shelf.add_folder(path), shelf.add_folder(other)
    assert (plain.path, plain.laser_frames, plain.has_rig) == (path, 6, False)
    assert (calibrated.laser_frames, calibrated.has_rig) == (3, True)
    again = CaptureShelf(tmp_path / "shelf", FakeClock(), open_capture, read_rig)
    again.restore()
    assert {record.path for record in again.records()} == {path, other}
    again.delete(plain.id)
    assert path.exists()
