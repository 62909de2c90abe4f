"""``twinline import`` and ``twinline export``, and recordings where a capture folder could stand."""

import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from tests.integration.command_line import files_below, require_refusal, twinline
from tests.unit.reconstruction.small_pass import Pass, write_pass, write_video_pass
from tests.unit.recording.recorded_passes import write_recording
from tests.unit.recording.sample_captures import description, write_pictures
from twinline.arrays import ByteArray
from twinline.fusion.cloud import PointCloud
from twinline.reconstruction.offline import reconstruct
from twinline.recording.capture import Capture, open_capture
from twinline.recording.folder_export import export_folder
from twinline.recording.folder_import import import_folder
from twinline.recording.images import read_image
from twinline.recording.recorded_capture import RecordedCapture

GIVEN = Pass().with_frames(40, 3.0)
ALTERNATING = Pass(lit=tuple(frozenset({1 + i % 2}) for i in range(24))).with_frames(24, 3.0)


def cloud_of(capture: Capture) -> PointCloud:
    with ThreadPoolExecutor(1) as one:
        return reconstruct(capture, capture.own_rig() or capture.rig(), executor=one).cloud


def require_same(a: PointCloud, b: PointCloud, but: frozenset[str] = frozenset()) -> None:
    assert len(a) == len(b) > 1000
    for name in PointCloud.__dataclass_fields__.keys() - but:
        assert np.asarray(getattr(a, name)).tobytes() == np.asarray(getattr(b, name)).tobytes(), name


def recorded(path: Path) -> RecordedCapture:
    capture = open_capture(path)
    assert isinstance(capture, RecordedCapture)
    return capture


class TestRoundTrip:
    @pytest.mark.parametrize("given", [GIVEN, ALTERNATING], ids=["both lasers", "alternating lasers"])
    def test_folder_recording_and_folder_give_the_same_points_to_the_last_bit(
        self, tmp_path: Path, given: Pass
    ) -> None:
        folder = write_pass(tmp_path / "folder", given)
        import_folder(folder, tmp_path / "scan.mcap")
        export_folder(recorded(tmp_path / "scan.mcap"), tmp_path / "back")
        import_folder(tmp_path / "back", tmp_path / "again.mcap")
        original = cloud_of(open_capture(folder))
        for copy in ("scan.mcap", "back", "again.mcap"):
            require_same(original, cloud_of(open_capture(tmp_path / copy)))

    def test_a_video_comes_back_as_pictures_with_the_same_points_to_the_last_bit(self, tmp_path: Path) -> None:
        folder = write_video_pass(tmp_path / "folder", GIVEN)
        import_folder(folder, tmp_path / "scan.mcap")
        export_folder(recorded(tmp_path / "scan.mcap"), tmp_path / "back")
        original = cloud_of(open_capture(folder))
        require_same(original, cloud_of(open_capture(tmp_path / "scan.mcap")))
        # Frames of a video are shared out from key frame to key frame, and a point's colour comes from its own share.
        require_same(original, cloud_of(open_capture(tmp_path / "back")), but=frozenset({"colour"}))

    def test_every_part_of_a_capture_folder_comes_back_byte_by_byte(self, tmp_path: Path) -> None:
        folder = tmp_path / "folder"
        for part in ("laser", "reference", "motion"):
            write_pictures(folder / part, 4)
        for part, suffix in (("camera", ".jpg"), ("sheets/on", ".png"), ("sheets/off", ".jpg"), ("heights", ".png")):
            write_pictures(folder / part, 3, suffix)
            (folder / part / "frames.csv").unlink()
        (folder / "motion" / "frames.csv").write_text("frame,cart_mm\n0000.png,0.1\n0001.png,2.5\n0003.png,1e-05\n")
        (folder / "motion" / "0002.png").unlink()
        shutil.copy(folder / "laser" / "0002.png", folder / "laser" / "off.png")
        truncated = folder / "laser" / "0003.png"
        truncated.write_bytes(truncated.read_bytes()[:300])
        (folder / "heights" / "heights.csv").write_text(
            "frame,height_mm,off_frame\n0000.png,0.0,\n0001.png,20.005,0002.png\n"
        )
        (folder / "tof").mkdir()
        (folder / "tof" / "samples.csv").write_text(
            "time_s,cart_mm,slide_mm,volts\n0.1,1,0.3333333333333333,-3.5\n0.2,1,0.4,\n0.3,1,0.5,9.75\n"
        )
        (folder / "capture.json").write_text(json.dumps(description()))
        imported = import_folder(folder, tmp_path / "all.mcap")
        assert (imported.pictures, imported.readings) == (4 + 4 + 3 + 1 + 3 + 6 + 3, 3)
        exported = export_folder(recorded(tmp_path / "all.mcap"), tmp_path / "back")
        assert (exported.pictures, exported.readings, exported.problems) == (24, 3, [])
        assert files_below(tmp_path / "back") == files_below(folder)
        for name in sorted(files_below(folder)):
            if name.endswith((".png", ".jpg", "capture.json")):
                assert (tmp_path / "back" / name).read_bytes() == (folder / name).read_bytes(), name
        self._require_same_capture(open_capture(folder), recorded(tmp_path / "all.mcap"))
        self._require_same_capture(open_capture(folder), open_capture(tmp_path / "back"))

    @staticmethod
    def _require_same_capture(a: Capture, b: Capture) -> None:
        def pixels(capture: Capture) -> list[ByteArray]:
            views = [*capture.views(), *(p for s in capture.sheets() for p in (s.on, s.off))]
            views += [p for h in capture.heights() for p in (h.path, h.off) if p is not None]
            return [read_image(view) for view in views]

        for one, other in zip(pixels(a), pixels(b), strict=True):
            np.testing.assert_array_equal(one, other)
        assert [(h.height_mm, h.path.name) for h in a.heights()] == [(h.height_mm, h.path.name) for h in b.heights()]
        for one_pass, other_pass in ((a.motion(), b.motion()), (a.laser, b.laser), (a.reference, b.reference)):
            assert one_pass is not None
            assert other_pass is not None
            assert [e.cart_mm for e in one_pass.frames] == [e.cart_mm for e in other_pass.frames]
            assert [f.image is None for f in one_pass.read()] == [f.image is None for f in other_pass.read()]
        tof_a, tof_b = a.tof(), b.tof()
        assert tof_a is not None
        assert tof_b is not None
        for name in ("time_s", "cart_mm", "slide_mm", "reading", "distance_mm"):
            np.testing.assert_array_equal(getattr(tof_a, name), getattr(tof_b, name))

    def test_a_pass_of_the_machine_exports_to_what_it_is(self, tmp_path: Path) -> None:
        recording = recorded(write_recording(tmp_path / "laser.mcap", 8))
        export_folder(recording, tmp_path / "folder")
        back = open_capture(tmp_path / "folder")
        assert recording.laser is not None
        assert back.laser is not None
        assert [e.cart_mm for e in back.laser.frames] == [e.cart_mm for e in recording.laser.frames]
        for a, b in zip(back.laser.read(), recording.laser.read(), strict=True):
            assert a.image is not None
            np.testing.assert_array_equal(a.image, b.image)


class TestCommands:
    def test_a_recording_is_reconstructed_in_worker_processes_like_its_folder(self, tmp_path: Path) -> None:
        folder = write_pass(tmp_path / "folder", Pass().with_frames(24, 4.0))
        done = twinline("import", folder, "-o", tmp_path / "scan.mcap")
        assert done.returncode == 0, done.stderr
        assert done.stdout == f"24 pictures and 0 ToF readings: {tmp_path / 'scan.mcap'}\n"
        for source, output in ((folder, "a.ply"), (tmp_path / "scan.mcap", "b.ply")):
            done = twinline("reconstruct", source, "-o", tmp_path / output)
            assert done.returncode == 0, done.stderr
        assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()

    def test_stripes_are_found_in_the_frames_of_a_recording_as_in_the_pictures(self, tmp_path: Path) -> None:
        folder = write_pass(tmp_path / "folder", Pass().with_frames(3, 4.0))
        import_folder(folder, tmp_path / "scan.mcap")
        done = twinline("stripes", *sorted((folder / "laser").glob("*.png")), "-o", tmp_path / "a.csv")
        assert done.returncode == 0, done.stderr
        done = twinline("stripes", tmp_path / "scan.mcap", "-o", tmp_path / "b.csv")
        assert done.returncode == 0, done.stderr

        def rows(name: str) -> list[str]:
            return [row.split(",", 1)[1] for row in (tmp_path / name).read_text().splitlines()]

        assert rows("a.csv") == rows("b.csv")
        assert len(rows("a.csv")) > 100

    def test_a_recording_that_was_cut_off_is_used_with_a_warning_and_repaired_on_request(self, tmp_path: Path) -> None:
        path = write_recording(tmp_path / "cut.mcap", 30)
        path.write_bytes(path.read_bytes()[: path.stat().st_size * 3 // 4])
        done = twinline("export", path, "-o", tmp_path / "folder", "--json")
        assert done.returncode == 0
        summary = json.loads(done.stdout)
        assert 15 <= summary["pictures"] <= 29
        assert "ends at byte" in done.stderr
        done = twinline("import", path, "-o", tmp_path / "whole.mcap")
        assert done.returncode == 0
        assert recorded(tmp_path / "whole.mcap").recordings[0].whole

    def test_what_cannot_be_done_is_said_in_one_sentence_and_leaves_nothing_behind(self, tmp_path: Path) -> None:
        folder = write_pass(tmp_path / "folder", Pass().with_frames(2, 4.0))
        recording = write_recording(tmp_path / "laser.mcap", 3)
        (tmp_path / "full").mkdir()
        (tmp_path / "full" / "file").touch()
        before = files_below(tmp_path)
        require_refusal(twinline("export", folder, "-o", tmp_path / "x"), "is a capture folder already")
        require_refusal(twinline("export", recording, "-o", tmp_path / "full"), "is not an empty folder")
        require_refusal(
            twinline("export", recording, "-o", tmp_path / "no" / "x"), "cannot be written", "make its folder"
        )
        require_refusal(twinline("import", tmp_path / "absent", "-o", tmp_path / "x.mcap"), "does not exist")
        require_refusal(twinline("import", folder, "-o", tmp_path / "no" / "x.mcap"), "cannot be written")
        assert files_below(tmp_path) == before
