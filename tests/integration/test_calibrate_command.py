"""``twinline calibrate`` on a small simulated capture, and on captures from which nothing can be calibrated."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.accuracy.calibration_cases import IMAGE_SIZE
from tests.accuracy.calibration_parts import TrueTof, misaligned_rig, whole_capture
from tests.unit.calibration.board_pictures import picture, pose
from twinline.calibration.board import Board
from twinline.cli.calibrate import CalibrateRequest, run_calibrate
from twinline.errors import CalibrationError, OutputError, TwinlineError
from twinline.recording.capture import open_capture
from twinline.recording.rig_file import read_rig, write_rig


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole") / "capture"
    machine = misaligned_rig(6).cropped(IMAGE_SIZE)
    whole_capture(folder, "three-objects", machine, seed=6, pitch_mm=2.0, tof=TrueTof())
    (folder / "rig.json").rename(folder.parent / "true.json")
    return folder


@pytest.fixture
def capture(whole: Path, tmp_path: Path) -> Path:
    """A copy to spoil."""
    return Path(shutil.copytree(whole, tmp_path / "capture"))


def calibrate(capture: Path, output: Path, *only: str, start: Path | None = None) -> None:
    run_calibrate(CalibrateRequest(capture, output, frozenset(only), start, json=True))


class TestCalibrate:
    def test_a_rig_is_written_with_its_sources_covariance_noise_and_evidence(
        self, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        output = tmp_path / "rig.json"
        calibrate(whole, output)
        rig = read_rig(output)
        summary = json.loads(capsys.readouterr().out)
        assert summary["output"] == str(output)
        assert set(rig.sources) >= {"camera", "travel", "sheets", "tof"}
        assert all(source.startswith("calibrated") for source in rig.sources.values())
        assert rig.covariance is not None
        assert rig.covariance.sd("sheet1.b") > 0
        assert rig.noise is not None
        assert 0.5 < rig.noise.read_dn < 5
        kept = rig.evidence["calibration"]
        assert isinstance(kept, dict)
        assert kept["verdict"] == summary["evidence"]["verdict"]
        assert kept["method"] == "joint"
        true = read_rig(whole.parent / "true.json")
        for found, sheet in zip(rig.sheets, true.sheets, strict=True):
            assert np.degrees(np.arccos(min(float(found.normal @ sheet.normal), 1.0))) < 0.1

    def test_only_some_parts_are_calibrated_and_the_others_stay(self, whole: Path, tmp_path: Path) -> None:
        output = tmp_path / "rig.json"
        nominal = open_capture(whole).rig()
        write_rig(output, nominal)
        calibrate(whole, output, "camera", "travel")
        rig = read_rig(output)
        np.testing.assert_array_equal(
            [sheet.normal for sheet in rig.sheets], [sheet.normal for sheet in nominal.sheets]
        )
        assert rig.sources["sheets"] == "nominal"
        assert rig.camera.fx != nominal.camera.fx
        first = read_rig(output)
        calibrate(whole, output, "sheets", "tof")
        second = read_rig(output)
        np.testing.assert_array_equal(second.camera.matrix, first.camera.matrix)
        assert second.sources["sheets"] == "calibrated jointly"

    def test_the_human_summary_names_sheets_travel_and_verdict(
        self, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        run_calibrate(CalibrateRequest(whole, tmp_path / "rig.json", frozenset({"camera", "travel"})))
        out = capsys.readouterr().out
        assert "laser 1: baseline" in out
        assert "travel:" in out


def few(folder: Path) -> None:
    for path in sorted(folder.iterdir())[2:]:
        path.unlink()


def alike(folder: Path) -> None:
    first, *others = sorted(folder.iterdir())
    for path in others:
        shutil.copyfile(first, path)


def out_of_focus(folder: Path) -> None:
    for path in folder.iterdir():
        cv2.imwrite(str(path), cv2.GaussianBlur(cv2.imread(str(path)), (0, 0), 9.0))  # type: ignore[arg-type]


def of_two_sizes(folder: Path) -> None:
    path = folder / "03.png"
    cv2.imwrite(str(path), cv2.resize(cv2.imread(str(path)), (800, 500)))  # type: ignore[arg-type]


def of_another_board(folder: Path) -> None:
    describe(folder.parent, {"kind": "chessboard", "columns": 8, "rows": 6, "square_mm": 12.0})


def mirrored(folder: Path) -> None:
    board = Board("charuco", 8, 5, 14.0, 0.0, "DICT_4X4_100", 10.0)
    fields = {"kind": "charuco", "columns": 8, "rows": 5, "square_mm": 14.0, "dictionary": "DICT_4X4_100"}
    describe(folder.parent, {**fields, "marker_mm": 10.0})
    for number, path in enumerate(sorted(folder.iterdir())):
        turn = (20.0 * np.cos(number), 20.0 * np.sin(number), 5.0 * number)
        image = picture(board, pose(board, turn, (0.0, 0.0, 380.0)), size=IMAGE_SIZE, seed=number)
        cv2.imwrite(str(path), image[:, ::-1])


def describe(capture: Path, board: dict[str, object]) -> None:
    path = capture / "capture.json"
    description = json.loads(path.read_text(encoding="utf-8"))
    description["board"] = board
    path.write_text(json.dumps(description), encoding="utf-8")


class TestBadInput:
    def check(self, capture: Path, match: str, *only: str) -> TwinlineError:
        """The error, and that the rig of before is still there, untouched."""
        output = capture.parent / "rig.json"
        write_rig(output, open_capture(capture).rig())
        before = output.read_bytes()
        with pytest.raises(TwinlineError, match=match) as caught:
            calibrate(capture, output, *only)
        assert output.read_bytes() == before
        assert not list(capture.parent.glob(".*.part*"))
        return caught.value

    @pytest.mark.parametrize(
        ("spoil", "code", "words"),
        [
            (few, "too-few-views", "2"),
            (alike, "views-alike", "Move and tilt"),
            (out_of_focus, "blurred-views", "focus"),
            (of_two_sizes, "mixed-image-sizes", "03.png is 800 x 500 px"),
            (of_another_board, "wrong-board", "9 x 6 inner corners are seen, not 8 x 6"),
            (mirrored, "mirrored-board", "flip"),
        ],
    )
    def test_board_views_that_tell_no_camera(
        self, capture: Path, spoil: Callable[[Path], None], code: str, words: str
    ) -> None:
        spoil(capture / "camera")
        assert self.check(capture, words, "camera").code == code

    def test_saturated_stripes(self, capture: Path) -> None:
        off = cv2.imread(str(capture / "laser" / "off.jpg"))
        assert off is not None
        for path in (capture / "laser").glob("0*.jpg"):
            light = cv2.subtract(cv2.imread(str(path)), off)  # type: ignore[arg-type]
            cv2.imwrite(str(path), cv2.addWeighted(off, 1.0, light, 30.0, 0.0))
        self.check(capture, "shorten the exposure", "sheets")

    def test_travel_of_zero_length(self, capture: Path) -> None:
        path = capture / "motion" / "frames.csv"
        lines = path.read_text(encoding="utf-8").splitlines()
        path.write_text("\n".join([lines[0], *(line.split(",")[0] + ",100" for line in lines[1:])]), encoding="utf-8")
        assert self.check(capture, "span 0 mm", "camera", "travel").code == "no-travel"

    def test_a_laser_pass_that_stands_still(self, capture: Path) -> None:
        path = capture / "laser" / "frames.csv"
        lines = path.read_text(encoding="utf-8").splitlines()
        rows = [line.split(",") for line in lines[1:]]
        path.write_text("\n".join([lines[0], *(f"{r[0]},{r[1]},5.0" for r in rows)]), encoding="utf-8")
        assert self.check(capture, "has no length", "sheets").code == "no-travel"

    def test_a_tof_raster_beside_the_laser_pass(self, capture: Path) -> None:
        path = capture / "tof" / "samples.csv"
        lines = path.read_text(encoding="utf-8").splitlines()
        rows = [line.split(",") for line in lines[1:]]
        path.write_text(
            "\n".join([lines[0], *(f"{r[0]},{float(r[1]) + 900:.4f},{r[2]},{r[3]}" for r in rows)]), encoding="utf-8"
        )
        assert self.check(capture, "nothing in common").code == "no-overlap"

    def test_nothing_to_calibrate_from(self, capture: Path) -> None:
        for part in ("camera", "motion", "laser", "tof"):
            shutil.rmtree(capture / part)
        assert self.check(capture, "add camera/").code == "nothing-to-calibrate"

    def test_a_tof_pass_without_a_laser_pass(self, capture: Path) -> None:
        shutil.rmtree(capture / "laser")
        assert self.check(capture, "no laser pass", "tof").code == "no-overlap"

    def test_a_board_nobody_described(self, capture: Path) -> None:
        path = capture / "capture.json"
        description = json.loads(path.read_text(encoding="utf-8"))
        del description["board"]
        path.write_text(json.dumps(description), encoding="utf-8")
        assert self.check(capture, "no field board", "camera").code == "bad-board"

    def test_pictures_without_a_stripe(self, capture: Path) -> None:
        off = (capture / "laser" / "off.jpg").read_bytes()
        for path in (capture / "laser").glob("0*.jpg"):
            path.write_bytes(off)
        self.check(capture, "laser", "sheets")

    def test_a_part_that_does_not_exist(self, capture: Path) -> None:
        assert self.check(capture, "choose from camera, travel, sheets, tof", "lens").code == "bad-parts"

    def test_a_pass_of_which_no_frame_agrees_with_the_next(self, capture: Path) -> None:
        frames = sorted((capture / "laser").glob("0*.jpg"))
        pictures = [path.read_bytes() for path in frames]
        off = (capture / "laser" / "off.jpg").read_bytes()
        for number, path in enumerate(frames):
            path.write_bytes(pictures[number] if number % 2 else off)
        # By chance some of the pieces fit together; then the contradictions refuse it.
        assert self.check(capture, "No stripe of", "sheets").code in ("no-stripe", "calibration-refused")

    def test_a_rig_of_another_camera_to_start_from(self, capture: Path, tmp_path: Path) -> None:
        write_rig(tmp_path / "other.json", open_capture(capture).rig())
        text = json.loads((tmp_path / "other.json").read_text(encoding="utf-8"))
        text["camera"]["size_px"] = [640, 480]
        (tmp_path / "other.json").write_text(json.dumps(text), encoding="utf-8")
        with pytest.raises(CalibrationError, match="640 x 480 px"):
            calibrate(capture, tmp_path / "rig.json", start=tmp_path / "other.json")

    def test_an_output_that_is_no_rig_file(self, capture: Path, tmp_path: Path) -> None:
        with pytest.raises(OutputError, match=r"\.json"):
            calibrate(capture, tmp_path / "rig.txt")
