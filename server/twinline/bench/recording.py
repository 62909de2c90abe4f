"""Recording a pass: what it costs the processor, and whether a fast camera's frames all arrive."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twinline.bench.captures import bench_rig, write_capture
from twinline.bench.figures import Figure, Quartiles, Ratio, Section
from twinline.errors import OutputError
from twinline.geometry.rig_json import rig_to_json
from twinline.recording.capture import open_capture
from twinline.recording.capture_json import capture_json_text
from twinline.recording.pass_header import PassHeader
from twinline.recording.pass_reader import open_recording
from twinline.recording.pass_writer import PassWriter
from twinline.recording.stored import StoredEncoding
from twinline.recording.telemetry_table import TelemetryLine

RATE_HZ = 25.0
FAST_HZ = 100.0
TELEMETRY_HZ = 100.0
MUST, AIM = 0.15, 0.05
ONE_CORE = "the time it took"
RECORDED = "recording, processor"
OPENED = "opening the recording"
READ = "one frame, from anywhere"
_DRAWN = 13
_READS = 200
_US = 1e6
_SEED = 20240604


@dataclass(frozen=True)
class _Shot:
    sequence: int
    host_time_s: float
    data: bytes
    image_size: tuple[int, int]
    exposure_s: float | None = 0.002
    encoding: StoredEncoding = "jpeg"
    dropped: int = 0


def record_passes(rounds: int, size: tuple[int, int], seconds: float, folder: Path) -> Section:
    """Passes of a camera at 25 frames a second in real time, then the costs of opening and of reading.

    Parameters
    ----------
    seconds
        Length of each pass.
    """
    pictures = _pictures(size, folder / "pictures")
    used, took = np.empty(rounds), np.empty(rounds)
    for number in range(rounds):
        path = folder / f"pass{number}.mcap"
        used[number], took[number] = _record(path, pictures, size, RATE_HZ, seconds, folder / "pictures")
        require_all(path, round(seconds * RATE_HZ))
    frames = seconds * RATE_HZ
    ratio = Ratio(ONE_CORE, Quartiles.of(used / took), MUST, AIM)
    last = folder / f"pass{rounds - 1}.mcap"
    return Section(
        "recording",
        f"Recording {size[0]} x {size[1]} px JPEG at {RATE_HZ:g} frames/s",
        f"Passes of {seconds:g} s in real time, frames of {len(pictures[0]) / 1e3:.0f} kB and {TELEMETRY_HZ:g} lines "
        "of telemetry a second; per frame, processor time of all threads.",
        rounds,
        (
            Figure(ONE_CORE, Quartiles.of(took / frames * _US), "us"),
            Figure(RECORDED, Quartiles.of(used / frames * _US), "us", (ratio,)),
            Figure(OPENED, Quartiles.of(_times(lambda: open_recording(last), rounds) / frames * _US), "us"),
            Figure(READ, Quartiles.of(_reads(last)), "us"),
        ),
    )


def record_fast(size: tuple[int, int], seconds: float, folder: Path) -> Section:
    """One pass of a camera at 100 frames a second in real time; it must arrive whole.

    Raises
    ------
    OutputError
        A frame was lost.
    """
    pictures = _pictures(size, folder / "pictures")
    path = folder / "fast.mcap"
    used_s, took_s = _record(path, pictures, size, FAST_HZ, seconds, folder / "pictures")
    require_all(path, round(seconds * FAST_HZ))
    frames = seconds * FAST_HZ
    figures = (
        Figure(ONE_CORE, Quartiles.of(np.array([took_s / frames * _US])), "us"),
        Figure(
            RECORDED,
            Quartiles.of(np.array([used_s / frames * _US])),
            "us",
            (Ratio(ONE_CORE, Quartiles.of(np.array([used_s / took_s])), 4 * MUST, 4 * AIM),),
        ),
    )
    return Section(
        "recording-fast",
        f"Recording {size[0]} x {size[1]} px JPEG at {FAST_HZ:g} frames/s",
        f"A pass of {seconds:g} s in real time, {path.stat().st_size / 1e6:.0f} MB; none of its {frames:.0f} frames "
        "was lost, each checked byte by byte.",
        1,
        figures,
    )


def require_all(path: Path, frames: int) -> None:
    """Make sure that a recording holds so many frames, all as they were.

    Raises
    ------
    OutputError
        If not.
    """
    recording = open_recording(path)
    found = recording.parts.get("laser", ())
    for frame in found:
        frame.picture.raw_bytes()
    if len(found) != frames or not recording.whole:
        raise OutputError(f"{path} holds {len(found)} of {frames} frames; the disk is too slow for this bench.")


def _pictures(size: tuple[int, int], folder: Path) -> list[bytes]:
    capture = write_capture(folder, size, _DRAWN, drawn=_DRAWN, colour=True)
    return [picture.read_bytes() for picture in sorted((capture.path / "laser").glob("*.jpg"))]


def _record(
    path: Path, pictures: list[bytes], size: tuple[int, int], rate_hz: float, seconds: float, described: Path
) -> tuple[float, float]:
    """Record a pass in real time; seconds of the processor and of the clock."""
    info = open_capture(described).info
    header = PassHeader("laser", capture_json_text(info), rig=rig_to_json(bench_rig(size)))
    lines_per_frame = round(TELEMETRY_HZ / rate_hz)
    begun_s, used_s = time.monotonic(), time.process_time()
    with PassWriter(path, header) as writer:
        for number in range(round(seconds * rate_hz)):
            due_s = number / rate_hz
            time.sleep(max(begun_s + due_s - time.monotonic(), 0.0))
            writer.frame(_Shot(number, due_s, pictures[number % len(pictures)], size))
            for line in range(lines_per_frame):
                n = number * lines_per_frame + line
                time_s = n / TELEMETRY_HZ
                writer.telemetry(TelemetryLine(n, time_s, time_s, 0.5 * time_s, 0.0, 2048, 3))
        time.sleep(max(begun_s + seconds - time.monotonic(), 0.0))
    return time.process_time() - used_s, time.monotonic() - begun_s


def _times(call: Callable[[], object], rounds: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    times = np.empty(rounds)
    for number in range(rounds):
        start = time.perf_counter()
        call()
        times[number] = time.perf_counter() - start
    return times


def _reads(path: Path) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Microseconds to have the bytes of single frames, in no order."""
    frames = open_recording(path).parts["laser"]
    order = np.random.default_rng(_SEED).integers(0, len(frames), _READS)
    times = np.empty(_READS)
    for place, index in enumerate(order):
        start = time.perf_counter()
        frames[index].picture.raw_bytes()
        times[place] = (time.perf_counter() - start) * _US
    return times
