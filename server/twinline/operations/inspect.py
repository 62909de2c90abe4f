"""Inspecting a cloud or a mesh, alone or against another: files in, a report out."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from twinline.arrays import BoolArray, FloatArray
from twinline.errors import InputError
from twinline.operations.compare import CompareOptions, Comparison, compare
from twinline.operations.geometry_file import Geometry, read_geometry
from twinline.operations.measurements import Finding, measure


@dataclass(frozen=True, eq=False)
class Inspection:
    """All that was found.

    Attributes
    ----------
    points_mm : (n, 3) array
        Points of A.
    measured
        How many of them have a measurement.
    findings
    comparison : Comparison or None
    warnings
        What the reader should know of the files.
    """

    points_mm: FloatArray
    measured: int
    findings: tuple[Finding, ...]
    comparison: Comparison | None
    warnings: tuple[str, ...] = field(default=())


def inspect_files(
    scan: Path, reference: Path | None, measurements: list[str], boxes: list[FloatArray], options: CompareOptions
) -> Inspection:
    """Read, measure and compare.

    Parameters
    ----------
    measurements
        As `measure` takes them; the flatness of the whole if neither this nor a reference is given.
    boxes : list of (3, 2) arrays
        Regions: low and high of x, y and z, mm.

    Raises
    ------
    InputError
        In one sentence that names the file and the cause.
    """
    given = read_geometry(scan)
    finite = np.asarray(np.isfinite(given.points).all(axis=1), dtype=bool)
    if not finite.any():
        raise InputError(f"{scan} has no point with a measurement; make the scan again.", code="too-few-points")
    warnings = []
    if not finite.all():
        warnings.append(f"{scan} has {int((~finite).sum())} of {len(finite)} points without a measurement; left out")
    regions = [_in_box(given.points, box) for box in boxes]
    findings = [measure(name, given.points, given.sigma_mm, regions) for name in measurements]
    comparison = None
    if reference is not None:
        seen = given
        if regions:
            inside = np.asarray(np.stack(regions).any(axis=0))
            seen = Geometry(np.where(inside[:, None], given.points, np.nan), given.sigma_mm, None, given.unit)
        comparison, more = compare(seen, read_geometry(reference), options, str(reference))
        warnings += more
    elif not findings:
        findings.append(measure("plane", given.points, given.sigma_mm, regions))
    return Inspection(given.points, int(finite.sum()), tuple(findings), comparison, tuple(warnings))


def _in_box(points: FloatArray, box: FloatArray) -> BoolArray:
    with np.errstate(invalid="ignore"):
        return np.asarray(((points >= box[:, 0]) & (points <= box[:, 1])).all(axis=1))
