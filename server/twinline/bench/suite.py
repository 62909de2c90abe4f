"""The whole run: what is measured, and on how much."""

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from twinline.bench.calibration import joint_adjustment
from twinline.bench.exports import write_clouds
from twinline.bench.extraction import colour_in_place, gray_from_memory, gray_in_cache, usual_ways
from twinline.bench.figures import Report, Section
from twinline.bench.frames import jpeg_to_points
from twinline.bench.growth import memory, time_per_frame
from twinline.bench.machine import this_machine
from twinline.bench.recording import record_fast, record_passes
from twinline.bench.start import start_up
from twinline.bench.turns import one_core

Tell = Callable[[str, int, int], None]
"""Called with (what comes next, sections done, sections) before each section."""


@dataclass(frozen=True)
class Sizes:
    """How much is measured; the defaults are those of PERFORMANCE.md.

    Attributes
    ----------
    frame, small_frame : (int, int)
        Width and height of the camera's frames, and of those that scans of many frames are made of.
    share_frames
        Frames in a share.
    scan_frames, memory_frames
        Lengths of scans to time, and to weigh.
    recording_s, fast_recording_s
        Lengths of the passes that are recorded, in real time.
    """

    frame: tuple[int, int] = (1280, 720)
    small_frame: tuple[int, int] = (320, 180)
    kernel_rounds: int = 400
    usual_rounds: int = 60
    fitted_columns: int = 24
    share_rounds: int = 11
    share_frames: int = 24
    scan_rounds: int = 3
    scan_frames: tuple[int, ...] = (100, 200, 400, 800)
    memory_frames: tuple[int, int] = (500, 5000)
    points: int = 1_000_000
    export_rounds: int = 9
    adjustment_rounds: int = 9
    adjusted_observations: int = 12_000
    simplex_evaluations: int = 10_000
    recording_rounds: int = 3
    recording_s: float = 8.0
    fast_recording_s: float = 20.0
    start_rounds: int = 7


def _nothing(*_: object) -> None: ...


def run_suite(sizes: Sizes | None = None, tell: Tell = _nothing) -> Report:
    """Measure everything, on one core.

    Raises
    ------
    TwinlineError
        What is measured does not work.
    """
    sizes = sizes or Sizes()
    with one_core(), tempfile.TemporaryDirectory(prefix="twinline-bench-") as folder:
        sections = tuple(_sections(sizes, Path(folder), tell))
    return Report(datetime.now(UTC).date().isoformat(), this_machine(), sections)


def _sections(sizes: Sizes, folder: Path, tell: Tell) -> Iterator[Section]:
    frame, small = sizes.frame, sizes.small_frame
    parts: dict[str, Callable[[], Section | None]] = {
        "gray frame, in cache": lambda: gray_in_cache(sizes.kernel_rounds, frame),
        "gray frame, from memory": lambda: gray_from_memory(sizes.kernel_rounds, frame),
        "colour frame": lambda: colour_in_place(sizes.kernel_rounds, frame),
        "the usual ways": lambda: usual_ways(sizes.usual_rounds, frame, sizes.fitted_columns),
        "JPEG to points, gray": lambda: jpeg_to_points(
            sizes.share_rounds, frame, sizes.share_frames, folder / "gray", colour=False
        ),
        "JPEG to points, colour": lambda: jpeg_to_points(
            sizes.share_rounds, frame, sizes.share_frames, folder / "colour", colour=True
        ),
        "time per frame": lambda: time_per_frame(sizes.scan_rounds, small, sizes.scan_frames, folder / "time"),
        "memory": lambda: memory(small, sizes.memory_frames, folder / "memory"),
        "exports": lambda: write_clouds(sizes.export_rounds, sizes.points, folder / "exports"),
        "joint adjustment": lambda: joint_adjustment(
            sizes.adjustment_rounds, sizes.adjusted_observations, sizes.simplex_evaluations
        ),
        "recording": lambda: record_passes(sizes.recording_rounds, frame, sizes.recording_s, folder / "recording"),
        "recording, fast": lambda: record_fast(frame, sizes.fast_recording_s, folder / "fast"),
        "start-up": lambda: start_up(sizes.start_rounds),
    }
    for done, (name, measure) in enumerate(parts.items()):
        tell(name, done, len(parts))
        section = measure()
        if section is not None:
            yield section
    tell("", len(parts), len(parts))
