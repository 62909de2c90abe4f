"""``twinline calibrate``."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import typer

from twinline.calibration.scanner import PARTS
from twinline.cli.progress import progress
from twinline.errors import CalibrationError, OutputError
from twinline.geometry.rig import Rig
from twinline.geometry.rig_json import rig_id
from twinline.operations.calibrate import Calibration, CalibrationOptions, Report, calibrate_capture
from twinline.recording.capture import open_capture
from twinline.recording.rig_file import read_rig, write_rig


@dataclass(frozen=True)
class CalibrateRequest:
    """The options of the command.

    Attributes
    ----------
    only
        Parts to calibrate; all where empty.
    start
        Rig to start from; where it is not given and only some parts are calibrated, the output file if there is one.
    """

    capture: Path
    output: Path
    only: frozenset[str] = frozenset()
    start: Path | None = None
    json: bool = False

    def options(self) -> CalibrationOptions:
        """As the calibration takes them."""
        unknown = sorted(self.only - set(PARTS))
        if unknown:
            raise CalibrationError(f"--only {unknown[0]}: choose from {', '.join(PARTS)}.", code="bad-parts")
        return CalibrationOptions(self.only or frozenset(PARTS), self._base())

    def _base(self) -> Rig | None:
        if self.start is not None:
            return read_rig(self.start)
        if self.only and self.output.is_file():
            return read_rig(self.output)
        return None


def run_calibrate(request: CalibrateRequest) -> None:
    """Calibrate a capture and write its rig; if that fails, an earlier rig file stays as it was."""
    if request.output.suffix.lower() != ".json":
        raise OutputError(f"{request.output}: a rig is written as .json; choose this ending.")
    options = request.options()
    capture = open_capture(request.capture)
    with _stages(quiet=request.json) as report:
        calibration = calibrate_capture(capture, options, report=report)
    write_rig(request.output, calibration.rig)
    _tell(request, calibration)


@contextmanager
def _stages(*, quiet: bool) -> Iterator[Report]:
    with progress("Calibration", quiet=quiet) as bar:
        yield lambda _stage, done, total: bar(done, total)


def _tell(request: CalibrateRequest, calibration: Calibration) -> None:
    evidence, rig = calibration.evidence, calibration.rig
    if request.json:
        summary = {
            "output": str(request.output),
            "rig": rig.name,
            "rig_id": rig_id(rig),
            "sources": dict(rig.sources),
            "evidence": evidence.to_json(),
        }
        typer.echo(json.dumps(summary, indent=1))
        return
    for reason in evidence.reasons:
        typer.echo(f"twinline: {reason}", err=True)
    for number, sheet in enumerate(rig.sheets, 1):
        typer.echo(
            f"laser {number}: baseline {sheet.baseline_mm:.3f} mm, angle {sheet.angle_rad * 57.29577951308232:.4f} "
            "degrees"
        )
    typer.echo(f"travel: {evidence.travel_scale:.5f} mm per commanded mm")
    for group in evidence.groups:
        typer.echo(
            f"{group.kind}: {group.observations} groups, rms {group.rms_mm:.3f} mm, held out {group.held_out_mm:.3f} "
            f"mm, rejected {100 * group.rejected_share:.0f} %"
        )
    if evidence.unseen:
        typer.echo(f"held by what was known before, not by observations: {', '.join(evidence.unseen)}")
    typer.echo(f"{evidence.verdict}; shape uncertain by {evidence.shape_sd_mm:.3f} mm: {request.output}")
