"""The job that turns a capture into a scan: a cloud in files, and on the stage while it grows."""

from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

import twinline
from twinline.errors import CancelledError, InputError
from twinline.fusion.cloud import PointCloud
from twinline.geometry.rig import Rig
from twinline.geometry.rig_json import rig_id
from twinline.operations.captures import CaptureRecord, CaptureShelf
from twinline.operations.clock import Clock
from twinline.operations.display import CloudDisplay
from twinline.operations.exports.provenance import Provenance
from twinline.operations.runner import JobContext
from twinline.operations.scans import RigOrigin, Scan, ScanShelf, Vector
from twinline.operations.toolbox import Toolbox
from twinline.reconstruction.result import Reconstruction, ReconstructionOptions
from twinline.recording.capture import Capture

RigChoice = Literal["auto", "nominal"]
MAX_EVERY = 100_000
VIEW_INTERVAL_S = 0.5
"""The growing cloud's figures are told to listeners at most this often."""


@dataclass(frozen=True)
class ReconstructRequest:
    """What to reconstruct, and how.

    Attributes
    ----------
    rig
        "auto" takes the first of: `rig_path`, the rig given for the capture, the capture's own rig.json, the
        nominal rig. "nominal" takes the nominal rig.
    rig_path
        A rig.json of this machine.
    """

    capture_id: str
    rig: RigChoice = "auto"
    rig_path: Path | None = None
    options: ReconstructionOptions = field(default_factory=ReconstructionOptions)

    def check(self, methods: tuple[str, ...]) -> None:
        """Refuse what cannot be done.

        Raises
        ------
        InputError
            Naming the field, what it may be, and what it is.
        """
        options = self.options
        if options.method not in methods:
            raise InputError(f"method is {options.method!r}; choose one of {', '.join(methods)}.")
        if not options.sources or not options.sources <= {"laser1", "laser2"}:
            given = ", ".join(sorted(options.sources)) or "empty"
            raise InputError(f"sources is {given}; name laser1, laser2 or both.")
        if not 1 <= options.every <= MAX_EVERY:
            raise InputError(f"every is {options.every}; it must be from 1 (each frame) to {MAX_EVERY}.")
        if self.rig == "nominal" and self.rig_path is not None:
            raise InputError('rig is "nominal" but rig_path is given too; leave out one of them.')


@dataclass(frozen=True)
class Bench:
    """Where a reconstruction works: its inputs, tools, processes, and where the results go.

    Attributes
    ----------
    view_changed
        Called now and then while the shown cloud grows.
    """

    captures: CaptureShelf
    scans: ScanShelf
    display: CloudDisplay
    toolbox: Toolbox
    workers: Executor
    clock: Clock
    view_changed: Callable[[], None]

    def reconstruct(self, context: JobContext, request: ReconstructRequest) -> Scan:
        """Do the whole job; the scan is kept, or nothing of it.

        Raises
        ------
        TwinlineError
            Whatever makes it impossible.
        """
        record = self.captures.get(request.capture_id)
        context.phase("Opening")
        capture = self.toolbox.open_capture(record.path)
        rig, origin = self._choose_rig(record, capture, request)
        context.phase("Reconstructing")
        self.display.begin(job_id=context.job_id)
        scan_id, folder = self.scans.new_folder()
        try:
            result = self.toolbox.reconstruct(
                capture,
                rig,
                request.options,
                executor=self.workers,
                report=context.report,
                checkpoint=context.checkpoint,
                on_points=self._grow(),
            )
            context.phase("Writing", unit="files")
            self._write(context, folder, result.cloud, rig, record)
            scan = self._describe(scan_id, context.job_id, record, request, rig, origin, result)
            self.scans.keep(scan)
        except BaseException as error:
            self.scans.discard(scan_id)
            if isinstance(error, CancelledError):
                self.display.clear()
            raise
        self.display.finish(scan_id=scan_id)
        return scan

    def _grow(self) -> Callable[[PointCloud], None]:
        told_s = float("-inf")

        def grow(cloud: PointCloud) -> None:
            nonlocal told_s
            self.display.append(cloud)
            now_s = self.clock.monotonic_s()
            if now_s - told_s >= VIEW_INTERVAL_S:
                told_s = now_s
                self.view_changed()

        return grow

    def _choose_rig(
        self, record: CaptureRecord, capture: Capture, request: ReconstructRequest
    ) -> tuple[Rig, RigOrigin]:
        candidates: list[tuple[Path | None, RigOrigin]] = []
        if request.rig == "auto":
            candidates = [(request.rig_path, "given"), (self.captures.given_rig(record.id), "uploaded")]
        for path, origin in candidates:
            if path is not None:
                return self.toolbox.read_rig(path), origin
        own = capture.own_rig() if request.rig == "auto" else None
        if own is not None:
            return own, "capture"
        return capture.rig(), "nominal"

    def _write(self, context: JobContext, folder: Path, cloud: PointCloud, rig: Rig, record: CaptureRecord) -> None:
        provenance = Provenance(rig_id(rig), record.name, twinline.__version__)
        for done, (name, write) in enumerate(self.toolbox.writers.items()):
            context.report(done, len(self.toolbox.writers))
            context.checkpoint()
            write(folder / name, cloud, provenance)
        context.report(len(self.toolbox.writers), len(self.toolbox.writers))

    def _describe(
        self,
        scan_id: str,
        job_id: str,
        record: CaptureRecord,
        request: ReconstructRequest,
        rig: Rig,
        origin: RigOrigin,
        result: Reconstruction,
    ) -> Scan:
        cloud, options = result.cloud, request.options
        return Scan(
            id=scan_id,
            name=record.name,
            job_id=job_id,
            capture_id=record.id,
            created_at=self.clock.now(),
            points=len(cloud),
            frames=result.frames,
            frames_used=result.frames_used,
            problem_count=result.problem_count,
            problems=result.problems,
            counts=result.counts,
            warnings=result.warnings,
            elapsed_s=result.elapsed_s,
            method=options.method,
            sources=tuple(sorted(options.sources)),
            every=options.every,
            rig_name=rig.name,
            rig_origin=origin,
            bounds_mm=_bounds(cloud),
            median_sigma_mm=_median(cloud),
            software_version=twinline.__version__,
        )


def outcome(scan: Scan) -> Mapping[str, Any]:
    """What a finished job says of its scan."""
    return {"scan_id": scan.id, "points": scan.points}


def _bounds(cloud: PointCloud) -> tuple[Vector, Vector] | None:
    points = cloud.points_mm[np.isfinite(cloud.points_mm).all(axis=1)]
    if not len(points):
        return None
    low, high = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])


def _median(cloud: PointCloud) -> float | None:
    known = cloud.sigma_mm[np.isfinite(cloud.sigma_mm)]
    return float(np.median(known)) if len(known) else None
