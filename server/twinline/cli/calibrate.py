"""``twinline calibrate``."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np
import typer

from twinline.calibration.scanner import PARTS
from twinline.calibration.scanner_evidence import ScannerEvidence
from twinline.calibration.thesis_picks import PickedPoints
from twinline.cli.progress import progress
from twinline.errors import CalibrationError, OutputError
from twinline.geometry.rig import Rig
from twinline.geometry.rig_json import rig_id
from twinline.operations.calibrate import CalibrationOptions, Report, calibrate_capture, collect
from twinline.operations.calibrate_thesis import (
    ThesisOutcome,
    calibrate_collected_by_thesis,
    read_picks,
    thesis_options,
)
from twinline.operations.calibration_report.gather import Reported, calibrate_with_report
from twinline.operations.calibration_report.model import CalibrationReport, Method
from twinline.operations.calibration_report.page import render_page
from twinline.operations.clock import Clock, SystemClock, rfc3339
from twinline.recording.atomic_file import atomic_path
from twinline.recording.capture import Capture, open_capture
from twinline.recording.rig_file import read_rig, write_rig

METHODS: tuple[str, ...] = get_args(Method)


@dataclass(frozen=True)
class CalibrateRequest:
    """The options of the command.

    Attributes
    ----------
    only
        Parts to calibrate; all where empty.
    start
        Rig to start from; where it is not given and only some parts are calibrated, the output file if there is one.
    method
        "joint" or "thesis".
    picks
        Points for the thesis's method, see `calibrate_thesis.read_picks`.
    report
        HTML page to write, also where the calibration is refused.
    """

    capture: Path
    output: Path
    only: frozenset[str] = frozenset()
    start: Path | None = None
    json: bool = False
    method: str = "joint"
    picks: Path | None = None
    report: Path | None = None

    def checked_method(self) -> Method:
        """The method, after everything that the options alone can be wrong in.

        Raises
        ------
        CalibrationError, OutputError
            Naming the option and what it may be.
        """
        if self.output.suffix.lower() != ".json":
            raise OutputError(f"{self.output}: a rig is written as .json; choose this ending.")
        if self.method not in METHODS:
            raise CalibrationError(f"--method {self.method}: choose from {', '.join(METHODS)}.", code="bad-method")
        if self.report is not None and self.report.suffix.lower() not in (".html", ".htm"):
            raise OutputError(f"{self.report}: the report is a page; choose the ending .html.")
        unknown = sorted(self.only - set(PARTS))
        if unknown:
            raise CalibrationError(f"--only {unknown[0]}: choose from {', '.join(PARTS)}.", code="bad-parts")
        if self.method == "thesis" and self.only:
            raise CalibrationError(
                "--only belongs to --method joint; the thesis's method always fits the lasers and then the ToF "
                "sensor, so leave it out.",
                code="bad-parts",
            )
        if self.method != "thesis" and self.picks is not None:
            raise CalibrationError("--picks belongs to --method thesis; add that, or leave it out.", code="bad-picks")
        return cast(Method, self.method)

    def options(self) -> CalibrationOptions:
        """As the calibration takes them."""
        return CalibrationOptions(self.only or frozenset(PARTS), self._base())

    def _base(self) -> Rig | None:
        if self.start is not None:
            return read_rig(self.start)
        if self.only and self.output.is_file():
            return read_rig(self.output)
        return None


@dataclass(frozen=True, eq=False)
class _Done:
    """A calibration by either method, to be written and told."""

    rig: Rig
    evidence: ScannerEvidence | None
    thesis: ThesisOutcome | None
    report: CalibrationReport | None = None


def run_calibrate(request: CalibrateRequest, clock: Clock | None = None) -> None:
    """Calibrate a capture and write its rig; if that fails, an earlier rig file stays as it was.

    A report is written in any case: where the calibration is refused, it says why.
    """
    method = request.checked_method()
    options = request.options()
    capture = open_capture(request.capture)
    picks = read_picks(request.picks, options.base or capture.rig()) if request.picks is not None else None
    if request.report is not None:
        done = _reported(request, capture, options, method, picks, clock or SystemClock())
    elif method == "thesis":
        with _stages(quiet=request.json) as report:
            collected = collect(capture, thesis_options(options.base), report=report)
        outcome = calibrate_collected_by_thesis(collected, picks)
        done = _Done(outcome.rig, None, outcome)
    else:
        with _stages(quiet=request.json) as report:
            calibration = calibrate_capture(capture, options, report=report)
        done = _Done(calibration.rig, calibration.evidence, None)
    write_rig(request.output, done.rig)
    _tell(request, done)


def _reported(
    request: CalibrateRequest,
    capture: Capture,
    options: CalibrationOptions,
    method: Method,
    picks: tuple[PickedPoints, ...] | None,
    clock: Clock,
) -> _Done:
    """Calibrate and write the report; then raise what made the calibration impossible."""
    assert request.report is not None
    # Opened before the work, so that a path that cannot be written costs no minutes.
    with atomic_path(request.report) as target:
        with _stages(quiet=request.json) as stages:
            found = calibrate_with_report(
                capture, options, method=method, made=rfc3339(clock.now()), picks=picks, report=stages
            )
        target.write_text(render_page(found.report), encoding="utf-8", newline="\n")
    return _accepted(request, found)


def _accepted(request: CalibrateRequest, found: Reported) -> _Done:
    if found.rig is None:
        assert found.error is not None
        if request.json:
            typer.echo(json.dumps({"output": None, "report": found.report.to_json()}, indent=1))
        else:
            typer.echo(f"twinline: the report says more: {request.report}", err=True)
        raise found.error
    if found.report.method == "joint":
        return _Done(found.rig, found.report.evidence, None, found.report)
    return _Done(found.rig, None, found.thesis, found.report)


@contextmanager
def _stages(*, quiet: bool) -> Iterator[Report]:
    with progress("Calibration", quiet=quiet) as bar:
        yield lambda _stage, done, total: bar(done, total)


def _tell(request: CalibrateRequest, done: _Done) -> None:
    if request.json:
        typer.echo(json.dumps(_summary(request, done), indent=1))
        return
    reasons = done.evidence.reasons if done.evidence is not None else ()
    if done.thesis is not None:
        reasons = done.thesis.reasons
    for reason in reasons:
        typer.echo(f"twinline: {reason}", err=True)
    for number, sheet in enumerate(done.rig.sheets, 1):
        typer.echo(
            f"laser {number}: baseline {sheet.baseline_mm:.3f} mm, angle {np.degrees(sheet.angle_rad):.4f} degrees"
        )
    if done.evidence is not None:
        _tell_joint(request, done.evidence)
    if done.thesis is not None:
        _tell_thesis(request, done.thesis)
    if request.report is not None:
        typer.echo(f"report: {request.report}")


def _summary(request: CalibrateRequest, done: _Done) -> dict[str, Any]:
    summary: dict[str, Any] = {
        "output": str(request.output),
        "method": request.method,
        "rig": done.rig.name,
        "rig_id": rig_id(done.rig),
        "sources": dict(done.rig.sources),
        "evidence": done.evidence.to_json() if done.evidence is not None else done.rig.evidence["calibration"],
    }
    if done.report is not None:
        summary["report"] = done.report.to_json()
    return summary


def _tell_joint(request: CalibrateRequest, evidence: ScannerEvidence) -> None:
    typer.echo(f"travel: {evidence.travel_scale:.5f} mm per commanded mm")
    for group in evidence.groups:
        typer.echo(
            f"{group.kind}: {group.observations} groups, rms {group.rms_mm:.3f} mm, held out {group.held_out_mm:.3f} "
            f"mm, rejected {100 * group.rejected_share:.0f} %"
        )
    if evidence.unseen:
        typer.echo(f"held by what was known before, not by observations: {', '.join(evidence.unseen)}")
    typer.echo(f"{evidence.verdict}; shape uncertain by {evidence.shape_sd_mm:.3f} mm: {request.output}")


def _tell_thesis(request: CalibrateRequest, outcome: ThesisOutcome) -> None:
    for number, fit in enumerate(outcome.calibration.fits, 1):
        typer.echo(
            f"laser {number} against ToF: mean difference {fit.sum_mm / len(fit.points):.3f} mm at {len(fit.points)} "
            f"points, {len(fit.trace) - 1} iterations"
        )
    if outcome.calibration.shift is not None:
        shift = outcome.calibration.shift
        typer.echo(f"laser 1 onto laser 2: {shift.shift_mm:.3f} mm, {len(shift.trace) - 1} iterations")
    tof = outcome.calibration.alignment
    x, y, z = tof.shift_mm
    typer.echo(f"ToF onto both: {x:.3f}, {y:.3f}, {z:.3f} mm, {len(tof.trace) - 1} iterations")
    for pair in outcome.agreement:
        typer.echo(f"{pair.pair}: typically {pair.typical_mm:.3f} mm on objects, 90 % within {pair.p90_mm:.3f} mm")
    typer.echo(f"usable: {request.output}")
