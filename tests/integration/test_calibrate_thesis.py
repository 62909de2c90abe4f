"""``twinline calibrate --method thesis`` on a simulated capture: a rig like any other, with its error stated."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.accuracy.calibration_parts import TrueTof, misaligned_rig, whole_capture
from tests.integration.command_line import files_below, require_refusal, twinline
from twinline.cli.calibrate import CalibrateRequest, run_calibrate
from twinline.errors import CalibrationError, CaptureError, OutputError, TwinlineError
from twinline.reconstruction.offline import reconstruct
from twinline.recording.capture import open_capture
from twinline.recording.rig_file import read_rig, write_rig

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("thesis") / "capture"
    whole_capture(folder, "three-objects", misaligned_rig(6), seed=6, pitch_mm=2.0, tof=TrueTof(), boards=False)
    (folder / "rig.json").rename(folder.parent / "true.json")
    return folder


@pytest.fixture(scope="module")
def rig_path(whole: Path) -> Path:
    path = whole.parent / "thesis.json"
    run_calibrate(CalibrateRequest(whole, path, method="thesis"))
    return path


class TestCommand:
    def test_the_rig_says_how_it_came_about_and_how_wrong_it_is(self, rig_path: Path) -> None:
        rig = read_rig(rig_path)
        assert {"sheets", "tof"} <= {part for part, source in rig.sources.items() if source.startswith("thesis")}
        assert rig.covariance is None
        assert rig.noise is not None
        kept = rig.evidence["calibration"]
        assert isinstance(kept, dict)
        assert kept["method"] == "thesis"
        assert kept["verdict"] == "usable"
        assert "no lens distortion" in kept["reasons"][0]
        for fit, sheet in zip(kept["lasers"], rig.sheets, strict=True):
            assert fit["baseline_mm"] == pytest.approx(sheet.baseline_mm)
            assert fit["angle_deg"] == pytest.approx(np.degrees(sheet.angle_rad))
            assert fit["trace"]["last_value"] == pytest.approx(fit["sum_mm"])
            assert fit["trace"]["iterations"] > 10
        pairs = {entry["pair"]: entry["typical_mm"] for entry in kept["agreement"]}
        assert set(pairs) == {"laser 1 against laser 2", "laser 1 against ToF", "laser 2 against ToF"}
        assert all(0.0 < size < 3.0 for size in pairs.values())

    def test_reconstruct_takes_it_and_the_scan_is_nearer_to_the_truth_than_the_nominal_one(
        self, whole: Path, rig_path: Path
    ) -> None:
        capture = open_capture(whole)
        thesis = reconstruct(capture, read_rig(rig_path)).cloud.points_mm
        nominal = reconstruct(capture, capture.rig()).cloud.points_mm
        # Most of a scan is bed, which is truly at zero; far from the objects, the camera's tilt lifts it.
        errors = [np.median(np.abs(cloud[np.abs(cloud[:, 1]) < 40.0, 2])) for cloud in (thesis, nominal)]
        assert errors[0] < 1.5
        assert errors[0] < 0.2 * errors[1]

    def test_what_it_says_holds_the_runs_and_their_errors(
        self, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        run_calibrate(CalibrateRequest(whole, tmp_path / "rig.json", method="thesis"))
        said = capsys.readouterr()
        assert "laser 1 against ToF: mean difference" in said.out
        assert "iterations" in said.out
        assert "laser 1 against laser 2: typically" in said.out
        assert "Compare with --method joint." in said.err

    def test_the_summary_for_programs_is_the_rigs_evidence(
        self, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        output = tmp_path / "rig.json"
        run_calibrate(CalibrateRequest(whole, output, json=True, method="thesis"))
        summary = json.loads(capsys.readouterr().out)
        assert summary["method"] == "thesis"
        assert summary["evidence"] == read_rig(output).evidence["calibration"]

    def test_an_earlier_rig_can_be_where_it_starts(self, whole: Path, rig_path: Path, tmp_path: Path) -> None:
        output = tmp_path / "again.json"
        run_calibrate(CalibrateRequest(whole, output, start=rig_path, method="thesis"))
        for again, first in zip(read_rig(output).sheets, read_rig(rig_path).sheets, strict=True):
            assert again.baseline_mm == pytest.approx(first.baseline_mm, rel=0.1)


class TestPicks:
    def picks(self, folder: Path, text: str) -> Path:
        path = folder / "picks.csv"
        path.write_text(text, encoding="utf-8")
        return path

    def test_points_picked_by_hand_decide_the_fit(self, whole: Path, tmp_path: Path) -> None:
        """Two points a laser just determine its two numbers, so they come out as computed by hand."""
        capture = open_capture(whole)
        camera, height = capture.rig().camera, capture.info.camera_height_mm
        baseline, angle = 250.0, np.radians(64.0)
        lines = ["laser,u,v,height_mm"]
        for laser, sign in ((1, 1.0), (2, -1.0)):
            for top in (0.0, 20.0):
                tangent = baseline / (height - top) - 1.0 / np.tan(angle)
                lines.append(f"{laser},640,{camera.cy + sign * tangent * camera.fy:.9f},{top}")
        path = self.picks(tmp_path, "\n".join(lines) + "\n")
        output = tmp_path / "rig.json"
        run_calibrate(CalibrateRequest(whole, output, method="thesis", picks=path))
        for sheet in read_rig(output).sheets:
            assert sheet.baseline_mm == pytest.approx(baseline, abs=1e-3)
            assert np.degrees(sheet.angle_rad) == pytest.approx(64.0, abs=1e-4)

    @pytest.mark.parametrize(
        ("text", "match"),
        [
            ("laser,u,v,height_mm\n1,640,500,0\n1,640,510,20\n", "0 points of laser 2"),
            ("laser,u,v,height_mm\n3,640,500,0\n", "line 2: laser must be a number from 1 to 2"),
            ("laser,u,v,height_mm\n1,640,abc,0\n", "line 2: v must be a number"),
            ("laser,u,v\n1,640,500\n", "height_mm"),
        ],
    )
    def test_a_table_that_cannot_be_used_is_refused_by_line(
        self, whole: Path, tmp_path: Path, text: str, match: str
    ) -> None:
        path = self.picks(tmp_path, text)
        with pytest.raises((CalibrationError, CaptureError), match=match):
            run_calibrate(CalibrateRequest(whole, tmp_path / "rig.json", method="thesis", picks=path))


class TestBadArguments:
    @pytest.mark.parametrize(
        ("options", "words"),
        [
            (["--method", "simplex"], ["--method simplex", "joint, thesis"]),
            (["--method", "thesis", "--only", "sheets"], ["--only belongs to --method joint"]),
            (["--picks", "picks.csv"], ["--picks belongs to --method thesis"]),
            (["--report", "report.pdf"], ["report.pdf", ".html"]),
        ],
    )
    def test_they_are_refused_before_any_work(self, tmp_path: Path, options: list[str], words: list[str]) -> None:
        done = twinline("calibrate", tmp_path, "-o", tmp_path / "rig.json", *options)
        require_refusal(done, *words)
        assert files_below(tmp_path) == set()

    def test_a_report_that_cannot_be_written_costs_no_work(self, whole: Path, tmp_path: Path) -> None:
        request = CalibrateRequest(whole, tmp_path / "rig.json", report=tmp_path / "no folder" / "report.html")
        with pytest.raises(OutputError, match="make its folder first"):
            run_calibrate(request)
        assert files_below(tmp_path) == set()


class TestMissingParts:
    @pytest.mark.parametrize(
        ("part", "match"), [("laser", "needs a laser pass|no laser pass"), ("tof", "there is no tof/")]
    )
    def test_it_says_which_pass_it_needs_and_the_rig_of_before_stays(
        self, whole: Path, tmp_path: Path, part: str, match: str
    ) -> None:
        folder = tmp_path / "capture"
        folder.mkdir()
        for path in whole.iterdir():
            if path.name != part:
                (folder / path.name).symlink_to(path)
        output = tmp_path / "rig.json"
        write_rig(output, open_capture(folder).rig())
        before = output.read_bytes()
        with pytest.raises(TwinlineError, match=match):
            run_calibrate(CalibrateRequest(folder, output, method="thesis"))
        assert output.read_bytes() == before
