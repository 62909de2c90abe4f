"""Stand-ins for time, tools and the 3-D view, and a capture of a few bytes."""

import json
import threading
from collections.abc import Callable
from concurrent.futures import Executor
from datetime import UTC, datetime, timedelta
from pathlib import Path

import cv2
import numpy as np

from twinline.fusion.cloud import PointCloud
from twinline.geometry.rig import Rig
from twinline.operations.exports.glb import write_glb
from twinline.operations.exports.ply import write_ply
from twinline.operations.toolbox import Toolbox
from twinline.reconstruction.result import (
    Checkpoint,
    FrameProblem,
    OnPoints,
    Reconstruction,
    ReconstructionOptions,
    Report,
)
from twinline.recording.capture import Capture, open_capture
from twinline.recording.rig_file import read_rig
from twinline.recording.zip_file import unpack_capture


class FakeClock:
    """Time that stands still until it is moved."""

    def __init__(self) -> None:
        self.start = datetime(2026, 11, 22, 10, 0, tzinfo=UTC)
        self.elapsed_s = 0.0

    def now(self) -> datetime:
        return self.start + timedelta(seconds=self.elapsed_s)

    def monotonic_s(self) -> float:
        return self.elapsed_s


class FakeReconstruct:
    """Gives some points in some chunks; tests hold it, or make it fail, at a chunk of their choice."""

    def __init__(self, chunks: int = 4, points: int = 50) -> None:
        self.chunks = chunks
        self.points = points
        self.at_chunk: Callable[[int], None] = lambda _: None
        self.rig: Rig | None = None

    def __call__(
        self,
        capture: Capture,
        rig: Rig,
        options: ReconstructionOptions,
        *,
        executor: Executor,
        report: Report,
        checkpoint: Checkpoint,
        on_points: OnPoints,
    ) -> Reconstruction:
        self.rig = rig
        clouds = []
        for number in range(self.chunks):
            self.at_chunk(number)
            checkpoint()
            clouds.append(some_points(self.points, seed=number))
            on_points(clouds[-1])
            report(number + 1, self.chunks)
        return Reconstruction(
            PointCloud.concatenate(clouds),
            frames=self.chunks,
            frames_used=self.chunks - 1,
            problem_count=1,
            problems=(FrameProblem("000003.png", "it ends early"),),
            counts={"laser1": self.chunks * self.points},
            elapsed_s=1.5,
        )


class Hold:
    """Stops a fake at one chunk until the test lets it go on."""

    def __init__(self, chunk: int) -> None:
        self.chunk = chunk
        self.reached = threading.Event()
        self.released = threading.Event()

    def __call__(self, number: int) -> None:
        if number == self.chunk:
            self.reached.set()
            assert self.released.wait(20)


def some_points(count: int, seed: int = 0) -> PointCloud:
    """Points in a box of 100 x 60 x 20 mm."""
    random = np.random.default_rng(seed)
    return PointCloud(
        random.uniform((0, 0, 0), (100, 60, 20), (count, 3)).astype(np.float32),
        random.uniform(0.01, 0.05, count).astype(np.float32),
        random.uniform(20, 200, count).astype(np.float32),
        random.integers(0, 256, (count, 3), dtype=np.uint8),
        random.integers(1, 3, count, dtype=np.uint8),
    )


def write_capture(folder: Path, name: str = "two frames", frames: int = 2) -> Path:
    """A capture folder that is in order, with dark pictures."""
    description = {
        "name": name,
        "image_size": [64, 48],
        "stripe_runs": "along-u",
        "camera_matrix_guess": [[60, 0, 32], [0, 60, 24], [0, 0, 1]],
        "camera_height_mm": 430.0,
        "lasers": [{"baseline_mm": 246.0, "angle_deg": 60.0, "side": "+v"}],
    }
    (folder / "laser").mkdir(parents=True)
    (folder / "capture.json").write_text(json.dumps(description), encoding="utf-8")
    lines = ["frame,time_s,cart_mm"]
    for number in range(frames):
        picture = f"{number:06d}.png"
        assert cv2.imwrite(str(folder / "laser" / picture), np.zeros((48, 64), np.uint8))
        lines.append(f"{picture},{number * 0.04:.2f},{number * 0.5:.1f}")
    (folder / "laser" / "frames.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def fake_render(
    folder: Path, scene: str, *, seed: int, executor: Executor, report: Report, checkpoint: Checkpoint
) -> None:
    """Writes the small capture under the scene's name."""
    checkpoint()
    write_capture(folder, scene)
    report(2, 2)


def fake_toolbox(reconstruct: FakeReconstruct | None = None) -> Toolbox:
    """Real files, made-up points."""
    return Toolbox(
        open_capture=open_capture,
        read_rig=read_rig,
        unpack=unpack_capture,
        reconstruct=reconstruct or FakeReconstruct(),
        render=fake_render,
        writers={"cloud.ply": write_ply, "cloud.glb": write_glb},
        methods=("maximum-likelihood", "brightest-pixel"),
        default_method="maximum-likelihood",
        scenes={"blocks": "blocks", "ball": "ball"},
    )
