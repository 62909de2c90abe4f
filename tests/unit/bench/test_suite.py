"""The whole run on tiny sizes: it works, it is complete, and its results can be printed."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from twinline.bench.captures import write_capture
from twinline.bench.figures import Report
from twinline.bench.growth import InlineExecutor
from twinline.bench.passes import PASSES
from twinline.bench.report import to_json, to_markdown, to_text
from twinline.bench.suite import Sizes, run_suite
from twinline.recording.frames import Frame

TINY = Sizes(
    frame=(320, 180),
    small_frame=(160, 96),
    kernel_rounds=3,
    usual_rounds=3,
    fitted_columns=4,
    share_rounds=2,
    share_frames=3,
    scan_rounds=2,
    scan_frames=(4, 8),
    memory_frames=(4, 8),
    points=1000,
    export_rounds=2,
    adjustment_rounds=2,
    adjusted_observations=3000,
    simplex_evaluations=200,
    recording_rounds=2,
    recording_s=0.2,
    fast_recording_s=0.2,
    start_rounds=1,
)
HAS_PROC = Path("/proc/self/status").is_file()
KEYS = [
    "gray-in-cache",
    "gray-from-memory",
    "colour-in-place",
    "usual-ways",
    "jpeg-gray",
    "jpeg-colour",
    "time-per-frame",
    *(["memory"] if HAS_PROC else []),
    "exports",
    "joint-adjustment",
    "recording",
    "recording-fast",
    "start-up",
]


@pytest.fixture(scope="module")
def told() -> list[tuple[str, int, int]]:
    return []


@pytest.fixture(scope="module")
def report(told: list[tuple[str, int, int]]) -> Report:
    return run_suite(TINY, lambda name, done, total: told.append((name, done, total)))


@pytest.mark.slow
class TestRun:
    def test_every_section_is_there_with_positive_figures_in_order(self, report: Report) -> None:
        assert [section.key for section in report.sections] == KEYS
        for section in report.sections:
            for figure in section.figures:
                assert 0 <= figure.value.low <= figure.value.median <= figure.value.high, figure.name
                for ratio in figure.ratios:
                    assert ratio.value.median > 0, (figure.name, ratio.against)

    def test_extraction_is_put_against_every_pass(self, report: Report) -> None:
        for section in report.sections[:3]:
            ratios = section.figure("two stripes with all flags").ratios
            assert {ratio.against for ratio in ratios} == set(PASSES)
            assert [ratio.must is not None for ratio in ratios] == [True, False, False]

    @pytest.mark.parametrize(
        ("key", "promises"), [("jpeg-gray", 1), ("jpeg-colour", 1), ("time-per-frame", 1), ("joint-adjustment", 1)]
    )
    def test_what_was_promised_is_judged(self, report: Report, key: str, promises: int) -> None:
        section = next(section for section in report.sections if section.key == key)
        judged = [r for figure in section.figures for r in figure.ratios if r.verdict]
        assert len(judged) == promises

    @pytest.mark.skipif(not HAS_PROC, reason="memory of other processes is read from /proc")
    def test_memory_is_that_of_the_processes_and_the_points_apart(self, report: Report) -> None:
        section = next(section for section in report.sections if section.key == "memory")
        few, many = section.figure("points, 4 frames"), section.figure("points, 8 frames")
        assert 0 < few.value.median < many.value.median
        for frames in (4, 8):
            peak = section.figure(f"peak, {frames} frames").value.median
            assert peak > 20
            rest = section.figure(f"peak less points, {frames} frames").value.median
            assert rest == pytest.approx(peak - section.figure(f"points, {frames} frames").value.median)

    def test_progress_is_told_before_each_section_and_at_the_end(
        self, report: Report, told: list[tuple[str, int, int]]
    ) -> None:
        assert report.sections
        assert [done for _, done, _ in told] == list(range(14))
        assert {total for _, _, total in told} == {13}

    def test_the_results_can_be_printed_and_name_no_host(self, report: Report) -> None:
        document = json.loads(to_json(report))
        assert len(document["sections"]) == len(KEYS)
        text, markdown = to_text(report), to_markdown(report)
        for section in report.sections:
            assert section.title in text
            assert f"### {section.title}" in markdown
        name = os.uname().nodename if hasattr(os, "uname") else os.environ.get("COMPUTERNAME", "")
        assert not name or name not in to_json(report)


def test_a_scan_is_written_as_a_capture_whose_neighbouring_frames_are_alike(tmp_path: Path) -> None:
    capture = write_capture(tmp_path / "scan", (320, 180), 9, drawn=4, colour=False)
    assert capture.laser is not None
    assert len(capture.laser) == 9
    frames: list[Frame] = list(capture.laser.read())
    images = [np.asarray(frame.image) for frame in frames]
    assert {image.shape for image in images} == {(180, 320)}
    # Four are drawn; they come to and fro: 0 1 2 3 2 1 0 1 2.
    for one, other in ((0, 6), (1, 5), (1, 7), (2, 4), (2, 8)):
        np.testing.assert_array_equal(images[one], images[other])
    assert not np.array_equal(images[0], images[3])


def test_the_inline_executor_hands_on_results_and_errors() -> None:
    assert InlineExecutor().submit(divmod, 7, 2).result() == (3, 1)
    with pytest.raises(ZeroDivisionError):
        InlineExecutor().submit(divmod, 7, 0).result()
