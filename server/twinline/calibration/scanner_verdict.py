"""Whether a calibration is good, usable or refused, and why."""

from collections.abc import Sequence

import numpy as np

from twinline.calibration.intrinsics import IntrinsicsResult
from twinline.calibration.joint_priors import inverse_information
from twinline.calibration.scanner import ScannerData, ScannerResult
from twinline.calibration.scanner_evidence import (
    GOOD_AGREEMENT_MM,
    GOOD_HELD_OUT_RATIO,
    GOOD_REJECTED,
    GOOD_SATURATED,
    GOOD_SHAPE_SD_MM,
    REFUSED_AGREEMENT_MM,
    REFUSED_REJECTED,
    REFUSED_SATURATED,
    REFUSED_SHAPE_SD_MM,
    Agreement,
    GroupEvidence,
    ParameterEvidence,
    Verdict,
)
from twinline.calibration.travel import TravelResult

FEWEST_COMPARED = 20
"""Observations of a kind, below which their scatter means nothing."""

_CONTRADICTION_SDS = 4.0


def judge(
    data: ScannerData, result: ScannerResult, groups: Sequence[GroupEvidence], shape_mm: float,
    after: Sequence[Agreement], parameters: Sequence[ParameterEvidence],
) -> tuple[Verdict, tuple[str, ...]]:  # fmt: skip
    """The verdict on a calibration with its reasons, what refuses it first.

    Parameters
    ----------
    shape_mm
        Uncertainty of a scan's shape.
    after
        Agreement of the sensors under the new rig.
    """
    refused: list[str] = []
    doubts = list(_instrument_doubts(data.camera, data.travel, data.parts))
    if "sheets" in data.parts and result.joint is not None:
        refused += _shape_refusals(shape_mm)
        doubts += _shape_doubts(shape_mm)
        refused += _missing_lasers(result, groups)
        for k, share in enumerate(data.saturated_share):
            if share > GOOD_SATURATED:
                (refused if share > REFUSED_SATURATED else doubts).append(_saturated(k, share))
    for pair in after:
        refused += _disagreement_refusals(pair)
        doubts += _disagreement_doubts(pair)
    for group in groups:
        refused += _group_refusals(group)
        doubts += _group_doubts(group)
    for p in parameters:
        off = _contradiction(result, p.name)
        if off > _CONTRADICTION_SDS:
            doubts.append(
                f"{p.name} moved {off:.1f} standard deviations from what was known of it before; check that part of "
                "the capture."
            )
    if refused:
        return "refused", tuple(refused + doubts)
    return ("usable" if doubts else "good"), tuple(doubts)


def _shape_refusals(shape_mm: float) -> list[str]:
    if shape_mm <= REFUSED_SHAPE_SD_MM:
        return []
    return [
        (
            f"The observations leave the shape of a scan uncertain by {shape_mm:.2f} mm (limit "
            f"{REFUSED_SHAPE_SD_MM:g}): "
            "scan objects of different heights that both lasers see, or add a ToF pass or sheets/."
        )
    ]


def _shape_doubts(shape_mm: float) -> list[str]:
    if not GOOD_SHAPE_SD_MM < shape_mm <= REFUSED_SHAPE_SD_MM:
        return []
    return [
        (
            f"The shape of a scan is uncertain by {shape_mm:.3f} mm (good is {GOOD_SHAPE_SD_MM:g}): add what is "
            "missing of camera/, motion/, tof/ and sheets/, or scan higher objects."
        )
    ]


def _missing_lasers(result: ScannerResult, groups: Sequence[GroupEvidence]) -> list[str]:
    return [
        f"No stripe of laser {k + 1} was found on any surface: check that it was on, and its side in capture.json."
        for k in range(len(result.scanner.sheets))
        if not any(f"laser {k + 1}" in group.kind for group in groups)
    ]


def _saturated(laser: int, share: float) -> str:
    return (
        f"{100 * share:.0f} % of the stripes of laser {laser + 1} are saturated (good is {100 * GOOD_SATURATED:.0f} %, "
        f"limit {100 * REFUSED_SATURATED:.0f} %): their middle is cut off, so only their flanks say where they lie; "
        "shorten the exposure or dim the laser, and record the pass again."
    )


def _disagreement_refusals(pair: Agreement) -> list[str]:
    if pair.typical_mm <= REFUSED_AGREEMENT_MM:
        return []
    return [
        (
            f"After calibration {pair.pair} still differ by {pair.typical_mm:.2f} mm typically (limit "
            f"{REFUSED_AGREEMENT_MM:g}): an object moved between the passes, positions are wrong, or stripes lie on "
            "the wrong surface; record the pass again."
        )
    ]


def _disagreement_doubts(pair: Agreement) -> list[str]:
    if pair.typical_mm > REFUSED_AGREEMENT_MM or pair.p90_mm <= REFUSED_AGREEMENT_MM:
        return []
    return [
        (
            f"{pair.pair[0].upper()}{pair.pair[1:]}: one place in ten differs by more than {pair.p90_mm:.2f} mm (good "
            f"is {REFUSED_AGREEMENT_MM:g}); part of the surface does not fit."
        )
    ]


def _contradiction(result: ScannerResult, name: str) -> float:
    """How far a calibrated camera or travel was pulled from its own calibration, in its own standard deviations."""
    if not name.startswith(("camera.", "travel.")):
        return 0.0
    index = result.scanner.names().index(name)
    theta = result.scanner.vector()
    for prior in result.priors:
        if index in prior.index:
            place = int(np.flatnonzero(prior.index == index)[0])
            sd = float(np.sqrt(inverse_information(prior.information)[place, place]))
            expected = float(prior.values[place])
            if prior.shift is not None:
                expected += float(prior.shift[place] @ (theta[prior.on] - prior.at))
            return abs(float(theta[index]) - expected) / sd if sd > 0 else 0.0
    return 0.0


def _group_refusals(group: GroupEvidence) -> list[str]:
    if group.rejected_share <= REFUSED_REJECTED:
        return []
    return [
        (
            f"{100 * group.rejected_share:.0f} % of the observations of {group.kind} had to be rejected (limit "
            f"{100 * REFUSED_REJECTED:.0f} %): they contradict the others; record them again."
        )
    ]


def _group_doubts(group: GroupEvidence) -> list[str]:
    doubts = []
    if GOOD_REJECTED < group.rejected_share <= REFUSED_REJECTED:
        doubts.append(
            f"{100 * group.rejected_share:.0f} % of the observations of {group.kind} were rejected as gross errors."
        )
    if group.systematic_mm > GOOD_AGREEMENT_MM and group.observations >= FEWEST_COMPARED:
        doubts.append(
            f"{group.kind[0].upper()}{group.kind[1:]}: groups scatter by {group.systematic_mm:.2f} mm, more than their "
            f"noise explains (good is {GOOD_AGREEMENT_MM:g})."
        )
    usual = max(group.systematic_mm, 0.015)
    if np.isfinite(group.held_out_mm) and group.held_out_mm > 3 * GOOD_HELD_OUT_RATIO * max(usual, group.rms_mm):
        doubts.append(
            f"{group.kind[0].upper()}{group.kind[1:]}: held-out groups miss by {group.held_out_mm:.3f} mm where "
            f"fitted ones miss by {group.rms_mm:.3f} mm; there are too few of them."
        )
    return doubts


def _instrument_doubts(
    camera: IntrinsicsResult | None, travel: TravelResult | None, parts: frozenset[str]
) -> tuple[str, ...]:
    doubts: list[str] = []
    if "camera" in parts:
        if camera is None:
            doubts.append(
                "There are no views in camera/: the lens is known by its data sheet only; add 15 board views."
            )
        else:
            doubts.extend(camera.warnings)
    if "travel" in parts:
        if travel is None:
            doubts.append(
                "There is no motion/: the scale of the travel is the commanded one; add views of a board lying still."
            )
        else:
            doubts.extend(travel.warnings)
            if travel.dropped:
                doubts.append(
                    f"Views of motion/ that contradict the others were left out: {', '.join(travel.dropped)}."
                )
    return tuple(doubts)
