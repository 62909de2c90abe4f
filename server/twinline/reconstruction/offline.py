"""A whole laser pass at once: capture and rig in, points in the bed frame out."""

import multiprocessing
import os
import time
from collections import Counter, deque
from collections.abc import Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager

import numpy as np

from twinline.errors import WorkerError
from twinline.fusion.cloud import PointCloud, Source
from twinline.fusion.edges import EdgeFilter, EdgeLimits
from twinline.geometry.rig import Rig
from twinline.reconstruction.chunk import ChunkResult, chunk_frames, process_chunk
from twinline.reconstruction.plan import Plan, make_plan, require_stripes
from twinline.reconstruction.result import (
    Checkpoint,
    FrameProblem,
    OnPoints,
    Reconstruction,
    ReconstructionOptions,
    Report,
)
from twinline.reconstruction.spacing import pitch_mm
from twinline.recording.capture import Capture
from twinline.recording.frames import FrameSequence

MOST_PROBLEMS = 100
IN_FLIGHT_PER_CORE = 2
_SPOT_SD_PX = 2.0
"""A usual stripe: its spot is twice that wide to either side on the surface."""


def _nothing(*_: object) -> None: ...


def reconstruct(
    capture: Capture,
    rig: Rig,
    options: ReconstructionOptions | None = None,
    *,
    executor: Executor | None = None,
    report: Report = _nothing,
    checkpoint: Checkpoint = _nothing,
    on_points: OnPoints = _nothing,
) -> Reconstruction:
    """Points of a laser pass as each laser measured them, in the bed frame; `reconstruct_fused` makes one of them.

    Frames are decoded and processed in shares of some dozens; as many shares are under way as keep the executor busy,
    so memory does not grow with the length of the pass, the points themselves apart. The result does not depend on
    the executor.

    Parameters
    ----------
    executor
        Where the shares are processed; None makes a pool of processes on all cores for this call.
    report
        Called with (frames done, frames) from the calling thread.
    checkpoint
        Called between shares; may raise `CancelledError`, or block.
    on_points
        Called with the points of each share, in the order of the frames.

    Raises
    ------
    CaptureError, RigError, StripeError
        If the pass cannot be reconstructed; see `make_plan`. A single broken frame is no error: it is counted.
    WorkerError
        A worker process died.
    """
    options = options or ReconstructionOptions()
    start = time.perf_counter()
    plan, frames = make_plan(capture, rig, options)
    shares = frames.chunks(chunk_frames(plan, frames))
    report(0, len(frames))
    account = _Account()
    clouds: list[PointCloud] = []
    edges = EdgeFilter(_edge_limits(plan, frames), len(plan.lasers))
    done = 0
    with _executor(executor, len(shares)) as pool:
        for share, result in zip(shares, _run(pool, plan, frames, capture.reference, shares, checkpoint), strict=True):
            account.add(result)
            fresh = PointCloud.concatenate([c for frame in result.frames for c in edges.add(frame)])
            clouds.append(fresh)
            done += len(share)
            on_points(fresh)
            report(done, len(frames))
    clouds.append(PointCloud.concatenate(edges.finish()))
    on_points(clouds[-1])
    cloud = PointCloud.concatenate(clouds)
    require_stripes(len(cloud), len(frames), frames.source, account.problems)
    return Reconstruction(
        cloud=cloud,
        frames=len(frames),
        frames_used=account.frames_used,
        problem_count=account.problem_count,
        problems=tuple(account.problems),
        counts=account.counts(cloud, edges.rejected),
        warnings=_warnings(plan, rig),
        elapsed_s=time.perf_counter() - start,
        channel=plan.settings.channel,
        noise=plan.noise,
    )


class _Account:
    """What became of the frames and columns of a pass."""

    def __init__(self) -> None:
        self.frames_used = 0
        self.problem_count = 0
        self.problems: list[FrameProblem] = []
        self._left_out: Counter[str] = Counter()

    def add(self, result: ChunkResult) -> None:
        self.frames_used += sum(len(frame.cloud) > 0 for frame in result.frames)
        self.problem_count += result.problem_count
        self.problems.extend(result.problems[: MOST_PROBLEMS - len(self.problems)])
        self._left_out.update(result.counts)

    def counts(self, cloud: PointCloud, edge: int) -> dict[str, int]:
        """Points per source, then what was left out, by reason."""
        kept = {
            name: int((cloud.source == source).sum()) for name, source in _SOURCES if (cloud.source == source).any()
        }
        return {**kept, **dict(sorted(self._left_out.items())), "straddling an edge": edge}


_SOURCES = (("laser1", Source.LASER_1), ("laser2", Source.LASER_2))


def _edge_limits(plan: Plan, frames: FrameSequence) -> EdgeLimits:
    """Limits of the edge filter from the pitch and the image scale at the bed."""
    rig = plan.rig
    pitch = pitch_mm(rig, frames, plan.lasers)
    depth = float(rig.bed_from_camera.translation_mm[2])
    focal = rig.camera.fy if rig.stripe_runs == "along-u" else rig.camera.fx
    baseline = min(abs(rig.sheets[k].baseline_mm) for k in plan.lasers)
    return EdgeLimits.for_scan(
        pitch_mm=pitch, spot_sd_mm=_SPOT_SD_PX * depth / focal, px_per_mm_height=baseline * focal / depth**2
    )


def _warnings(plan: Plan, rig: Rig) -> tuple[str, ...]:
    warnings = []
    if rig.sources and all(source == "nominal" for source in rig.sources.values()):
        warnings.append("The rig is nominal, not calibrated: expect errors of millimetres.")
    if len(plan.drift.cart_mm):
        shift = float(np.median(plan.drift.shift_px))
        warnings.append(
            f"The bed beside the object lies {shift:+.2f} px from where the reference pass saw it; heights count from "
            "the bed as seen in this pass."
        )
    return tuple(warnings)


def _run(
    pool: Executor,
    plan: Plan,
    frames: FrameSequence,
    reference: FrameSequence | None,
    shares: list[range],
    checkpoint: Checkpoint,
) -> Iterator[ChunkResult]:
    """Results of the shares in order, with a bounded number under way."""
    waiting: deque[Future[ChunkResult]] = deque()
    todo = iter(shares)
    most = IN_FLIGHT_PER_CORE * (os.cpu_count() or 1)
    try:
        while True:
            while len(waiting) < most and (share := next(todo, None)) is not None:
                part = frames.select(share)
                beside = reference.select([f.index for f in part.frames]) if reference is not None else None
                waiting.append(pool.submit(process_chunk, plan, part, beside))
            if not waiting:
                return
            checkpoint()
            yield waiting.popleft().result()
    except BrokenProcessPool as error:
        raise WorkerError(
            "A worker process died while reconstructing, most likely for lack of memory: use fewer workers."
        ) from error
    finally:
        for future in waiting:
            future.cancel()


@contextmanager
def _executor(given: Executor | None, shares: int) -> Iterator[Executor]:
    if given is not None:
        yield given
        return
    workers = max(1, min(os.cpu_count() or 1, shares))
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
