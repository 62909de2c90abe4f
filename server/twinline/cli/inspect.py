"""``twinline inspect``."""

import json as json_text
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import typer

from twinline import __version__
from twinline.arrays import FloatArray
from twinline.errors import InputError, OutputError
from twinline.fusion.cloud import PointCloud, Source
from twinline.fusion.inspection.deviation import deviation_colours
from twinline.fusion.inspection.quantity import Quantity
from twinline.operations.compare import CompareOptions, Comparison
from twinline.operations.exports.glb import write_glb
from twinline.operations.exports.ply import write_ply
from twinline.operations.exports.provenance import Provenance
from twinline.operations.inspect import Inspection, inspect_files
from twinline.operations.measurements import Finding


@dataclass(frozen=True)
class InspectRequest:
    """The options of the command."""

    scan: Path
    reference: Path | None
    measurements: tuple[str, ...]
    regions: tuple[str, ...]
    align: str
    unit: str
    tolerance: str
    reach_mm: float | None
    bed_mm: float | None
    output: Path | None
    indices: bool
    json: bool


def run_inspect(request: InspectRequest) -> None:
    """Measure a cloud, compare it with a reference, and write the deviations as colours."""
    if request.output is not None and request.output.suffix.lower() not in (".ply", ".glb"):
        raise OutputError(f"{request.output}: the deviations are written as .ply or .glb; choose one of these endings.")
    if request.output is not None and request.reference is None:
        raise InputError("--output writes deviations from a reference; give the reference too.")
    limits = _numbers(request.tolerance, "--tolerance", (1, 2)) if request.tolerance else None
    tolerance = None if limits is None else (-limits[0], limits[0]) if len(limits) == 1 else (limits[0], limits[1])
    found = inspect_files(
        request.scan,
        request.reference,
        list(request.measurements),
        [_box(text) for text in request.regions],
        CompareOptions(request.align, request.unit, tolerance, request.reach_mm, request.bed_mm),
    )
    for warning in found.warnings:
        typer.echo(f"twinline: {warning}.", err=True)
    if request.output is not None and found.comparison is not None:
        _write(request, found.points_mm, found.comparison)
    typer.echo(_as_json(request, found) if request.json else "\n".join(_lines(request, found)))


def _numbers(text: str, option: str, counts: tuple[int, ...]) -> list[float]:
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in counts or not all(math.isfinite(value) for value in values):
        wanted = " or ".join(str(count) for count in counts)
        raise InputError(f"{option} {text}: give {wanted} numbers in mm, with commas between them.")
    return values


def _box(text: str) -> FloatArray:
    """Low and high of x, y, z, (3, 2); without z it takes in every height."""
    values = _numbers(text, "--region", (4, 6))
    box = np.array([*values, *((-np.inf, np.inf) if len(values) == 4 else ())]).reshape(3, 2)
    if (box[:, 0] >= box[:, 1]).any():
        raise InputError(
            f"--region {text} is empty: give xmin,xmax,ymin,ymax[,zmin,zmax] with each low before its high."
        )
    return box


def _write(request: InspectRequest, points_mm: FloatArray, comparison: Comparison) -> None:
    deviation = comparison.deviation
    kept = deviation.compared
    tolerance = comparison.tolerance
    limit = max(abs(tolerance.low_mm), abs(tolerance.high_mm)) if tolerance else max(deviation.p95_mm, 1e-6)
    values = deviation.signed_mm[kept]
    cloud = PointCloud(
        comparison.motion.apply(points_mm[kept]).astype(np.float32),
        np.full(len(values), deviation.sigma_mm, np.float32),
        values.astype(np.float32),
        deviation_colours(values, limit),
        np.full(len(values), int(Source.FILLED), np.uint8),
        deviation.normals[kept].astype(np.float32),
    )
    provenance = Provenance(
        f"deviation from {request.reference}, full colour at {limit:.4g} mm", str(request.scan), __version__
    )
    if request.output is not None:
        writer = write_ply if request.output.suffix.lower() == ".ply" else write_glb
        writer(request.output, cloud, provenance)


def _as_json(request: InspectRequest, found: Inspection) -> str:
    report: dict[str, Any] = {
        "scan": str(request.scan),
        "points": len(found.points_mm),
        "measured": found.measured,
        "findings": [_finding(one, indices=request.indices) for one in found.findings],
        "warnings": list(found.warnings),
    }
    if found.comparison is not None:
        report["comparison"] = _comparison(request, found.comparison)
    return json_text.dumps(report, indent=1, allow_nan=False)


def _finding(one: Finding, *, indices: bool) -> dict[str, Any]:
    report = {
        "name": one.name,
        "quantities": {name: _quantity(quantity) for name, quantity in one.quantities.items()},
        "details": one.details,
        "points_used": len(one.used),
    }
    return report | {"used": one.used.tolist()} if indices else report


def _quantity(quantity: Quantity) -> dict[str, Any]:
    # JSON knows no NaN.
    sigma = quantity.sigma if math.isfinite(quantity.sigma) else None
    return {"value": quantity.value, "sigma": sigma, "unit": quantity.unit}


def _comparison(request: InspectRequest, found: Comparison) -> dict[str, Any]:
    deviation, alignment, tolerance = found.deviation, found.alignment, found.tolerance
    report: dict[str, Any] = {
        "reference": str(request.reference),
        "kind": found.reference,
        "unit": found.unit,
        "compared": int(deviation.compared.sum()),
        "mean_mm": deviation.mean_mm,
        "rms_mm": deviation.rms_mm,
        "p95_mm": deviation.p95_mm,
        "percentiles_mm": {f"{p:g}": value for p, value in deviation.percentiles_mm().items()},
        "sigma_mm": deviation.sigma_mm,
        "rotation": found.motion.rotation.tolist(),
        "translation_mm": found.motion.translation_mm.tolist(),
        "output": None if request.output is None else str(request.output),
    }
    if alignment is not None:
        report["alignment"] = {
            "rms_mm": alignment.rms_mm,
            "points_used": int(alignment.used.sum()),
            "held": list(alignment.held),
            "angle_deg": alignment.motion.angle_deg,
            "sigma_mm": alignment.sigma_mm,
        }
    if tolerance is not None:
        report["tolerance"] = {
            "low_mm": tolerance.low_mm,
            "high_mm": tolerance.high_mm,
            "verdict": tolerance.verdict,
            "inside": tolerance.inside,
            "worst_low_mm": tolerance.worst_low_mm,
            "worst_high_mm": tolerance.worst_high_mm,
            "uncertainty_mm": tolerance.uncertainty_mm,
        }
    return report


def _lines(request: InspectRequest, found: Inspection) -> list[str]:
    lines = [f"{request.scan}: {found.measured} points"]
    for one in found.findings:
        lines += [f"{one.name} from {len(one.used)} points"]
        lines += [f"  {name.replace('_', ' '):16} {quantity}" for name, quantity in one.quantities.items()]
    if found.comparison is not None:
        lines += _comparison_lines(request, found.comparison)
    return lines


def _comparison_lines(request: InspectRequest, found: Comparison) -> list[str]:
    deviation, alignment, tolerance = found.deviation, found.alignment, found.tolerance
    lines = [f"against {request.reference} ({found.reference}, {found.unit}): {int(deviation.compared.sum())} points"]
    if alignment is not None:
        turn, shift = alignment.motion.angle_deg, float(np.linalg.norm(alignment.motion.translation_mm))
        lines += [f"  aligned          turned {turn:.3f}°, moved {shift:.3f} mm, rms {alignment.rms_mm:.4f} mm"]
        if alignment.held:
            lines += [f"  not shown, held  {', '.join(alignment.held)}"]
    lines += [f"  mean, rms, 95 %  {deviation.mean_mm:+.4f}, {deviation.rms_mm:.4f}, {deviation.p95_mm:.4f} mm"]
    percentiles = ", ".join(f"{p:g} %: {value:+.4f}" for p, value in deviation.percentiles_mm().items())
    lines += [f"  percentiles      {percentiles}"]
    if tolerance is not None:
        lines.append(
            f"  tolerance        {tolerance.low_mm:+g} to {tolerance.high_mm:+g} mm: {tolerance.verdict}, "
            f"{100 * tolerance.inside:.2f} % inside, 99.7 % within {tolerance.worst_low_mm:+.4f} to "
            f"{tolerance.worst_high_mm:+.4f} mm (± {tolerance.uncertainty_mm:.4f})"
        )
    return lines + ([] if request.output is None else [f"  written to       {request.output}"])
