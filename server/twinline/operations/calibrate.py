"""Calibration of a capture folder: pictures and readings in, a rig with its evidence out."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from twinline.arrays import BoolArray
from twinline.calibration.board import Board
from twinline.calibration.intrinsics import IntrinsicsResult, calibrate_intrinsics
from twinline.calibration.joint_types import KnownPoints
from twinline.calibration.observations import TofReadings, median_of_repeats
from twinline.calibration.scanner import (
    PARTS,
    ScannerData,
    ScannerResult,
    StripeTable,
    calibrate_scanner,
    scanner_of_rig,
)
from twinline.calibration.scanner_account import gather_evidence
from twinline.calibration.scanner_evidence import ScannerEvidence
from twinline.calibration.scanner_rig import make_rig
from twinline.calibration.travel import TravelResult, calibrate_travel
from twinline.calibration.views import BoardView, compare_views, inspect_view
from twinline.errors import CalibrationError, FrameError
from twinline.geometry.rig import Rig
from twinline.operations.calibrate_known import read_blocks, read_sheet_views
from twinline.operations.calibrate_stripes import PassStripes, bed_noise, read_stripes
from twinline.recording.capture import Capture
from twinline.recording.images import read_image

Report = Callable[[str, int, int], None]

_LENS_MODEL = "k1 k2 p1 p2"


@dataclass(frozen=True)
class CalibrationOptions:
    """Choices of a calibration.

    Attributes
    ----------
    parts
        Which of camera, travel, sheets, tof to calibrate; the others stay as they are in ``base``.
    base
        Rig to start from; the capture's nominal one where not given.
    """

    parts: frozenset[str] = frozenset(PARTS)
    base: Rig | None = None

    def __post_init__(self) -> None:
        unknown = sorted(self.parts - set(PARTS))
        if unknown or not self.parts:
            what = f"unknown part {unknown[0]!r}" if unknown else "no part"
            raise CalibrationError(f"{what} to calibrate; choose from {', '.join(PARTS)}.", code="bad-parts")


@dataclass(frozen=True, eq=False)
class Calibration:
    """A finished calibration.

    Attributes
    ----------
    evidence
        Numbers and verdict; also kept in ``rig.evidence``.
    camera, travel
        The calibrations of these parts alone, for a report.
    result
        The joint adjustment.
    """

    rig: Rig
    evidence: ScannerEvidence
    camera: IntrinsicsResult | None
    travel: TravelResult | None
    result: ScannerResult
    views: tuple[BoardView, ...]


@dataclass(frozen=True, eq=False)
class Collected:
    """What a capture holds for a calibration: observations, the stripes they come from, and the board views."""

    data: ScannerData
    stripes: PassStripes | None
    views: tuple[BoardView, ...]


def _quiet(*_: object) -> None:
    return


def calibrate_capture(
    capture: Capture, options: CalibrationOptions | None = None, *, report: Report = _quiet
) -> Calibration:
    """Calibrate a scanner from whatever parts its capture folder holds.

    Parameters
    ----------
    report
        Called with what is being done, done and total.

    Raises
    ------
    CalibrationError
        Nothing to calibrate from, or the observations do not determine it, or the result does not bear its own
        evidence (code ``calibration-refused``); says what to do next.
    CaptureError, FrameError, StripeError
        A part of the folder cannot be used.
    """
    collected = collect(capture, options, report=report)
    return finish(capture, collected, *adjust_collected(collected))


def adjust_collected(collected: Collected) -> tuple[ScannerResult, ScannerEvidence]:
    """Adjust the scanner to what was collected, and account for it, whatever the verdict.

    Raises
    ------
    CalibrationError
        The observations determine nothing, or contradict each other; says what to do.
    """
    result = calibrate_scanner(collected.data)
    return result, gather_evidence(collected.data, result, scanner_of_rig(collected.data.base))


def finish(capture: Capture, collected: Collected, result: ScannerResult, evidence: ScannerEvidence) -> Calibration:
    """Make the rig of an adjusted scanner, with the noise of its pixels.

    Raises
    ------
    CalibrationError
        ``calibration-refused`` if that is the verdict; it holds the reasons.
    """
    data, stripes, base = collected.data, collected.stripes, collected.data.base
    if evidence.verdict == "refused":
        raise CalibrationError(" ".join(evidence.reasons), code="calibration-refused")
    noise = base.noise
    if stripes is not None and result.seen:
        on_bed: BoolArray = np.zeros(stripes.centre_px.shape, bool)
        for k, seen in enumerate(result.seen):
            on_bed[k, stripes.lit[k]] = seen.on_bed
        noise = bed_noise(capture, stripes, on_bed) if on_bed.any() else stripes.noise
    rig = make_rig(base, result.scanner, result.covariance, _sources(data, result), noise)
    rig = replace(rig, evidence={"calibration": {"method": "joint", **evidence.to_json()}})
    return Calibration(rig, evidence, data.camera, data.travel, result, collected.views)


def collect(capture: Capture, options: CalibrationOptions | None = None, *, report: Report = _quiet) -> Collected:
    """Read everything that a calibration uses, calibrating camera and travel on the way.

    Raises
    ------
    CalibrationError, CaptureError, FrameError, StripeError
        As `calibrate_capture`.
    """
    options = options or CalibrationOptions()
    base = options.base or capture.rig()
    _require_same_scanner(base, capture)
    data = ScannerData(base, options.parts)
    views: tuple[BoardView, ...] = ()
    if "camera" in options.parts and capture.views():
        views = _inspect_camera(capture, report)
        data = replace(data, camera=_intrinsics(views, capture))
    if "travel" in options.parts:
        data = replace(data, travel=_travel(capture, data, report))
    stripes: PassStripes | None = None
    if {"sheets", "tof"} & options.parts:
        data, stripes = _surface(capture, data, report)
    _require_anything(capture, data)
    return Collected(data, stripes, views)


def board_of(capture: Capture, part: str) -> Board:
    """The board that the capture's owner describes.

    Raises
    ------
    CalibrationError
        ``bad-board`` where there is none, or there can be no such board.
    """
    info = capture.info.board
    if info is None:
        raise CalibrationError(
            f"{part} holds pictures of a board, but {capture.path / 'capture.json'} has no field board; describe the "
            "board.",
            code="bad-board",
        )
    return Board(info.kind, info.columns, info.rows, info.square_mm, info.thickness_mm, info.dictionary, info.marker_mm)


def _require_same_scanner(base: Rig, capture: Capture) -> None:
    if base.camera.size != capture.info.image_size or base.stripe_runs != capture.info.stripe_runs:
        raise CalibrationError(
            f"The rig {base.name!r} to start from is for pictures of {base.camera.size[0]} x {base.camera.size[1]} px "
            f"with stripes {base.stripe_runs}, and {capture.path} holds {capture.info.image_size[0]} x "
            f"{capture.info.image_size[1]} px with stripes {capture.info.stripe_runs}: start from another rig, or "
            "from none.",
            code="other-scanner",
        )
    if len(base.sheets) != len(capture.info.lasers):
        raise CalibrationError(
            f"The rig {base.name!r} to start from has {len(base.sheets)} lasers and {capture.path} has "
            f"{len(capture.info.lasers)}: start from another rig, or from none.",
            code="other-scanner",
        )


def _inspect_camera(capture: Capture, report: Report) -> tuple[BoardView, ...]:
    board = board_of(capture, "camera/")
    paths = capture.views()
    views = []
    for done, path in enumerate(paths):
        report("board views", done, len(paths))
        views.append(inspect_view(path.name, read_image(path), board))
    report("board views", len(paths), len(paths))
    return compare_views(views, board)


def _intrinsics(views: tuple[BoardView, ...], capture: Capture) -> IntrinsicsResult:
    """The camera with radial and tangential distortion, whether or not its views alone call for both.

    A coefficient that is left out counts as exactly zero, and a biased centre of the image with a small standard
    deviation then spoils the joint adjustment; a coefficient with an honest standard deviation does not.
    """
    guess = capture.info.camera_matrix_guess
    chosen = calibrate_intrinsics(views, guess)
    if "p1" in chosen.model:
        return chosen
    return calibrate_intrinsics(views, guess, model=_LENS_MODEL)


def _travel(capture: Capture, data: ScannerData, report: Report) -> TravelResult | None:
    motion = capture.motion()
    if motion is None:
        return None
    board = board_of(capture, "motion/")
    views, carts = [], []
    for done, frame in enumerate(motion.read()):
        report("travel views", done, len(motion))
        if frame.image is None:
            raise FrameError(
                f"motion/{frame.entry.name} cannot be used: {frame.problem}; take it again or remove its line."
            )
        views.append(inspect_view(frame.entry.name, frame.image, board))
        carts.append(frame.entry.cart_mm)
    camera = data.camera.camera if data.camera is not None else data.base.camera
    inflation = data.camera.inflation if data.camera is not None else 1.0
    return calibrate_travel(views, np.array(carts), camera, thickness_mm=board.thickness_mm, inflation=inflation)


def _surface(capture: Capture, data: ScannerData, report: Report) -> tuple[ScannerData, PassStripes | None]:
    """Stripes, ToF readings, and surfaces of known place."""
    stripes = None
    if capture.laser is not None:
        stripes = read_stripes(capture, report=lambda done, total: report("frames", done, total))
        tables = tuple(
            # Where the lasers alternate, a frame without this one is no gap in its stripe.
            StripeTable(stripes.centre_px[k][lit], stripes.sd_px[k][lit], stripes.cart_mm[lit])
            for k, lit in enumerate(stripes.lit)
        )
        data = replace(data, stripes=tables, saturated_share=stripes.saturated_share)
        if len(stripes.cart_mm) < 2 or np.ptp(stripes.cart_mm) <= 0:
            raise CalibrationError(
                f"All {len(stripes.cart_mm)} frames of {capture.path / 'laser'} have the same cart_mm, so the pass "
                "has no length: write the cart's position of each frame into laser/frames.csv.",
                code="no-travel",
            )
    samples = capture.tof()
    if samples is not None:
        if capture.laser is None:
            raise CalibrationError(
                f"{capture.path} has a ToF pass but no laser pass, so the sensor cannot be placed: add laser/ over "
                "the same objects with the same cart origin.",
                code="no-overlap",
            )
        readings = TofReadings(samples.time_s, samples.cart_mm, samples.slide_mm, samples.reading)
        data = replace(data, tof=median_of_repeats(readings))
    camera = data.camera.camera if data.camera is not None else data.base.camera
    known: list[KnownPoints] = []
    if capture.sheets():
        known += read_sheet_views(capture, board_of(capture, "sheets/"), camera)
    known += read_blocks(capture)
    return replace(data, known=tuple(known)), stripes


def _require_anything(capture: Capture, data: ScannerData) -> None:
    if data.camera or data.travel or data.stripes or data.known:
        return
    wanted = ", ".join(sorted(data.parts))
    raise CalibrationError(
        f"{capture.path} holds nothing to calibrate {wanted} from: add camera/ (board views), motion/ (the board lying "
        "still), laser/ (a laser pass) or sheets/.",
        code="nothing-to-calibrate",
    )


def _sources(data: ScannerData, result: ScannerResult) -> dict[str, str]:
    sources = dict(data.base.sources)
    if data.camera is not None:
        sources["camera"] = f"calibrated from {sum(v.used for v in data.camera.views)} board views"
    if data.travel is not None:
        sources["travel"] = f"calibrated from {len(data.travel.views)} views of a board lying still"
        sources["bed_from_camera"] = sources["travel"]
    if result.joint is not None:
        if "camera" in data.parts and data.camera is None:
            sources["camera"] = "calibrated from the stripes alone"
        if "travel" in data.parts and data.travel is None:
            sources["travel"] = "calibrated from the stripes alone"
        sources["bed_from_camera"] = "calibrated from the stripes on the bed"
        if "sheets" in data.parts:
            sources["sheets"] = "calibrated jointly"
        if result.tof is not None and "tof" in data.parts:
            sources["tof"] = "calibrated jointly"
    return sources
