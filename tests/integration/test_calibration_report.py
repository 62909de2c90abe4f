"""The calibration report: its page says what its object says, for good calibrations and for refused ones."""

import html
import json
import re
import shutil
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from tests.accuracy.calibration_parts import TrueTof, misaligned_rig, whole_capture
from twinline.calibration.scanner_evidence import ScannerEvidence
from twinline.cli.calibrate import CalibrateRequest, run_calibrate
from twinline.errors import TwinlineError
from twinline.geometry.rig_json import rig_id
from twinline.operations.calibrate import CalibrationOptions
from twinline.operations.calibration_report.gather import Reported, calibrate_with_report
from twinline.operations.calibration_report.markup import length, number
from twinline.operations.calibration_report.model import CalibrationReport
from twinline.operations.calibration_report.page import render_page
from twinline.recording.capture import open_capture
from twinline.recording.rig_file import read_rig, write_rig

pytestmark = pytest.mark.slow

MADE = "2024-05-06T07:08:09.000Z"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report") / "capture"
    whole_capture(folder, "three-objects", misaligned_rig(6), seed=6, pitch_mm=2.0, tof=TrueTof())
    (folder / "rig.json").unlink()
    return folder


@pytest.fixture(scope="module")
def reported(whole: Path) -> Reported:
    return calibrate_with_report(open_capture(whole), CalibrationOptions(), method="joint", made=MADE)


@pytest.fixture(scope="module")
def page(reported: Reported) -> str:
    return render_page(reported.report)


def visible(page: str) -> str:
    """The page's words, one space between any two."""
    body = re.sub(r"<style>.*?</style>", "", page, flags=re.DOTALL)
    return re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]*>", " ", body)))


class _Outline(HTMLParser):
    """Open elements at the end, addresses, and pictures without words."""

    VOID = frozenset({"meta", "image", "rect", "line", "path", "circle", "polyline", "br"})

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.silent: list[str] = []
        self.anchors: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.addresses += [found[key] or "" for key in ("href", "src") if key in found]
        if tag == "svg" and not found.get("aria-label") and found.get("aria-hidden") != "true":
            self.silent.append(self.get_starttag_text() or tag)
        if found.get("id"):
            self.anchors.add(found["id"] or "")
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def outline(page: str) -> _Outline:
    found = _Outline()
    found.feed(page)
    return found


class TestObject:
    def test_it_is_the_evidence_of_the_rig_and_more(self, reported: Reported) -> None:
        report, rig = reported.report, reported.rig
        assert rig is not None
        assert reported.error is None
        assert report.rig_id == rig_id(rig)
        assert report.evidence is not None
        assert report.verdict == report.evidence.verdict
        kept = rig.evidence["calibration"]
        assert isinstance(kept, dict)
        assert {**report.evidence.to_json(), "method": "joint"} == kept

    def test_differences_before_and_after_are_those_of_the_evidence(self, reported: Reported) -> None:
        evidence = reported.report.evidence
        assert isinstance(evidence, ScannerEvidence)
        scans = {scan.label: scan for scan in reported.report.scans}
        assert list(scans) == ["before", "thesis", "joint"]
        for label, expected in (("before", evidence.before), ("joint", evidence.after)):
            found = {pair.figures.pair: pair.figures for pair in scans[label].pairs}
            for agreement in expected:
                assert found[agreement.pair].typical_mm == pytest.approx(agreement.typical_mm, rel=1e-9)
                assert found[agreement.pair].p90_mm == pytest.approx(agreement.p90_mm, rel=1e-9)

    def test_histograms_hold_every_observation_and_no_more_rejected_than_the_share(self, reported: Reported) -> None:
        assert reported.report.groups
        for group in reported.report.groups:
            assert group.residuals.total == group.figures.observations
            assert group.rejected.total == round(group.figures.rejected_share * group.figures.observations)

    def test_quantities_are_those_of_the_rigs_and_their_sds_those_of_the_covariance(self, reported: Reported) -> None:
        rig, thesis = reported.rig, reported.thesis
        assert rig is not None
        assert thesis is not None
        assert rig.covariance is not None
        found = {(q.part, q.name): q for q in reported.report.quantities}
        assert found["Camera", "focal length u"].joint == pytest.approx(rig.camera.fx)
        assert found["Camera", "focal length u"].sd == pytest.approx(rig.covariance.sd("camera.fx"))
        for k in (0, 1):
            baseline, angle = found[f"Laser {k + 1}", "baseline"], found[f"Laser {k + 1}", "angle"]
            assert baseline.joint == pytest.approx(rig.sheets[k].baseline_mm)
            assert baseline.thesis == pytest.approx(thesis.rig.sheets[k].baseline_mm)
            assert baseline.before == pytest.approx(250.0)
            assert angle.joint == pytest.approx(np.degrees(rig.sheets[k].angle_rad))
        assert found["Travel", "scale"].joint == pytest.approx(np.linalg.norm(rig.travel))
        assert found["Travel", "scale"].seen == "seen"
        height = found["Camera", "height above the bed"]
        assert height.joint == pytest.approx(rig.bed_from_camera.translation_mm[2])
        assert height.sd == pytest.approx(rig.covariance.sd("bed.z"), rel=1e-3)

    def test_it_holds_each_run_of_the_thesis_with_its_whole_trace(self, reported: Reported) -> None:
        thesis = reported.thesis
        assert thesis is not None
        runs = reported.report.thesis.runs
        assert [run.name for run in runs] == ["Laser 1", "Laser 2", "Laser 1 onto laser 2", "ToF onto both lasers"]
        for run, fit in zip(runs, thesis.calibration.fits, strict=False):
            np.testing.assert_allclose(run.values, fit.trace.values, rtol=1e-6)
            np.testing.assert_allclose(run.parameters["angle_deg"], fit.trace.parameters[:, 1], rtol=1e-6)
            assert len(run.simplex_size) == len(run.values)

    def test_it_becomes_json_and_what_is_not_known_becomes_null(self, reported: Reported) -> None:
        text = json.dumps(reported.report.to_json(), allow_nan=False)
        again = json.loads(text)
        assert again["verdict"] == reported.report.verdict
        assert len(again["coverage"]["views"]) == 14
        assert len(text) < 2_000_000


class TestPage:
    def test_it_needs_nothing_from_anywhere(self, page: str) -> None:
        found = outline(page)
        assert all(a.startswith(("#", "data:image/png;base64,")) for a in found.addresses)
        assert "<script" not in page
        assert "@import" not in page
        assert not re.search(r"url\((?!#)", page)

    def test_it_is_well_formed_and_every_link_inside_has_its_place(self, page: str) -> None:
        found = outline(page)
        assert found.open == []
        assert {a[1:] for a in found.addresses if a.startswith("#")} <= found.anchors

    def test_every_picture_has_words_and_every_table_a_caption(self, page: str) -> None:
        assert outline(page).silent == []
        assert page.count("<table>") == page.count("<caption>") > 5

    def test_it_follows_the_theme_and_prints_light(self, page: str) -> None:
        assert "@media screen and (prefers-color-scheme: dark)" in page
        assert "@media print" in page

    def test_the_verdict_stands_first_with_every_reason(self, reported: Reported, page: str) -> None:
        words = visible(page)
        report = reported.report
        name = {"good": "Good", "usable": "Usable, with reservations"}[report.verdict]
        assert words.index(name) < words.index("The same scan before and after")
        for reason in report.reasons:
            assert reason in words

    def test_its_numbers_are_those_of_the_object(self, reported: Reported, page: str) -> None:
        words = visible(page)
        report = reported.report
        residuals = words[words.index("Residuals of the joint adjustment") :]
        for group in report.groups:
            figures = group.figures
            cells = [number(figures.observations, 0), length(figures.rms_mm), length(figures.held_out_mm)]
            row = " ".join(visible(cell).strip() for cell in cells)
            assert f"{figures.kind[1:]} {row} " in residuals
        for scan in report.scans:
            for pair in scan.pairs:
                assert visible(length(pair.figures.typical_mm)).strip() in words
        for quantity in report.quantities:
            assert visible(number(quantity.joint, quantity.decimals)).strip() in words
        for parameter in report.evidence.parameters if report.evidence else ():
            assert parameter.name in words

    def test_it_shows_every_nelder_mead_run_as_graph_and_as_row(self, reported: Reported, page: str) -> None:
        words = visible(page)
        for run in reported.report.thesis.runs:
            row = re.search(rf"{run.name} {re.escape(run.value_name)} (\S+) (\S+) (\d+) ", words)
            assert row is not None
            assert float(row[2]) == pytest.approx(run.values[-1], rel=1e-4)
            assert int(row[3]) == len(run.values) - 1
        assert page.count('class="line laser1"') == 4
        assert "size of the simplex" in words

    def test_names_from_a_capture_cannot_become_markup(self, reported: Reported) -> None:
        evil = "<img src=x onerror=alert(1)>"
        values = {f: getattr(reported.report, f) for f in CalibrationReport.__dataclass_fields__}
        made = render_page(CalibrationReport(**{**values, "capture": evil, "reasons": (evil,)}))
        assert "<img" not in made


class TestOtherMethod:
    def test_the_thesis_rig_can_be_the_result_and_the_joint_one_stands_beside_it(
        self, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        output, report = tmp_path / "rig.json", tmp_path / "report.html"
        run_calibrate(CalibrateRequest(whole, output, json=True, method="thesis", report=report))
        summary = json.loads(capsys.readouterr().out)
        assert summary["report"]["method"] == "thesis"
        assert summary["report"]["verdict"] == "usable"
        assert summary["report"]["rig_id"] == rig_id(read_rig(output))
        assert [scan["label"] for scan in summary["report"]["scans"]] == ["before", "thesis", "joint"]
        assert "Thesis method: this rig" in visible(report.read_text(encoding="utf-8"))


def without(*parts: str) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        for part in parts:
            shutil.rmtree(folder / part)

    return spoil


def standing_cart(folder: Path) -> None:
    without("camera", "motion", "tof")(folder)
    path = folder / "laser" / "frames.csv"
    head, *lines = path.read_text(encoding="utf-8").splitlines()
    rows = [line.split(",") for line in lines]
    path.write_text("\n".join([head, *(f"{r[0]},{r[1]},5.0" for r in rows)]) + "\n", encoding="utf-8")


def raster_beside(folder: Path) -> None:
    without("camera", "motion")(folder)
    path = folder / "tof" / "samples.csv"
    head, *lines = path.read_text(encoding="utf-8").splitlines()
    rows = [line.split(",") for line in lines]
    moved = (f"{r[0]},{float(r[1]) + 900:.4f},{r[2]},{r[3]}" for r in rows)
    path.write_text("\n".join([head, *moved]) + "\n", encoding="utf-8")


def few_views(folder: Path) -> None:
    without("motion", "laser", "tof")(folder)
    for path in sorted((folder / "camera").iterdir())[2:]:
        path.unlink()


def same_views(folder: Path) -> None:
    without("motion", "laser", "tof")(folder)
    first, *others = sorted((folder / "camera").iterdir())
    for path in others:
        shutil.copyfile(first, path)


def wrong_board(folder: Path) -> None:
    without("motion", "laser", "tof")(folder)
    path = folder / "capture.json"
    description = json.loads(path.read_text(encoding="utf-8"))
    description["board"]["columns"] = 7
    path.write_text(json.dumps(description), encoding="utf-8")


def nothing_left(folder: Path) -> None:
    without("camera", "motion", "laser", "tof")(folder)


class TestRefused:
    @pytest.mark.parametrize(
        ("spoil", "code", "words"),
        [
            (standing_cart, "no-travel", "the pass has no length"),
            (raster_beside, "no-overlap", "nothing in common"),
            (few_views, "too-few-views", "Only 2 of 2 pictures can be used"),
            (same_views, "views-alike", "in the same pose as another one"),
            (wrong_board, "wrong-board", "correct the board"),
            (nothing_left, "nothing-to-calibrate", "add camera/"),
            (without("camera", "motion", "tof"), "calibration-refused", "uncertain by"),
        ],
    )
    def test_the_report_gives_the_reason_and_the_rig_of_before_stays(
        self,
        whole: Path,
        tmp_path: Path,
        capsys: pytest.CaptureFixture[str],
        spoil: Callable[[Path], None],
        code: str,
        words: str,
    ) -> None:
        folder = Path(shutil.copytree(whole, tmp_path / "capture"))
        spoil(folder)
        output, report = tmp_path / "rig.json", tmp_path / "report.html"
        write_rig(output, open_capture(whole).rig())
        before = output.read_bytes()
        with pytest.raises(TwinlineError, match=words) as caught:
            run_calibrate(CalibrateRequest(folder, output, json=True, report=report))
        assert caught.value.code == code
        assert output.read_bytes() == before
        page = report.read_text(encoding="utf-8")
        seen = visible(page)
        assert "Refused" in seen
        assert "the one in use stays in force" in seen
        assert words in seen
        assert code in seen
        assert outline(page).open == []
        told = json.loads(capsys.readouterr().out)
        assert told["output"] is None
        assert told["report"]["verdict"] == "refused"
        assert told["report"]["code"] == code
        assert any(words in reason for reason in told["report"]["reasons"])
        assert {path.name for path in tmp_path.iterdir()} == {"capture", "rig.json", "report.html"}

    def test_views_that_led_to_a_refusal_are_shown_with_their_verdicts(self, whole: Path, tmp_path: Path) -> None:
        folder = Path(shutil.copytree(whole, tmp_path / "capture"))
        same_views(folder)
        found = calibrate_with_report(open_capture(folder), CalibrationOptions(), method="joint", made=MADE)
        assert found.rig is None
        assert found.report.coverage is not None
        assert [view.verdict for view in found.report.coverage.views].count("duplicate") == 13
        assert "None of the 14 pictures" in visible(render_page(found.report))


class TestRealViews:
    def test_views_nearly_parallel_to_the_board_are_refused_with_their_tilts(
        self, shared_data: Callable[[str], Path], tmp_path: Path
    ) -> None:
        folder = tmp_path / "capture"
        (folder / "camera").mkdir(parents=True)
        for path in (shared_data("linear_stairs") / "chessboard").glob("*.jpg"):
            (folder / "camera" / path.name).symlink_to(path)
        description = {
            "name": "stairs",
            "image_size": [640, 480],
            "stripe_runs": "along-v",
            "camera_matrix_guess": [[850, 0, 320], [0, 850, 240], [0, 0, 1]],
            "board": {"kind": "chessboard", "columns": 5, "rows": 5, "square_mm": 5.0},
            "camera_height_mm": 80.0,
            "lasers": [{"baseline_mm": 37.3, "angle_deg": 65.0, "side": "-u"}],
        }
        (folder / "capture.json").write_text(json.dumps(description), encoding="utf-8")
        found = calibrate_with_report(open_capture(folder), CalibrationOptions(), method="joint", made=MADE)
        assert found.report.code == "focal-length-unobservable"
        assert found.report.coverage is not None
        assert all(view.tilt_deg < 20.0 for view in found.report.coverage.views)
        assert "Tilts of the board, in degrees" in render_page(found.report)
