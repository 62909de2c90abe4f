import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.unit.recording.sample_captures import description, picture, write_list, write_pictures
from twinline.errors import CaptureError
from twinline.recording.capture import nominal_rig, open_capture
from twinline.recording.capture_json import read_capture_json

WriteCapture = Callable[..., Path]


def add_pictures(folder: Path, *names: str) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        assert cv2.imwrite(str(folder / name), picture(1))


class TestOpening:
    def test_a_description_alone_is_a_capture_with_nothing_in_it(self, write_capture: WriteCapture) -> None:
        capture = open_capture(write_capture(frames=0))
        assert (capture.laser, capture.reference, capture.laser_off) == (None, None, None)
        assert (capture.views(), capture.motion(), capture.sheets(), capture.heights()) == ((), None, (), ())
        assert capture.tof() is None

    def test_its_description_may_be_given_instead_of_the_folder(self, write_capture: WriteCapture) -> None:
        folder = write_capture()
        assert open_capture(folder / "capture.json").path == folder

    def test_every_part_is_found(self, write_capture: WriteCapture) -> None:
        folder = write_capture(frames=5)
        write_pictures(folder / "reference", 3)
        add_pictures(folder / "laser", "off.png")
        add_pictures(folder / "camera", "b.jpg", "a.png")
        (folder / "camera" / "notes.txt").write_text("not a picture")
        capture = open_capture(folder)
        assert capture.info.name == "three objects"
        assert (len(capture.laser or ()), len(capture.reference or ())) == (5, 3)
        assert capture.laser_off == folder / "laser" / "off.png"
        assert [path.name for path in capture.views()] == ["a.png", "b.jpg"]

    def test_a_missing_folder_is_an_error(self, tmp_path: Path) -> None:
        with pytest.raises(CaptureError, match="nowhere does not exist"):
            open_capture(tmp_path / "nowhere")

    def test_an_empty_folder_is_an_error(self, tmp_path: Path) -> None:
        with pytest.raises(CaptureError, match=r"is empty; a capture folder holds capture\.json"):
            open_capture(tmp_path)

    def test_a_folder_without_description_is_an_error(self, tmp_path: Path) -> None:
        write_pictures(tmp_path / "laser", 2)
        with pytest.raises(CaptureError, match=r"capture\.json is missing"):
            open_capture(tmp_path)

    def test_a_file_is_no_capture(self, tmp_path: Path) -> None:
        (tmp_path / "capture.zip").write_bytes(b"PK")
        with pytest.raises(CaptureError, match=r"capture\.zip is neither a recording nor a folder; unpack it"):
            open_capture(tmp_path / "capture.zip")

    def test_an_empty_laser_folder_is_an_error(self, write_capture: WriteCapture) -> None:
        folder = write_capture(frames=0)
        (folder / "laser").mkdir()
        with pytest.raises(CaptureError, match=r"laser/frames\.csv is missing, so the travel is unknown"):
            open_capture(folder)

    def test_two_pictures_with_the_lasers_off_are_an_error(self, write_capture: WriteCapture) -> None:
        folder = write_capture()
        add_pictures(folder / "laser", "off.png", "off.jpg")
        with pytest.raises(CaptureError, match="keep one picture with the lasers off"):
            open_capture(folder)


class TestCalibrationParts:
    def test_the_travel_of_a_lying_board(self, write_capture: WriteCapture) -> None:
        folder = write_capture()
        add_pictures(folder / "motion", "a.png", "b.png")
        (folder / "motion" / "frames.csv").write_text("frame,cart_mm\nb.png,10\na.png,30\n")
        motion = open_capture(folder).motion()
        assert motion is not None
        assert [(f.name, f.cart_mm) for f in motion.frames] == [("b.png", 10.0), ("a.png", 30.0)]

    def test_stripes_on_and_off_are_paired_by_name(self, write_capture: WriteCapture) -> None:
        folder = write_capture()
        add_pictures(folder / "sheets" / "on", "2.png", "1.png")
        add_pictures(folder / "sheets" / "off", "1.jpg", "2.png")
        assert [(p.name, p.on.name, p.off.name) for p in open_capture(folder).sheets()] == [
            ("1", "1.png", "1.jpg"),
            ("2", "2.png", "2.png"),
        ]

    @pytest.mark.parametrize(("alone", "other"), [("on", "off"), ("off", "on")])
    def test_a_picture_without_partner_is_named(self, write_capture: WriteCapture, alone: str, other: str) -> None:
        folder = write_capture()
        add_pictures(folder / "sheets" / alone, "7.png")
        with pytest.raises(CaptureError, match=rf"{alone}/7\.png has no partner of the same name in .*{other}"):
            open_capture(folder).sheets()

    @pytest.mark.parametrize("place", ["heights/heights.csv", "heights.csv"])
    def test_blocks_of_known_height(self, write_capture: WriteCapture, place: str) -> None:
        folder = write_capture()
        add_pictures(folder / "heights", "bed.png", "ten.png", "off.png")
        (folder / place).write_text("frame,height_mm,off_frame\nbed.png,0,\nten.png,10.002,off.png\n")
        heights = open_capture(folder).heights()
        assert [(h.path.name, h.height_mm, h.off and h.off.name) for h in heights] == [
            ("bed.png", 0.0, None),
            ("ten.png", 10.002, "off.png"),
        ]

    @pytest.mark.parametrize(
        ("table", "words"),
        [
            (None, r"heights\.csv is missing, so the heights are unknown"),
            ("frame,height_mm\n", "lists no pictures"),
            ("frame,height_mm\nabsent.png,1\n", r"line 2: absent\.png is not in"),
            ("frame,height_mm\nbed.png,-1\n", "line 2: height_mm must be 0"),
        ],
    )
    def test_wrong_heights_are_an_error(self, write_capture: WriteCapture, table: str | None, words: str) -> None:
        folder = write_capture()
        add_pictures(folder / "heights", "bed.png")
        if table is not None:
            (folder / "heights" / "heights.csv").write_text(table)
        with pytest.raises(CaptureError, match=words):
            open_capture(folder).heights()

    def test_readings_of_a_sensor_that_is_not_described_are_an_error(self, write_capture: WriteCapture) -> None:
        folder = write_capture()
        document = description()
        del document["tof"]
        (folder / "capture.json").write_text(json.dumps(document))
        (folder / "tof").mkdir()
        (folder / "tof" / "samples.csv").write_text("time_s,cart_mm,slide_mm,adc\n0,0,0,5\n")
        with pytest.raises(CaptureError, match=r"samples\.csv exists, but .*capture\.json has no field tof"):
            open_capture(folder).tof()


class TestNominalRig:
    def test_it_holds_what_the_description_says(self, write_capture: WriteCapture) -> None:
        rig = nominal_rig(read_capture_json(write_capture() / "capture.json"))
        assert (rig.name, rig.camera.size, rig.stripe_runs) == ("three objects", (64, 48), "along-u")
        assert [sheet.side for sheet in rig.sheets] == ["+v", "-v"]
        for sheet in rig.sheets:
            assert sheet.baseline_mm == pytest.approx(246.0)
            assert np.degrees(sheet.angle_rad) == pytest.approx(60.0)
        np.testing.assert_allclose(rig.bed_from_camera.translation_mm, [0, 0, 430])

    @pytest.mark.parametrize(("unit", "low", "high"), [("adc", 0, 4095), ("volts", -4, 4), ("distance_mm", 60, 140)])
    def test_its_tof_part_takes_the_readings_as_recorded(
        self, write_capture: WriteCapture, unit: str, low: float, high: float
    ) -> None:
        folder = write_capture()
        (folder / "tof").mkdir()
        (folder / "tof" / "samples.csv").write_text(f"time_s,cart_mm,slide_mm,{unit}\n0,0,0,{low}\n")
        tof = open_capture(folder).rig().tof
        assert tof is not None
        assert tof.offset_mm + tof.gain_mm_per_unit * np.array([low, high]) == pytest.approx([60.0, 140.0])
        np.testing.assert_array_equal(tof.position_mm, [-118.0, 0.0, 139.0])


class TestRealCaptures:
    def test_the_rendered_sample_is_read_whole(self, shared_data: Callable[[str], Path]) -> None:
        capture = open_capture(shared_data("rendered_sample"))
        assert capture.laser is not None
        assert (len(capture.laser), capture.laser.frames[-1].cart_mm) == (215, 214.0)
        capture.laser.check_sizes()
        frames = list(capture.laser.read([0, 100, 214]))
        assert {frame.image.shape for frame in frames if frame.image is not None} == {(720, 1280, 3)}
        assert [frame.problem for frame in frames] == [None] * 3
        motion, tof = capture.motion(), capture.tof()
        assert motion is not None
        assert len(motion) == 7
        assert len(capture.views()) == 18
        assert tof is not None
        assert len(tof) == 66500
        assert np.isfinite(tof.distance_mm).all()
        assert 60 < tof.distance_mm.min() < tof.distance_mm.max() < 140

    def test_real_photographs_of_a_stairs_are_read(self, shared_data: Callable[[str], Path], tmp_path: Path) -> None:
        data = shared_data("linear_stairs")
        lasers = [{"baseline_mm": 37.3, "angle_deg": 65.0, "side": "-u"}]
        changes = {"stripe_runs": "along-v", "image_size": [640, 480], "lasers": lasers, "camera_height_mm": 80.0}
        (tmp_path / "capture.json").write_text(json.dumps(description() | changes))
        for part, source in (("laser", "stairs"), ("reference", "reference")):
            folder = tmp_path / part
            folder.mkdir()
            names = sorted(path.name for path in (data / source).glob("*.jpg"))
            for name in names:
                (folder / name).symlink_to(data / source / name)
            write_list(folder, names)
        capture = open_capture(tmp_path)
        assert capture.laser is not None
        assert capture.reference is not None
        for sequence in (capture.laser, capture.reference):
            sequence.check_sizes()
            assert len(sequence) == 65
            assert all(frame.image is not None for frame in sequence.read())
        assert capture.rig().sheets[0].side == "-u"
