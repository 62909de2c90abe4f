"""A scan beside its reference: the unit, the alignment, the deviations, the verdict."""

from dataclasses import dataclass

import numpy as np

from twinline.arrays import BoolArray, FloatArray, IntArray
from twinline.errors import InputError
from twinline.fusion.inspection.alignment import Alignment, align_to_cloud
from twinline.fusion.inspection.deviation import (
    Deviation,
    ToleranceCheck,
    check_tolerance,
    deviation_from_cloud,
    deviation_from_mesh,
)
from twinline.fusion.inspection.nearest import MeshSurface
from twinline.fusion.inspection.placing import place_on_mesh
from twinline.fusion.inspection.rigid import RigidMotion
from twinline.fusion.inspection.units import UNITS_MM, guess_unit
from twinline.fusion.mesh import TriangleMesh, wholeness
from twinline.operations.geometry_file import Geometry

ALIGNMENTS = ("search", "near", "none")
_REACH_SHARE = 0.05
_LIKELY_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class Comparison:
    """A laid on B.

    Attributes
    ----------
    deviation
        Of each point of A.
    alignment : Alignment or None
        None where A was compared as it lies.
    tolerance : ToleranceCheck or None
    reference
        ``mesh`` or ``cloud``.
    unit
        In which B's numbers were taken.
    motion
        From A's frame to B's.
    """

    deviation: Deviation
    alignment: Alignment | None
    tolerance: ToleranceCheck | None
    reference: str
    unit: str
    motion: RigidMotion


@dataclass(frozen=True)
class CompareOptions:
    """How A is compared with B.

    Attributes
    ----------
    align
        One of `ALIGNMENTS`: ``search`` from anywhere, ``near`` from where they lie, ``none``.
    unit
        ``auto`` or one of `UNITS_MM`, of B where its format does not say it.
    tolerance_mm : (low, high) or None
    reach_mm
        Points further from B than this are not compared; None takes what the sizes suggest.
    bed_mm
        Points of A below this height are left out; None leaves out nothing.
    """

    align: str = "search"
    unit: str = "auto"
    tolerance_mm: tuple[float, float] | None = None
    reach_mm: float | None = None
    bed_mm: float | None = None


def compare(scan: Geometry, reference: Geometry, options: CompareOptions, name: str) -> tuple[Comparison, list[str]]:
    """Lay a scan on a mesh or another cloud and measure how far it lies off.

    Parameters
    ----------
    name
        Of the reference, for messages.

    Returns
    -------
    Comparison, list of str
        And what was noticed of the reference.

    Raises
    ------
    InputError
        If an option is wrong, the sizes do not fit each other, or too few points can be compared.
    """
    if options.align not in ALIGNMENTS:
        raise InputError(f"--align {options.align}: choose one of {', '.join(ALIGNMENTS)}.")
    points = np.asarray(scan.points, dtype=np.float64)
    rows = np.flatnonzero(np.isfinite(points).all(axis=1) & _off_bed(points, options.bed_mm))
    if len(rows) < 50:
        raise InputError(
            f"Only {len(rows)} points of the scan are left to compare; check the region and --bed.",
            code="too-few-points",
        )
    factor, unit, warnings = _unit(points[rows], reference, options.unit, name)
    sigma = None if scan.sigma_mm is None else np.asarray(scan.sigma_mm)
    kept = np.full_like(points, np.nan)
    kept[rows] = points[rows]
    if reference.mesh is None:
        comparison = _with_cloud(kept, rows, reference.points * factor, options, sigma, unit)
    else:
        whole = wholeness(reference.mesh)
        if not whole.watertight:
            warnings.append(
                f"{name} is not watertight ({whole.open_edges} open edges, {whole.crowded_edges} with more than two "
                f"triangles, {whole.twisted_edges} twisted): inside and outside follow its triangles' own direction"
            )
        mesh = TriangleMesh(reference.mesh.vertices_mm * factor, reference.mesh.faces)
        comparison = _with_mesh(kept, rows, MeshSurface(mesh), options, sigma, unit)
    share = float(comparison.deviation.compared.sum()) / len(rows)
    if share < _LIKELY_SHARE:
        warnings.append(
            f"only {100 * share:.0f} % of the scan's points lie near {name}; the figures hold for those alone, "
            "so check that both show the same object"
        )
    return comparison, warnings


def _off_bed(points: FloatArray, bed_mm: float | None) -> BoolArray:
    if bed_mm is None:
        return np.ones(len(points), dtype=bool)
    with np.errstate(invalid="ignore"):
        return np.asarray(points[:, 2] > bed_mm)


def _unit(points: FloatArray, reference: Geometry, wanted: str, name: str) -> tuple[float, str, list[str]]:
    if reference.unit is not None:
        return 1.0, reference.unit, []
    if wanted != "auto":
        if wanted not in UNITS_MM:
            raise InputError(f"--unit {wanted}: choose auto or one of {', '.join(UNITS_MM)}.")
        return UNITS_MM[wanted], wanted, []
    finite = reference.points[np.isfinite(reference.points).all(axis=1)]
    if len(finite) < 3:
        raise InputError(f"{name} has no corner that is finite; export it again.", code="bad-geometry")
    guess = guess_unit(points, finite)
    if not guess.likely:
        raise InputError(
            f"{name} fits the scan in no unit: the scan is {guess.ratio:.3g} times as large as its numbers; "
            f"leave out the bed (--bed), or say the unit (--unit {', '.join(UNITS_MM)}).",
            code="bad-unit",
        )
    warnings = []
    if guess.unit != "mm":
        said = {"m": "metres", "inch": "inches"}[guess.unit]
        warnings.append(
            f"{name} was taken to be in {said}, since the scan is {guess.ratio:.4g} times as large as its numbers; "
            "say --unit if that is wrong"
        )
    return guess.factor, guess.unit, warnings


def _with_mesh(
    kept: FloatArray,
    rows: IntArray,
    surface: MeshSurface,
    options: CompareOptions,
    sigma: FloatArray | None,
    unit: str,
) -> Comparison:
    alignment = None
    if options.align != "none":
        alignment = place_on_mesh(kept[rows], surface, search=options.align == "search")
    motion = alignment.motion if alignment else RigidMotion.none()
    size = float(np.linalg.norm(np.ptp(surface.mesh.vertices_mm, axis=0)))
    deviation = deviation_from_mesh(
        kept,
        surface,
        motion=motion,
        alignment_sigma_mm=alignment.sigma_mm if alignment else 0.0,
        sigma_mm=sigma,
        reach_mm=options.reach_mm if options.reach_mm is not None else _REACH_SHARE * size,
    )
    return _comparison(deviation, alignment, options, "mesh", unit, motion)


def _with_cloud(
    kept: FloatArray,
    rows: IntArray,
    reference: FloatArray,
    options: CompareOptions,
    sigma: FloatArray | None,
    unit: str,
) -> Comparison:
    finite = reference[np.isfinite(reference).all(axis=1)]
    alignment = None
    if options.align != "none":
        size = float(np.linalg.norm(np.ptp(finite, axis=0)))
        # From afar every point has a neighbour; at the end only what lies near may count.
        first = align_to_cloud(kept[rows], finite)
        alignment = align_to_cloud(kept[rows], finite, start=first.motion, reach_mm=_REACH_SHARE * size)
    motion = alignment.motion if alignment else RigidMotion.none()
    deviation = deviation_from_cloud(
        kept,
        finite,
        motion=motion,
        alignment_sigma_mm=alignment.sigma_mm if alignment else 0.0,
        sigma_mm=sigma,
        reach_mm=options.reach_mm,
    )
    return _comparison(deviation, alignment, options, "cloud", unit, motion)


def _comparison(
    deviation: Deviation,
    alignment: Alignment | None,
    options: CompareOptions,
    kind: str,
    unit: str,
    motion: RigidMotion,
) -> Comparison:
    tolerance = None
    if options.tolerance_mm is not None:
        tolerance = check_tolerance(deviation, *options.tolerance_mm)
    return Comparison(deviation, alignment, tolerance, kind, unit, motion)
