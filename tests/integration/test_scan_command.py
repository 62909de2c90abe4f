"""``twinline scan`` as a process: what it writes, what it says, and how it ends when it is told to."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from tests.integration.command_line import Done, files_below, require_refusal, twinline
from tests.integration.ply_points import read_points
from twinline.recording.capture import open_capture
from twinline.recording.pass_reader import open_recording

QUICK = ("--scene", "bed", "--area", "40", "60", "--speed", "50", "--tof-advance", "12", "--tof-speed", "40")


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Done]:
    folder = tmp_path_factory.mktemp("scan")
    return folder, twinline("scan", *QUICK, "-o", folder / "bed.ply", "--json")


def test_it_writes_a_cloud_and_a_recording_beside_it(scan: tuple[Path, Done]) -> None:
    folder, done = scan
    assert done.returncode == 0, done.stderr
    expected = {"laser-0.mcap", "tof-0.mcap", "true-rig.json"}
    assert files_below(folder) == {"bed.ply", "bed.scan", *(f"bed.scan/{name}" for name in expected)}
    # The bed is flat, and the simulated machine knows its own calibration.
    points = read_points(folder / "bed.ply")
    assert abs(float(np.median(points[:, 2]))) < 0.05


def test_standard_output_is_one_json_document(scan: tuple[Path, Done]) -> None:
    folder, done = scan
    summary = json.loads(done.stdout)
    assert summary["recording"] == str(folder / "bed.scan")
    assert summary["scan"]["frames"] == summary["frames"] == pytest.approx(10, abs=1)
    assert summary["scan"]["dropped"] == 0
    assert {check["grade"] for check in summary["scan"]["checks"]} == {"good"}
    assert len(summary["scan"]["forecasts"]) == 2
    assert done.stderr == ""


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--speed", "0"), ("speed", "above 0 mm/s")),
        (("--speed", "nan"), ("speed_mm_s", "number")),
        (("--rate", "0"), ("frames/s",)),
        (("--area", "5", "5"), ("no length",)),
        (("--area", "0", "2000"), ("travel", "shorten the area")),
        (("--scene", "nowhere"), ("nowhere",)),
        (("--board", "/dev/nothing"), ("--board, --camera and --machine",)),
        (("--resume",), ("no recording",)),
        (("--tof-advance", "0"), ("advance",)),
        (("--rig", "missing.json"), ("missing.json",)),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else None,
)
def test_what_cannot_be_done_is_said_in_a_sentence(
    tmp_path: Path, arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    require_refusal(twinline("scan", "--scene", "bed", "-o", tmp_path / "x.ply", *arguments), *words)
    assert not files_below(tmp_path)


def test_a_folder_in_use_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "x.scan").mkdir()
    (tmp_path / "x.scan" / "other").write_text("kept")
    require_refusal(twinline("scan", "-o", tmp_path / "x.ply"), "not empty", "other")
    assert files_below(tmp_path) == {"x.scan", "x.scan/other"}


@contextmanager
def running(output: Path) -> Iterator[subprocess.Popen[str]]:
    """A scan in real time, in the middle of its laser pass."""
    command = [sys.executable, "-m", "twinline", "scan", "--scene", "bed", "--area", "20", "120", "--speed", "5"]
    process = subprocess.Popen(
        [*command, "--real-time", "-o", str(output)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
        env={**os.environ, "NO_COLOR": "1", "COLUMNS": "400"},
    )
    try:
        recording = output.with_suffix(".scan") / "laser-0.mcap"
        for _ in range(600):
            if process.poll() is not None or (recording.exists() and recording.stat().st_size > 1_000_000):
                break
            time.sleep(0.1)
        yield process
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("name", ["SIGTERM", "SIGINT"])
def test_a_scan_that_is_told_to_end_says_what_is_left(tmp_path: Path, name: str) -> None:
    with running(tmp_path / "x.ply") as process:
        process.send_signal(getattr(signal, name))
        _, words = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "the lasers are off; what was recorded is in" in words
    assert "Traceback" not in words
    recording = open_recording(tmp_path / "x.scan" / "laser-0.mcap")
    assert recording.whole
    assert recording.parts["laser"]
    # The board was told to stop, and said that it did.
    assert [event.a for event in recording.events if event.kind == "lasers"][-1] == 0


def test_a_scan_that_is_killed_leaves_a_recording_and_cannot_go_on_without_its_machine(tmp_path: Path) -> None:
    with running(tmp_path / "x.ply") as process:
        process.kill()
        process.wait(timeout=60)
    capture = open_capture(tmp_path / "x.scan")
    assert capture.laser is not None
    assert len(capture.laser) > 5
    done = twinline("scan", "--scene", "bed", "-o", tmp_path / "x.ply", "--resume")
    sentence = require_refusal(done, "no longer knows where cart and slide are", "what was recorded is kept")
    assert sentence.count("\n") <= 1
    again = twinline("reconstruct", tmp_path / "x.scan", "-o", tmp_path / "x.ply", "--workers", "1")
    assert again.returncode == 0, again.stderr
