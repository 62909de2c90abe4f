"""Calibrates a capture by both methods and reports on them, also where the calibration is refused."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from twinline import __version__
from twinline.calibration.intrinsics import IntrinsicsResult, calibrate_intrinsics
from twinline.calibration.scanner import ScannerResult, scanner_of_rig
from twinline.calibration.scanner_evidence import ScannerEvidence, Verdict
from twinline.calibration.thesis_picks import PickedPoints
from twinline.calibration.views import BoardView, compare_views, inspect_view
from twinline.errors import CalibrationError, InputError
from twinline.geometry.rig import Rig
from twinline.geometry.rig_json import rig_id
from twinline.operations.calibrate import (
    Calibration,
    CalibrationOptions,
    Collected,
    adjust_collected,
    board_of,
    collect,
    finish,
)
from twinline.operations.calibrate_thesis import ThesisOutcome, calibrate_collected_by_thesis
from twinline.operations.calibration_report.board_views import coverage_report
from twinline.operations.calibration_report.model import CalibrationReport, CoverageReport, Method, ScanUnderRig
from twinline.operations.calibration_report.quantities import compare_quantities
from twinline.operations.calibration_report.summaries import (
    frame_of,
    group_reports,
    scan_under_rig,
    thesis_report,
)
from twinline.operations.same_scan import SamePoints, points_of_result, points_of_tables, profile_rows
from twinline.recording.capture import Capture
from twinline.recording.images import read_image

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class Reported:
    """A calibration with its report.

    Attributes
    ----------
    rig
        Of the chosen method; None where that was refused.
    calibration
        The joint one; None where it was refused.
    thesis
        None where the thesis's method gave nothing.
    error
        Why there is no rig; None where there is one.
    """

    report: CalibrationReport
    rig: Rig | None
    calibration: Calibration | None
    thesis: ThesisOutcome | None
    error: InputError | None


@dataclass(frozen=True, eq=False)
class _Joint:
    """What came of the joint method, as far as it got."""

    result: ScannerResult | None = None
    evidence: ScannerEvidence | None = None
    calibration: Calibration | None = None
    error: InputError | None = None


def calibrate_with_report(
    capture: Capture,
    options: CalibrationOptions,
    *,
    method: Method,
    made: str,
    picks: Sequence[PickedPoints] | None = None,
    report: Progress = lambda stage, done, total: None,
) -> Reported:
    """Calibrate by both methods, and report; the rig is the chosen method's.

    Whatever makes the chosen method impossible becomes part of the report and is kept in ``error``.

    Parameters
    ----------
    made
        Present date and time, RFC 3339.
    picks
        Points for the thesis's method, see `calibrate_thesis.read_picks`.
    """
    try:
        collected = collect(capture, options, report=report)
    except InputError as refusal:
        return _refused(capture, options, method, made, refusal)
    joint = _by_joint_method(capture, collected)
    points = points_of_result(joint.result) if joint.result is not None and joint.result.seen else None
    thesis, thesis_error = _by_thesis(collected, picks, points)
    by_joint = joint.calibration.rig if joint.calibration is not None else None
    by_thesis = thesis.rig if thesis is not None else None
    rig, error = (by_joint, joint.error) if method == "joint" else (by_thesis, thesis_error)
    verdict, reasons = _verdict(method, joint, thesis, error)
    base = collected.data.base
    shown = rig or base
    made_report = CalibrationReport(
        capture=capture.info.name,
        rig=shown.name,
        rig_id=rig_id(rig) if rig is not None else "",
        made=made,
        version=__version__,
        method=method,
        verdict=verdict,
        code=error.code if error is not None else "",
        reasons=reasons,
        parts_used=joint.evidence.parts_used if joint.evidence is not None else _parts(collected),
        sources=dict(shown.sources),
        joint_failure=joint.error.detail if joint.error is not None and joint.result is None else "",
        evidence=joint.evidence,
        groups=group_reports(joint.result, joint.evidence) if joint.result and joint.evidence else (),
        quantities=compare_quantities(base, by_thesis, joint.result),
        scans=_scans(collected, points, joint.result, thesis),
        thesis=thesis_report(thesis, thesis_error.detail if thesis_error is not None else ""),
        coverage=coverage_report(collected.views, collected.data.camera),
    )
    return Reported(made_report, rig, joint.calibration, thesis, error)


def _by_joint_method(capture: Capture, collected: Collected) -> _Joint:
    try:
        result, evidence = adjust_collected(collected)
    except CalibrationError as error:
        return _Joint(error=error)
    try:
        return _Joint(result, evidence, finish(capture, collected, result, evidence))
    except InputError as error:
        return _Joint(result, evidence, error=error)


def _by_thesis(
    collected: Collected, picks: Sequence[PickedPoints] | None, points: SamePoints | None
) -> tuple[ThesisOutcome | None, InputError | None]:
    try:
        return calibrate_collected_by_thesis(collected, picks, points=points), None
    except InputError as error:
        return None, error


def _verdict(
    method: Method, joint: _Joint, thesis: ThesisOutcome | None, error: InputError | None
) -> tuple[Verdict, tuple[str, ...]]:
    if method == "joint" and joint.evidence is not None:
        return joint.evidence.verdict, joint.evidence.reasons
    if method == "thesis" and thesis is not None:
        return "usable", thesis.reasons
    return "refused", (error.detail,) if error is not None else ()


def _parts(collected: Collected) -> tuple[str, ...]:
    data, used = collected.data, []
    if data.camera is not None:
        used.append(f"camera/: {sum(v.used for v in data.camera.views)} of {len(data.camera.views)} views")
    if data.travel is not None:
        used.append(f"motion/: {len(data.travel.views)} views")
    if data.stripes:
        used.append(f"laser/: {len(data.stripes[0].cart_mm)} frames")
    if data.tof is not None:
        used.append(f"tof/: {len(data.tof)} readings")
    return tuple(used)


def _scans(
    collected: Collected, points: SamePoints | None, result: ScannerResult | None, thesis: ThesisOutcome | None
) -> tuple[ScanUnderRig, ...]:
    """The same scan before and after, in the order in which a reader compares."""
    data = collected.data
    if points is None and thesis is not None and data.stripes:
        points = points_of_tables(thesis.rig, data.stripes, data.tof)
    if points is None:
        return ()
    scanners = [("before", data.base.name, scanner_of_rig(data.base))]
    if thesis is not None:
        scanners.append(("thesis", thesis.rig.name, scanner_of_rig(thesis.rig)))
    if result is not None:
        scanners.append(("joint", data.base.name, result.scanner))
    best = scanners[-1][2]
    rows, frame = profile_rows(best, points), frame_of(best, points)
    return tuple(scan_under_rig(label, name, scanner, points, rows, frame) for label, name, scanner in scanners)


def _refused(capture: Capture, options: CalibrationOptions, method: Method, made: str, error: InputError) -> Reported:
    """The report on a capture that could not even be read to the end: the reason, and the board views if any."""
    base = options.base
    report = CalibrationReport(
        capture=capture.info.name,
        rig=base.name if base is not None else capture.info.name,
        rig_id="",
        made=made,
        version=__version__,
        method=method,
        verdict="refused",
        code=error.code,
        reasons=(error.detail,),
        parts_used=_folders(capture),
        sources={},
        joint_failure=error.detail,
        evidence=None,
        groups=(),
        quantities=(),
        scans=(),
        thesis=thesis_report(None, ""),
        coverage=_views_alone(capture) if "camera" in options.parts else None,
    )
    return Reported(report, None, None, None, error)


def _folders(capture: Capture) -> tuple[str, ...]:
    """What the folder holds, without reading it."""
    names = ("camera", "motion", "sheets", "heights", "laser", "tof", "reference")
    return tuple(f"{name}/" for name in names if (capture.path / name).is_dir())


def _views_alone(capture: Capture) -> CoverageReport | None:
    """The board views once more, on their own, so that a reader sees which of them are the cause."""
    camera: IntrinsicsResult | None = None
    views: list[BoardView] = []
    try:
        board = board_of(capture, "camera/")
        views = [inspect_view(path.name, read_image(path), board) for path in capture.views()]
        views = list(compare_views(views, board))
        camera = calibrate_intrinsics(views, capture.info.camera_matrix_guess)
    except InputError:
        # The report already tells the reason; these pictures only illustrate it.
        camera = None
    return coverage_report(views, camera)
