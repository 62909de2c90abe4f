"""The thesis's calibration of a capture: two laser fits, the shift between the lasers, the ToF sensor laid on both."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from twinline.calibration.observations import StripePoints, clean_stripes, stripe_points
from twinline.calibration.scanner import StripeTable, scanner_of_rig
from twinline.calibration.scanner_evidence import GOOD_AGREEMENT_MM, Agreement
from twinline.calibration.thesis import ThesisCalibration, calibrate_thesis
from twinline.calibration.thesis_fit import SheetFit
from twinline.calibration.thesis_picks import PickedPoints
from twinline.calibration.thesis_simplex import NelderMeadTrace
from twinline.errors import CalibrationError, CaptureError
from twinline.geometry.rig import Rig
from twinline.operations.calibrate import CalibrationOptions, Collected
from twinline.operations.same_scan import PairDifference, SamePoints, compare_sensors, points_of_tables
from twinline.recording.csv_table import parse_whole, read_table

THESIS_PARTS = frozenset({"camera", "sheets", "tof"})
"""What the thesis's method reads of a capture; it takes the commanded travel for the real one."""

_LEAST_CELL_MM = 1.0
_CELL_PER_STEP = 1.3
_MODEL_DOUBT = (
    "The thesis's model has two numbers per laser: no tilt of the camera, no yaw of a sheet, no lens distortion; and "
    "it tells no uncertainty. Compare with --method joint."
)


@dataclass(frozen=True, eq=False)
class ThesisOutcome:
    """A finished calibration by the thesis's method.

    Attributes
    ----------
    rig
        Complete: with sources, noise and evidence.
    calibration
        The fits and alignments, each with its trace.
    agreement
        How the sensors agree on objects under this rig.
    reasons
        What makes the result weaker than it should be, each with the next step.
    """

    rig: Rig
    calibration: ThesisCalibration
    agreement: tuple[Agreement, ...]
    reasons: tuple[str, ...]


def thesis_options(base: Rig | None = None) -> CalibrationOptions:
    """What `calibrate.collect` shall read for this method."""
    return CalibrationOptions(THESIS_PARTS, base)


def read_picks(path: Path, rig: Rig) -> tuple[PickedPoints, ...]:
    """Points picked by hand: a CSV with laser (1, 2), u, v in pixels and height_mm by ToF, one line per point.

    Returns
    -------
    tuple
        One set per laser of the rig.

    Raises
    ------
    CaptureError
        The file is no such table, or names a laser that the rig does not have; says which line.
    CalibrationError
        ``too-few-points`` where a laser has less than two.
    """
    chosen: list[list[tuple[float, float, float]]] = [[] for _ in rig.sheets]
    for row in read_table(path, ("laser", "u", "v", "height_mm")):
        laser = parse_whole(row.text("laser"))
        if laser is None or not 1 <= laser <= len(chosen):
            raise row.error(f"laser must be a number from 1 to {len(chosen)}, not {row.text('laser')[:40]!r}.")
        chosen[laser - 1].append((row.number("u"), row.number("v"), row.number("height_mm")))
    for number, points in enumerate(chosen, 1):
        if len(points) < 2:
            raise CalibrationError(
                f"{path} has {len(points)} points of laser {number}, and its two parameters need two points at two "
                "heights: add lines for it.",
                code="too-few-points",
            )
    camera_height_mm = float(rig.bed_from_camera.translation_mm[2])
    tables = [np.array(points) for points in chosen]
    return tuple(PickedPoints.from_heights(t[:, :2], t[:, 2], camera_height_mm) for t in tables)


def calibrate_collected_by_thesis(
    collected: Collected, picks: Sequence[PickedPoints] | None = None, *, points: SamePoints | None = None
) -> ThesisOutcome:
    """Calibrate by the thesis's method from what `calibrate.collect` read.

    The camera is the one that the board views gave, where there are such (3.24 comes first in the thesis, too).

    Parameters
    ----------
    picks
        One set per laser; found automatically where they are not given.
    points
        Points over which the sensors are compared; sorted by height under the result where they are not given.

    Raises
    ------
    CaptureError
        There is no laser pass or no ToF raster.
    CalibrationError
        A step has too little to go by; it names the step and what to do.
    """
    data = collected.data
    if not data.stripes or collected.stripes is None:
        raise CaptureError("The thesis's method needs a laser pass: add laser/, or use the joint method.")
    if data.tof is None:
        raise CaptureError(
            "The thesis's method measures the lasers against the ToF sensor, and there is no tof/: add a ToF raster "
            "over the same objects, or use the joint method."
        )
    base = data.base
    if data.camera is not None:
        used = sum(view.used for view in data.camera.views)
        sources = {**base.sources, "camera": f"calibrated from {used} board views"}
        base = replace(base, camera=data.camera.camera, covariance=None, sources=sources)
    along_u = base.stripe_runs == "along-u"
    stripes: list[StripePoints] = [
        stripe_points(t.centre_px, t.sd_px, t.cart_mm, clean_stripes(t.centre_px)[0], along_u=along_u)
        for t in data.stripes
    ]
    result = calibrate_thesis(base, stripes, data.tof, picks=picks, cell_mm=_cell_mm(data.stripes))
    return _outcome(result, points or points_of_tables(result.rig, data.stripes, data.tof), collected)


def _cell_mm(tables: Sequence[StripeTable]) -> float:
    """A little more than the distance of the frames: on a finer grid every second cell would be empty."""
    steps = np.concatenate([np.diff(np.unique(table.cart_mm)) for table in tables])
    return max(_LEAST_CELL_MM, _CELL_PER_STEP * float(np.median(steps)) if len(steps) else 0.0)


def _outcome(result: ThesisCalibration, points: SamePoints, collected: Collected) -> ThesisOutcome:
    agreement = tuple(agreement_of(pair) for pair in compare_sensors(scanner_of_rig(result.rig), points))
    reasons = [_MODEL_DOUBT]
    reasons += [
        f"{pair.pair[0].upper()}{pair.pair[1:]}: heights differ by {pair.typical_mm:.2f} mm typically (good is "
        f"{GOOD_AGREEMENT_MM:g})."
        for pair in agreement
        if pair.typical_mm > GOOD_AGREEMENT_MM
    ]
    reasons += result.notes
    noise = collected.stripes.noise if collected.stripes is not None else result.rig.noise
    rig = replace(result.rig, noise=noise, covariance=None, evidence={})
    outcome = ThesisOutcome(rig, result, agreement, tuple(reasons))
    return replace(outcome, rig=replace(rig, evidence={"calibration": thesis_evidence(outcome)}))


def agreement_of(pair: PairDifference) -> Agreement:
    """Robust figures of a comparison on objects."""
    size = np.abs(pair.objects_mm)
    return Agreement(
        pair.pair,
        len(size),
        float(np.median(pair.objects_mm)),
        float(np.median(size)),
        float(np.percentile(size, 90)),
    )


def thesis_evidence(outcome: ThesisOutcome) -> dict[str, Any]:
    """What the rig keeps of how it came about, as plain JSON values."""
    result = outcome.calibration
    shift, alignment = result.shift, result.alignment
    return {
        "method": "thesis",
        "verdict": "usable",
        "reasons": list(outcome.reasons),
        "lasers": [_fit_evidence(fit) for fit in result.fits],
        "laser_shift": None
        if shift is None
        else {
            "shift_mm": shift.shift_mm,
            "sum_before_mm": shift.before_mm,
            "sum_after_mm": shift.after_mm,
            "places": shift.places,
            "fits_equally_well_mm": list(shift.indifferent_mm),
            "applied": not result.notes,
            "trace": _trace_evidence(shift.trace),
        },
        "tof_alignment": {
            "shift_mm": [float(v) for v in alignment.shift_mm],
            "yaw_deg": float(np.degrees(alignment.yaw_rad)),
            "mean_before_mm": alignment.before_mm,
            "mean_after_mm": alignment.after_mm,
            "points": alignment.points,
            "trace": _trace_evidence(alignment.trace),
        },
        "agreement": [
            {"pair": a.pair, "cells": a.cells, "median_mm": a.median_mm, "typical_mm": a.typical_mm, "p90_mm": a.p90_mm}
            for a in outcome.agreement
        ],
    }


def _fit_evidence(fit: SheetFit) -> dict[str, Any]:
    return {
        "baseline_mm": fit.baseline_mm,
        "angle_deg": float(np.degrees(fit.angle_rad)),
        "points": len(fit.points),
        "sum_mm": fit.sum_mm,
        "mean_mm": fit.sum_mm / len(fit.points),
        "lens": fit.lens,
        "trace": _trace_evidence(fit.trace),
    }


def _trace_evidence(trace: NelderMeadTrace) -> dict[str, Any]:
    return {
        "iterations": len(trace) - 1,
        "evaluations": trace.evaluations,
        "restarts": len(trace.restarts),
        "first_value": float(trace.values[0]),
        "last_value": float(trace.values[-1]),
        "settled_after": trace.settled_after(),
    }
