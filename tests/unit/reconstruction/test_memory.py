"""Memory does not grow with the length of a pass."""

import json
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

from tests.unit.reconstruction.small_pass import Pass, description, render
from twinline.recording.capture import open_capture

GIVEN = Pass(size=(640, 480)).with_frames(6, 0.02)
COLUMNS = 64
"""Of each picture: few points, so that what is left of them in the account does not matter, and many pixels."""

FRAMES = (500, 5000)
GROWTH = 1.20


def write_long_pass(folder: Path, frames: int) -> Path:
    """A pass of any length out of six pictures, each under many names."""
    import cv2

    laser = folder / "laser"
    laser.mkdir(parents=True)
    known = {**description(GIVEN), "image_size": [COLUMNS, GIVEN.size[1]]}
    (folder / "capture.json").write_text(json.dumps(known), encoding="utf-8")
    for place in range(6):
        assert cv2.imwrite(str(folder / f"{place}.png"), render(GIVEN, place)[:, :COLUMNS])
    lines = ["frame,time_s,cart_mm"]
    for place in range(frames):
        os.link(folder / f"{place % 6}.png", laser / f"{place:05d}.png")
        lines.append(f"{place:05d}.png,{0.04 * place:.2f},{0.02 * place:.2f}")
    (laser / "frames.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def peak_rss(command: list[str]) -> tuple[int, str]:
    """Most bytes that the command and its children held together, and its standard output."""
    peak = 0
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, encoding="utf-8") as process:
        root = psutil.Process(process.pid)
        while process.poll() is None:
            total = 0
            with suppress(psutil.NoSuchProcess):
                for one in (root, *root.children(recursive=True)):
                    with suppress(psutil.NoSuchProcess):
                        total += one.memory_info().rss
            peak = max(peak, total)
            with suppress(subprocess.TimeoutExpired):
                process.wait(0.05)
        out, err = process.communicate()
    assert process.returncode == 0, err
    return peak, out


@pytest.mark.slow
def test_five_thousand_frames_take_hardly_more_memory_than_five_hundred(tmp_path: Path) -> None:
    peaks = []
    for frames in FRAMES:
        folder = write_long_pass(tmp_path / str(frames), frames)
        assert open_capture(folder).laser is not None
        command = [sys.executable, "-m", "twinline", "reconstruct", str(folder), "-o", str(tmp_path / "cloud.ply")]
        peak, out = peak_rss([*command, "--workers", "2", "--json"])
        summary = json.loads(out)
        assert summary["frames_used"] == frames
        # A point takes 24 bytes in the cloud and as much again while the shares are joined.
        peaks.append(peak - 48 * summary["points"])
        assert 48 * summary["points"] < 0.1 * peak
    assert peaks[1] <= GROWTH * peaks[0]
