"""Arrays of a calibration made small: histograms, maps, profiles, runs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinline.arrays import FloatArray
from twinline.calibration.joint_model import Scanner
from twinline.calibration.joint_types import KINDS
from twinline.calibration.scanner import ScannerResult
from twinline.calibration.scanner_evidence import REJECTED_WEIGHT, ScannerEvidence
from twinline.calibration.thesis_align import LaserShift, TofAlignment
from twinline.calibration.thesis_fit import SheetFit
from twinline.calibration.thesis_simplex import NelderMeadTrace
from twinline.operations.calibrate_thesis import ThesisOutcome, agreement_of
from twinline.operations.calibration_report.model import (
    Convergence,
    GroupReport,
    HeightDifferences,
    Histogram,
    PairReport,
    Profile,
    ScanUnderRig,
    ThesisReport,
)
from twinline.operations.same_scan import PairDifference, ProfileRows, SamePoints, compare_sensors, profile

_BINS = 25
_MAP_CELLS = 110
_REACH_SIZES = 6.0
_LEAST_MAP_CELL_MM = 1.5


def histogram(values: FloatArray, reach: float, bins: int = _BINS) -> Histogram:
    """Counts over -reach to reach, and how many lie beyond."""
    values = np.asarray(values, dtype=np.float64)
    values = values[np.isfinite(values)]
    counts, _ = np.histogram(values, bins=bins, range=(-reach, reach))
    below, above = int((values < -reach).sum()), int((values > reach).sum())
    return Histogram(-reach, 2.0 * reach / bins, tuple(int(c) for c in counts), below, above)


def round_reach(value: float) -> float:
    """The next of 1, 2, 5 times a power of ten, from 0.01 on."""
    if not np.isfinite(value) or value <= 0.01:
        return 0.01
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= value * (1 - 1e-9)))


def group_reports(result: ScannerResult, evidence: ScannerEvidence) -> tuple[GroupReport, ...]:
    """Residuals of each kind of observation."""
    if result.joint is None:
        return ()
    rows, weights, found = result.joint.rows, result.joint.weights, []
    for figures in evidence.groups:
        kind = KINDS.index(figures.kind)
        here = rows.kind == kind
        values = rows.residual[here]
        reach = round_reach(3.0 * float(np.sqrt(np.mean(values**2))))
        left = None
        if result.held_out is not None:
            out = (result.held_out.rows.kind == kind) & result.held_out.rows.held_out
            left = histogram(result.held_out.rows.residual[out], reach) if out.any() else None
        gone = rows.residual[here & (weights < REJECTED_WEIGHT)]
        found.append(GroupReport(figures, histogram(values, reach), histogram(gone, reach), left))
    return tuple(found)


@dataclass(frozen=True)
class Frame:
    """What pictures of the same scan have in common, so that they can be laid beside each other.

    Attributes
    ----------
    reach_mm
        Differences up to this size are told apart.
    extents_mm
        Corners x, y of the maps by pair of sensors, (2, 2).
    """

    reach_mm: float
    extents_mm: dict[str, FloatArray]


def frame_of(scanner: Scanner, points: SamePoints) -> Frame:
    """Scale and extents by what is left under the best rig."""
    pairs = compare_sensors(scanner, points)
    sizes = [np.median(np.abs(pair.objects_mm)) for pair in pairs]
    reach = round_reach(_REACH_SIZES * float(max(sizes))) if sizes else 1.0
    return Frame(reach, {p.pair: np.percentile(p.places_mm, [0.1, 99.9], axis=0) for p in pairs})


def scan_under_rig(
    label: str, rig: str, scanner: Scanner, points: SamePoints, rows: ProfileRows | None, frame: Frame
) -> ScanUnderRig:
    """The same scan under one rig."""
    pairs = tuple(_pair_report(pair, frame) for pair in compare_sensors(scanner, points))
    lines = profile(scanner, points, rows) if rows is not None else {}
    profiles = tuple(
        Profile(name, _rounded(line[:, 0], 2), _rounded(line[:, 1], 3)) for name, line in lines.items() if len(line)
    )
    return ScanUnderRig(label, rig, pairs, profiles)


def _pair_report(pair: PairDifference, frame: Frame) -> PairReport:
    bed = float(np.median(np.abs(pair.bed_mm))) if len(pair.bed_mm) else float("nan")
    reach = max(frame.reach_mm, round_reach(float(np.percentile(np.abs(pair.objects_mm), 95))))
    return PairReport(agreement_of(pair), bed, histogram(pair.objects_mm, reach), _map(pair, frame))


def _map(pair: PairDifference, frame: Frame) -> HeightDifferences:
    """Mean differences in cells, at most 110 along the longer side."""
    own = np.percentile(pair.places_mm, [0.1, 99.9], axis=0)
    low, high = frame.extents_mm.get(pair.pair, own)
    size = max(_LEAST_MAP_CELL_MM, float((high - low).max()) / _MAP_CELLS)
    columns, rows = (int(n) + 1 for n in np.floor((high - low) / size))
    index = np.floor((pair.places_mm - low) / size).astype(np.int64)
    inside = (index >= 0).all(axis=1) & (index[:, 0] < columns) & (index[:, 1] < rows)
    key = index[inside, 1] * columns + index[inside, 0]
    counts = np.bincount(key, minlength=rows * columns)
    sums = np.bincount(key, weights=pair.all_mm[inside], minlength=rows * columns)
    with np.errstate(invalid="ignore", divide="ignore"):
        means = (sums / counts).reshape(rows, columns)
    cells = tuple(tuple(None if np.isnan(v) else round(float(v), 3) for v in row) for row in means)
    return HeightDifferences((float(low[0]), float(low[1])), size, frame.reach_mm, cells)


def _rounded(values: FloatArray, decimals: int) -> tuple[float, ...]:
    return tuple(round(float(v), decimals) for v in values)


def thesis_report(outcome: ThesisOutcome | None, failure: str) -> ThesisReport:
    """The thesis's method: its figures and runs, or why it gave nothing."""
    if outcome is None:
        return ThesisReport(failure, (), (), ())
    result = outcome.calibration
    steps = [(f"Laser {k} against ToF", _fit_words(fit)) for k, fit in enumerate(result.fits, 1)]
    runs = [
        _convergence(f"Laser {k}", "sum of |Z ToF − Z laser|, mm", fit.trace) for k, fit in enumerate(result.fits, 1)
    ]
    if result.shift is not None:
        steps.append(("Laser 1 onto laser 2", _shift_words(result.shift)))
        runs.append(_convergence("Laser 1 onto laser 2", "sum of |Z1 − Z2|, mm", result.shift.trace))
    steps.append(("ToF onto both lasers", _alignment_words(result.alignment)))
    runs.append(_convergence("ToF onto both lasers", "mean of |Z ToF − Z laser|, mm", result.alignment.trace))
    return ThesisReport("", tuple(steps), tuple(runs), outcome.reasons)


def _fit_words(fit: SheetFit) -> str:
    return (
        f"d = {fit.baseline_mm:.3f} mm, θ = {np.degrees(fit.angle_rad):.4f}°; mean of |Z ToF − Z laser| "
        f"{fit.sum_mm / len(fit.points):.3f} mm at {len(fit.points)} points"
    )


def _shift_words(shift: LaserShift) -> str:
    low, high = (f"{value:.2f}".replace("-", "−") for value in shift.indifferent_mm)
    moved = f"{shift.shift_mm:.3f}".replace("-", "−")
    return (
        f"{moved} mm along the travel, though any shift from {low} to {high} mm fits as well; sum of |Z1 − Z2| from "
        f"{shift.before_mm:.1f} to {shift.after_mm:.1f} mm over {shift.places} places"
    )


def _alignment_words(tof: TofAlignment) -> str:
    moved = ", ".join(f"{value:.3f}".replace("-", "−") for value in tof.shift_mm)
    return (
        f"moved by {moved} mm along x, y, z; mean of |Z ToF − Z laser| from {tof.before_mm:.3f} to "
        f"{tof.after_mm:.3f} mm at {tof.points} points"
    )


def _convergence(name: str, value_name: str, trace: NelderMeadTrace) -> Convergence:
    return Convergence(
        name,
        value_name,
        _significant(trace.values),
        {n: _significant(trace.parameters[:, i]) for i, n in enumerate(trace.names)},
        _significant(trace.simplex_size),
        trace.restarts,
        trace.evaluations,
        trace.settled_after(),
    )


def _significant(values: Sequence[float] | FloatArray) -> tuple[float, ...]:
    """Seven digits: what a graph and a reader can use."""
    return tuple(float(f"{v:.7g}") for v in values)
