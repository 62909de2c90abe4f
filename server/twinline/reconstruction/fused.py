"""A whole scan: laser pass and ToF pass in, one fused cloud out."""

import time
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from twinline.calibration.thesis_align import align_lasers, align_tof
from twinline.errors import CalibrationError, CaptureError, RigError
from twinline.fusion.cloud import PointCloud, Source
from twinline.fusion.fill import filled_gaps
from twinline.fusion.fuse import Fused, FusionSettings, fuse
from twinline.fusion.holes import Holes, holes
from twinline.fusion.lag import estimate_lag
from twinline.fusion.tof import REACH_MM, TofRaster, TofReason, tof_sweeps
from twinline.geometry.rig import Rig, TofMount
from twinline.reconstruction.colour import UNKNOWN_GREY
from twinline.reconstruction.offline import reconstruct
from twinline.reconstruction.plan import LASER_NAMES
from twinline.reconstruction.result import (
    Alignment,
    Checkpoint,
    OnPoints,
    Reconstruction,
    ReconstructionOptions,
    Report,
)
from twinline.reconstruction.spacing import pitch_mm, point_spacing_mm
from twinline.recording.capture import Capture

TOF_NAME = "tof"
ALL_SOURCES = frozenset({*LASER_NAMES, TOF_NAME})
_HOLE_CELL_MM = 1.5
_LEAST_LINE_MM, _MOST_LINE_MM = 0.3, 3.0

_TOF_COUNTS = {
    TofReason.OUT_OF_RANGE: "tof out of range",
    TofReason.NO_READING: "tof without reading",
    TofReason.SPIKE: "tof spike",
    TofReason.NO_NEIGHBOURS: "tof without neighbours",
    TofReason.TOO_FAST: "tof too fast for the sensor",
    TofReason.EDGE: "tof straddling an edge",
}


def _nothing(*_: object) -> None: ...


def sources_of(capture: Capture, rig: Rig) -> frozenset[str]:
    """All sources that a capture and a rig have in common."""
    tof = frozenset({TOF_NAME}) if rig.tof is not None and capture.tof() is not None else frozenset()
    # Without any pass the lasers are wanted all the same, so that what is missing is said.
    lasers = LASER_NAMES[: len(rig.sheets)] if capture.laser is not None or not tof else ()
    return tof.union(lasers)


def reconstruct_fused(
    capture: Capture,
    rig: Rig,
    options: ReconstructionOptions | None = None,
    *,
    executor: Executor | None = None,
    report: Report = _nothing,
    checkpoint: Checkpoint = _nothing,
    on_points: OnPoints = _nothing,
) -> Reconstruction:
    """One cloud from all that was measured, in the bed frame, each point with its source and deviation.

    Parameters
    ----------
    options
        Sources that were not measured are an error; `sources_of` says which there are. None takes these.
    executor, report, checkpoint
        As `reconstruct` takes them.
    on_points
        Is given the lasers' points as they are measured, before they are fused.

    Raises
    ------
    CaptureError, RigError, StripeError, WorkerError
        As `reconstruct`; and where the ToF pass or the ToF sensor is wanted and missing.
    CalibrationError
        An alignment that was asked for is not possible.
    """
    options = options or ReconstructionOptions(sources=sources_of(capture, rig))
    start = time.perf_counter()
    unknown = sorted(options.sources - ALL_SOURCES)
    if unknown or not options.sources:
        given = repr(unknown[0]) if unknown else "none"
        raise RigError(f"The sources are laser1, laser2 and tof, not {given}.")
    tof, tof_counts, warnings = PointCloud.empty(), dict[str, int](), list[str]()
    if TOF_NAME in options.sources:
        # Before the lasers, since what is wrong with it shows at once.
        tof, tof_counts, warnings = tof_points(capture, rig)
    lasers = options.sources - {TOF_NAME}
    if not lasers:
        measured = Reconstruction(PointCloud.empty(), frames=0, frames_used=0, problem_count=0)
    else:
        measured = reconstruct(
            capture, rig, replace(options, sources=lasers), executor=executor, report=report, checkpoint=checkpoint,
            on_points=on_points,
        )  # fmt: skip
    settings = _settings(capture, rig, options)
    cloud, tof, alignment = _aligned(measured.cloud, tof, options, max(1.0, 1.25 * max(settings.reach_mm)))
    fused = fuse(cloud, tof, settings)
    warnings += fused.warnings
    if alignment.laser_1 is not None and not alignment.laser_1.determined:
        low, high = alignment.laser_1.indifferent_mm
        warnings.append(
            f"Laser 1 was not moved: shifts from {low:+.1f} to {high:+.1f} mm fit these objects alike, so the thesis's "
            "alignment (4.3) says nothing here."
        )
    whole = fused.cloud
    if options.fill:
        filling = filled_gaps(whole, _gap_mm(settings, whole))
        whole = PointCloud.concatenate([whole, filling])
    return replace(
        measured,
        cloud=whole,
        counts=_counts(measured, fused, whole) | tof_counts,
        warnings=(*measured.warnings, *warnings),
        elapsed_s=time.perf_counter() - start,
        agreement=fused.agreement if len(lasers) == 2 else None,
        alignment=alignment,
        holes=_holes(capture, rig, settings, whole) if lasers and len(whole) else None,
    )


def tof_points(capture: Capture, rig: Rig) -> tuple[PointCloud, dict[str, int], list[str]]:
    """Points of the ToF pass, readings that were left out by reason, and what is to be said about them.

    Raises
    ------
    CaptureError
        There is no ToF pass.
    RigError
        The rig has no ToF sensor.
    """
    samples = capture.tof()
    if samples is None:
        raise CaptureError(f"{capture.path} holds no ToF pass: leave tof out of the sources, or scan it.")
    if rig.tof is None:
        raise RigError(f"Rig {rig.name!r} has no ToF sensor: leave tof out of the sources, or calibrate it.")
    raster = TofRaster(samples.time_s, samples.cart_mm, samples.slide_mm, samples.reading)
    lag_s, warnings = _lag(raster, rig.tof)
    sweeps = tof_sweeps(raster, rig.tof, rig.travel, lag_s=lag_s)
    kept = sweeps.kept
    n = int(kept.sum())
    cloud = PointCloud(
        sweeps.points_mm[kept].astype(np.float32),
        sweeps.sigma_mm[kept].astype(np.float32),
        np.zeros(n, np.float32),
        np.full((n, 3), UNKNOWN_GREY, np.uint8),
        np.full(n, Source.TOF, np.uint8),
    )
    counts = {name: int((sweeps.reason == reason).sum()) for reason, name in _TOF_COUNTS.items()}
    if not n:
        warnings.append("None of the ToF readings can be used: check the sensor's range and its mount.")
    return cloud, {name: number for name, number in counts.items() if number}, warnings


def _lag(raster: TofRaster, mount: TofMount) -> tuple[float, list[str]]:
    """The rig's lag; where it knows none, what the raster itself tells."""
    if mount.lag_s > 0:
        return mount.lag_s, []
    lag_s = estimate_lag(raster, mount)
    if lag_s is None:
        return 0.0, ["The ToF sensor's lag is not known and this raster does not tell it: its edges may be displaced."]
    return lag_s, []


def _settings(capture: Capture, rig: Rig, options: ReconstructionOptions) -> FusionSettings:
    pitch = 0.0
    if capture.laser is not None:
        frames = capture.laser
        if options.every > 1:
            frames = frames.select(range(0, len(frames), options.every))
        pitch = pitch_mm(rig, frames, [i for i, name in enumerate(LASER_NAMES) if name in options.sources])
    line = 1.5
    samples = capture.tof() if TOF_NAME in options.sources else None
    if samples is not None:
        steps = np.abs(np.diff(np.unique(np.round(samples.cart_mm, 6))))
        if len(steps):
            line = float(np.median(steps)) * float(np.linalg.norm(rig.travel))
    line = float(np.clip(1.02 * line, _LEAST_LINE_MM, _MOST_LINE_MM))
    return FusionSettings(point_spacing_mm(rig, pitch), (line, REACH_MM))


def _holes(capture: Capture, rig: Rig, settings: FusionSettings, cloud: PointCloud) -> Holes:
    assert capture.laser is not None
    carts = np.array([frame.cart_mm for frame in capture.laser.frames])
    return holes(cloud, rig, carts, cell_mm=max(_HOLE_CELL_MM, 1.5 * max(settings.reach_mm)))


def _gap_mm(settings: FusionSettings, cloud: PointCloud) -> tuple[float, float]:
    along, across = settings.reach_mm
    if not (cloud.source == Source.TOF).any():
        return along, max(across, along)
    return max(along, settings.tof_reach_mm[0]), max(across, 1.3 * settings.tof_reach_mm[1])


def _aligned(
    lasers: PointCloud, tof: PointCloud, options: ReconstructionOptions, cell_mm: float
) -> tuple[PointCloud, PointCloud, Alignment]:  # fmt: skip
    """The clouds after the alignments that were asked for."""
    if options.alignment == "none":
        return lasers, tof, Alignment()
    shift, motion = None, None
    first, second = (lasers.source == source for source in (Source.LASER_1, Source.LASER_2))
    if first.any() and second.any():
        one, two = (lasers.points_mm[rows].astype(np.float64) for rows in (first, second))
        shift = align_lasers(one, two, cell_mm=cell_mm)
        if shift.determined:
            points = lasers.points_mm.copy()
            points[first, 0] += np.float32(shift.shift_mm)
            lasers = replace(lasers, points_mm=points)
    if len(tof) and len(lasers):
        motion = align_tof(tof.points_mm.astype(np.float64), lasers.points_mm.astype(np.float64), cell_mm=cell_mm)
        tof = replace(tof, points_mm=motion.apply(tof.points_mm).astype(np.float32))
    if shift is None and motion is None:
        raise CalibrationError(
            "The thesis's alignments lay one cloud on another, and there is one alone: add a source.", code="no-overlap"
        )
    return lasers, tof, Alignment(shift, motion)


def _counts(measured: Reconstruction, fused: Fused, whole: PointCloud) -> dict[str, int]:
    """Points per source, then what was left out, by reason."""
    names = {
        Source.LASER_1: "laser1", Source.LASER_2: "laser2", Source.BOTH_LASERS: "both lasers", Source.TOF: "tof",
        Source.FILLED: "filled",
    }  # fmt: skip
    points = {name: int((whole.source == source).sum()) for source, name in names.items()}
    left = {name: number for name, number in measured.counts.items() if name not in LASER_NAMES}
    return {name: number for name, number in points.items() if number} | left | fused.counts
