"""From a JPEG frame to points, against decoding the frame alone."""

from pathlib import Path

import cv2
import numpy as np
import simplejpeg

from twinline.bench.captures import PITCH_MM, bench_rig, write_capture
from twinline.bench.figures import Figure, Quartiles, Section
from twinline.bench.turns import compare, take_turns
from twinline.fusion.cloud import PointCloud
from twinline.fusion.edges import EdgeFilter, EdgeLimits
from twinline.reconstruction.chunk import process_chunk
from twinline.reconstruction.plan import Plan, make_plan
from twinline.reconstruction.result import ReconstructionOptions
from twinline.recording.frames import FrameSequence

DECODED = "decoding alone, OpenCV"
DECODED_HERE = "decoding alone, as done here"
READ = "reading, checking and decoding"
POINTS = "frame to points"
MUST, AIM = 1.25, 1.10
_DRAWN = 13
_SPOT_SD_MM = 0.8
_PX_PER_MM = 1.4


def jpeg_to_points(rounds: int, size: tuple[int, int], frames: int, folder: Path, *, colour: bool) -> Section:
    """Frames of one share, as a worker processes them, then through the edge filter.

    Parameters
    ----------
    folder
        A new folder for the frames.
    """
    capture = write_capture(folder, size, frames, drawn=_DRAWN, colour=colour)
    plan, sequence = make_plan(capture, bench_rig(size), ReconstructionOptions())
    data = [np.frombuffer((sequence.source / f.name).read_bytes(), np.uint8) for f in sequence.frames]

    def decode(_: int) -> None:
        for encoded in data:
            cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED)

    def decode_here(_: int) -> None:
        for encoded in data:
            simplejpeg.decode_jpeg(encoded, "BGR" if colour else "GRAY")

    def read(_: int) -> None:
        for _frame in sequence.read():
            pass

    def points(_: int) -> None:
        to_points(plan, sequence)

    times = take_turns({DECODED: decode, DECODED_HERE: decode_here, READ: read, POINTS: points}, rounds)
    for name in times:
        times[name] /= frames
    ratios = (
        compare(times, POINTS, DECODED, must=MUST, aim=AIM),
        compare(times, POINTS, DECODED_HERE),
        compare(times, POINTS, READ),
    )
    kind = "colour" if colour else "gray"
    return Section(
        f"jpeg-{kind}",
        f"JPEG frame to points, {kind}",
        f"A share of {frames} frames of {size[0]} x {size[1]} px, per frame; light measured: {plan.settings.channel}. "
        "To points: read, check, decode, extract, triangulate, colour, and filter edges.",
        rounds,
        (
            Figure(DECODED, Quartiles.of(times[DECODED]), "us"),
            Figure(DECODED_HERE, Quartiles.of(times[DECODED_HERE]), "us", (compare(times, DECODED_HERE, DECODED),)),
            Figure(READ, Quartiles.of(times[READ]), "us", (compare(times, READ, DECODED),)),
            Figure(POINTS, Quartiles.of(times[POINTS]), "us", ratios),
        ),
    )


def to_points(plan: Plan, frames: FrameSequence) -> PointCloud:
    """The stages of a reconstruction on one share, in this process."""
    limits = EdgeLimits.for_scan(pitch_mm=PITCH_MM, spot_sd_mm=_SPOT_SD_MM, px_per_mm_height=_PX_PER_MM)
    edges = EdgeFilter(limits, len(plan.lasers))
    clouds = [cloud for frame in process_chunk(plan, frames).frames for cloud in edges.add(frame)]
    return PointCloud.concatenate([*clouds, *edges.finish()])
