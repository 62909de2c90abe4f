"""``twinline reconstruct``."""

import json
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from types import MappingProxyType

import numpy as np
import typer

from twinline import __version__
from twinline.cli.progress import progress
from twinline.errors import InputError, OutputError, StripeError
from twinline.fusion.cloud import PointCloud
from twinline.geometry.rig import Rig
from twinline.geometry.rig_json import rig_id
from twinline.operations.exports.atomic import atomic_path
from twinline.operations.exports.glb import write_glb
from twinline.operations.exports.ply import write_ply
from twinline.operations.exports.provenance import Provenance
from twinline.reconstruction.fused import reconstruct_fused, sources_of
from twinline.reconstruction.result import ALIGNMENTS, Reconstruction, ReconstructionOptions
from twinline.recording.capture import Capture, open_capture
from twinline.recording.rig_file import read_rig
from twinline.stripe.model import CHANNELS, METHODS

ALL = frozenset({"all"})
"""Sources: whatever was measured."""


@dataclass(frozen=True)
class ReconstructRequest:
    """The options of the command."""

    capture: Path
    output: Path
    rig: Path | None
    method: str
    channel: str
    sources: frozenset[str]
    every: int
    ascii: bool
    workers: int | None
    json: bool
    align: str = "none"
    fill: bool = False

    def options(self) -> ReconstructionOptions:
        """As the reconstruction takes them; "all" sources are not resolved yet."""
        if self.method not in METHODS:
            raise StripeError(f"--method {self.method}: choose one of {', '.join(METHODS)}.")
        if self.channel not in CHANNELS:
            raise StripeError(f"--channel {self.channel}: choose one of {', '.join(CHANNELS)}.")
        if not self.sources:
            raise InputError("--sources is empty: name some of laser1, laser2 and tof, or all.")
        if self.align not in ALIGNMENTS:
            raise InputError(f"--align {self.align}: choose one of {', '.join(ALIGNMENTS)}.")
        return ReconstructionOptions(self.method, self.sources, self.every, self.channel, self.align, self.fill)


def run_reconstruct(request: ReconstructRequest, about: Mapping[str, object] = MappingProxyType({})) -> None:
    """Reconstruct a capture and write its cloud.

    Parameters
    ----------
    about
        What the summary for machines says besides.
    """
    options = request.options()
    if request.output.suffix.lower() not in (".ply", ".glb"):
        raise OutputError(f"{request.output}: the cloud is written as .ply or .glb; choose one of these endings.")
    capture = open_capture(request.capture)
    rig = choose_rig(capture, request.rig)
    if options.sources == ALL:
        options = replace(options, sources=sources_of(capture, rig))
    # Opened before the work, so that a path that cannot be written costs no minutes.
    with atomic_path(request.output) as target:
        result = _reconstruct(request, capture, rig, options)
        try:
            _write(target, result.cloud, Provenance(rig_id(rig), capture.info.name, __version__), ascii=request.ascii)
        except OutputError as error:
            # The temporary name means nothing to whoever reads the message.
            raise OutputError(error.detail.replace(str(target), str(request.output)), code=error.code) from error
    _tell(request, capture, rig, result, about)


def _write(target: Path, cloud: PointCloud, provenance: Provenance, *, ascii: bool) -> None:
    if target.suffix.lower() == ".ply":
        write_ply(target, cloud, provenance, ascii=ascii)
    else:
        write_glb(target, cloud, provenance)


def choose_rig(capture: Capture, given: Path | None) -> Rig:
    """The given rig, else the one that came with the capture, else the nominal one."""
    if given is not None:
        return read_rig(given)
    return capture.own_rig() or capture.rig()


def _reconstruct(
    request: ReconstructRequest, capture: Capture, rig: Rig, options: ReconstructionOptions
) -> Reconstruction:
    pool = (
        ProcessPoolExecutor(request.workers, mp_context=get_context("spawn"))
        if request.workers is not None
        else nullcontext()
    )
    with progress("Frames", quiet=request.json) as report, pool as executor:
        return reconstruct_fused(capture, rig, options, executor=executor, report=report)


def _beside(result: Reconstruction) -> dict[str, object]:
    """What the fusion has to say besides the cloud."""
    told: dict[str, object] = {}
    if result.agreement is not None and result.agreement.places:
        agreement = result.agreement
        told["lasers_apart_mm"] = {
            "offset": agreement.offset_mm, "scatter": agreement.scatter_mm, "places": agreement.places,
        }  # fmt: skip
    if result.holes is not None:
        told["holes_mm2"] = {cause.name.lower(): area for cause, area in result.holes.areas_mm2().items()}
        told["hint"] = result.holes.hint()
    for name, trace in (("laser1", result.alignment.laser_1), ("tof", result.alignment.tof)):
        if trace is not None:
            told.setdefault("alignment", {})
            found = told["alignment"]
            assert isinstance(found, dict)
            found[name] = {
                "shift_mm": np.asarray(trace.shift_mm).tolist(), "before_mm": trace.before_mm,
                "after_mm": trace.after_mm, "values": np.asarray(trace.trace.values).tolist(),
            }  # fmt: skip
    return told


def _tell(
    request: ReconstructRequest, capture: Capture, rig: Rig, result: Reconstruction, about: Mapping[str, object]
) -> None:
    cloud = result.cloud
    for warning in (*capture.problems, *result.warnings):
        typer.echo(f"twinline: {warning}", err=True)
    if result.problem_count:
        first = result.problems[0]
        typer.echo(
            f"twinline: {result.problem_count} of {result.frames} frames gave no points; the first is {first.frame}: "
            f"{first.reason}.",
            err=True,
        )
    low, high = cloud.points_mm.min(axis=0), cloud.points_mm.max(axis=0)
    sigma = float(np.median(cloud.sigma_mm))
    if request.json:
        summary = {
            **about,
            "output": str(request.output),
            "rig": rig.name,
            "rig_id": rig_id(rig),
            "points": len(cloud),
            "frames": result.frames,
            "frames_used": result.frames_used,
            "problem_count": result.problem_count,
            "problems": [{"frame": p.frame, "reason": p.reason} for p in result.problems],
            "counts": result.counts,
            "warnings": list(result.warnings),
            **_beside(result),
            "channel": result.channel,
            "noise": {
                "read_dn": result.noise.read_dn,
                # JSON knows no infinity.
                "electrons_per_dn": result.noise.electrons_per_dn
                if np.isfinite(result.noise.electrons_per_dn)
                else None,
                "speckle": result.noise.speckle,
            },
            "low_mm": low.tolist(),
            "high_mm": high.tolist(),
            "median_sigma_mm": sigma,
            "elapsed_s": result.elapsed_s,
        }
        typer.echo(json.dumps(summary, indent=1))
        return
    size = " x ".join(f"{v:.1f}" for v in high - low)
    typer.echo(
        f"{len(cloud)} points from {result.frames_used} of {result.frames} frames, {size} mm, median sigma "
        f"{sigma:.3f} mm, in {result.elapsed_s:.1f} s: {request.output}"
    )
