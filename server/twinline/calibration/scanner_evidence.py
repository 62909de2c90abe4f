"""What a calibration of a scanner can be believed on: numbers that can fail, and a verdict that says why.

Residuals are given over all observations, with the share that the robust loss rejected, and over groups that were left
out of the fit. What no observation determines is named.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from twinline.arrays import FloatArray
from twinline.calibration.intrinsics import IntrinsicsResult
from twinline.calibration.joint import JointResult
from twinline.calibration.joint_model import Scanner, bed_height, laser_jacobian, laser_samples, tof_points
from twinline.calibration.joint_priors import inverse_information, nominal_covariance
from twinline.calibration.joint_types import KINDS
from twinline.calibration.observations import StripePoints
from twinline.calibration.scanner import ScannerData, ScannerResult, bed_clouds
from twinline.calibration.tof_start import height_map
from twinline.calibration.travel import TravelResult

Verdict = Literal["good", "usable", "refused"]

HIGH_CORRELATION = 0.95
UNSEEN_SHARE = 0.5
REJECTED_WEIGHT = 0.1
GOOD_SHAPE_SD_MM = 0.05
REFUSED_SHAPE_SD_MM = 3.0
GOOD_AGREEMENT_MM = 0.05
REFUSED_AGREEMENT_MM = 0.5
GOOD_REJECTED = 0.2
REFUSED_REJECTED = 0.5
GOOD_HELD_OUT_RATIO = 2.0
_CONTRADICTION_SDS = 4.0
_GRID = 9
_VOLUME_SHARE = 0.1
_USUAL_PASS_MM = 200.0
_MAP_MM = 1.5
_FEWEST_COMPARED = 20


@dataclass(frozen=True)
class GroupEvidence:
    """One kind of observation.

    Attributes
    ----------
    observations
        Groups, each of which counts once.
    rms_mm, held_out_mm
        Root mean square residual over all of them, none left out for its size, and over those that an adjustment did
        without; NaN if there are none.
    mean_mm
        What is left systematically.
    rejected_share
        Share whose weight in the robust loss fell below 0.1.
    systematic_mm
        Standard deviation of a group beyond the noise of its measurements.
    """

    kind: str
    observations: int
    rms_mm: float
    held_out_mm: float
    mean_mm: float
    rejected_share: float
    systematic_mm: float


@dataclass(frozen=True)
class ParameterEvidence:
    """One parameter: value, standard deviation, and the share of its variance that only the prior holds (0 to 1)."""

    name: str
    value: float
    sd: float
    from_prior: float


@dataclass(frozen=True)
class Agreement:
    """Difference of two height maps at the same places, robust and in full: median, median and 90th percentile size."""

    pair: str
    cells: int
    median_mm: float
    typical_mm: float
    p90_mm: float


@dataclass(frozen=True, eq=False)
class ScannerEvidence:
    """The whole account.

    Attributes
    ----------
    parts_used
        Parts of the capture that served as observations, in words.
    correlations
        Pairs of parameters above 0.95.
    unseen
        Parameters that no observation determines; a prior holds them.
    shape_sd_mm
        Root mean square uncertainty that the calibration gives to the shape of a scan over the swept volume, a motion
        of the whole excepted.
    before, after
        Agreement of the sensors on the same scan under the rig before and after.
    stray_share
        Share of the stripes that contradict their surroundings, per laser.
    """

    verdict: Verdict
    reasons: tuple[str, ...]
    parts_used: tuple[str, ...]
    groups: tuple[GroupEvidence, ...]
    parameters: tuple[ParameterEvidence, ...]
    correlations: tuple[tuple[str, str, float], ...]
    unseen: tuple[str, ...]
    shape_sd_mm: float
    before: tuple[Agreement, ...]
    after: tuple[Agreement, ...]
    stray_share: tuple[float, ...]
    camera_rms_px: float
    camera_held_out_px: float
    travel_rms_px: float
    travel_held_out_px: float
    travel_scale: float
    notes: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """The same as plain JSON values; what is not known is null."""
        return {name: _plain(value) for name, value in asdict(self).items()}


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value


def gather_evidence(data: ScannerData, result: ScannerResult, before: Scanner) -> ScannerEvidence:
    """Account for a calibration.

    Parameters
    ----------
    before
        The scanner by which the same scan is compared: nominal, or the earlier calibration.
    """
    groups = _groups(result.joint, result.held_out)
    parameters = _parameters(result)
    unseen = tuple(p.name for p in parameters if p.from_prior > UNSEEN_SHARE)
    shape = shape_sd_mm(result)
    after = _agreements(result.scanner, result) if result.seen else ()
    earlier = _agreements(before, result) if result.seen else ()
    verdict, reasons = _judge(data, result, groups, shape, after, parameters)
    camera, travel = data.camera, data.travel
    nan = float("nan")
    return ScannerEvidence(
        verdict=verdict,
        reasons=reasons,
        parts_used=_parts_used(data, result),
        groups=groups,
        parameters=parameters,
        correlations=_correlations(result),
        unseen=unseen,
        shape_sd_mm=shape,
        before=earlier,
        after=after,
        stray_share=tuple(s.stray_share for s in result.seen),
        camera_rms_px=camera.rms_px if camera else nan,
        camera_held_out_px=camera.held_out_rms_px if camera else nan,
        travel_rms_px=travel.rms_px if travel else nan,
        travel_held_out_px=travel.held_out_px if travel else nan,
        travel_scale=float(np.linalg.norm(result.scanner.travel)),
        notes=result.notes,
    )


def _groups(joint: JointResult | None, held_out: JointResult | None) -> tuple[GroupEvidence, ...]:
    if joint is None:
        return ()
    found = []
    for kind, name in enumerate(KINDS):
        here = joint.rows.kind == kind
        if not here.any():
            continue
        residual = joint.rows.residual[here]
        out = held_out is not None and (held_out.rows.kind == kind) & held_out.rows.held_out
        left = held_out.rows.residual[out] if held_out is not None else np.empty(0)
        found.append(
            GroupEvidence(
                name,
                int(here.sum()),
                float(np.sqrt(np.mean(residual**2))),
                float(np.sqrt(np.mean(left**2))) if len(left) else float("nan"),
                float(residual.mean()),
                float(np.mean(joint.weights[here] < REJECTED_WEIGHT)),
                float(joint.systematic_mm[kind]),
            )
        )
    return tuple(found)


def _parameters(result: ScannerResult) -> tuple[ParameterEvidence, ...]:
    """Share of each parameter's variance that is left of what a ruler and a data sheet knew."""
    theta = result.scanner.vector()
    prior_variance = np.diagonal(nominal_covariance(result.scanner, result.nominal))
    variance = np.diagonal(result.covariance)
    return tuple(
        ParameterEvidence(
            name, float(value), float(np.sqrt(max(var, 0.0))), float(np.clip(var / max(prior, 1e-300), 0.0, 1.0))
        )
        for name, value, var, prior, free in zip(
            result.scanner.names(), theta, variance, prior_variance, result.free, strict=True
        )
        if free
    )


def _correlations(result: ScannerResult) -> tuple[tuple[str, str, float], ...]:
    names = result.scanner.names()
    sd = np.sqrt(np.maximum(np.diagonal(result.covariance), 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        matrix = result.covariance / np.outer(sd, sd)
    both = np.outer(result.free, result.free) & (np.abs(np.nan_to_num(matrix)) > HIGH_CORRELATION)
    return tuple((names[i], names[j], float(matrix[i, j])) for i, j in np.argwhere(np.triu(both, 1)))


def shape_sd_mm(result: ScannerResult) -> float:
    """Uncertainty of a scan's shape from the calibration: root mean square over points in the swept volume.

    A rigid motion of the whole scan changes no shape; it is taken out by projection.
    """
    points, jacobian = _volume(result)
    if not len(points):
        return float("nan")
    count = len(points)
    centred = points - points.mean(axis=0)
    rigid = np.zeros((3 * count, 6))
    for i in range(3):
        unit = np.eye(3)[i]
        rigid[i::3, i] = 1.0
        rigid[:, 3 + i] = np.cross(unit, centred).ravel()
    rest = jacobian - rigid @ np.linalg.lstsq(rigid, jacobian, rcond=None)[0]
    return float(np.sqrt(max(np.einsum("ij,jk,ik->", rest, result.covariance, rest), 0.0) / count))


def _volume(result: ScannerResult) -> tuple[FloatArray, FloatArray]:
    """Points over the measuring volume and their derivatives, (n, 3) and (3n, parameters).

    From the bed up to a tenth of the camera's height, over the whole picture and the length of the pass, whether or not
    anything stood there.
    """
    scanner = result.scanner
    width, height = scanner.size
    u, v = np.meshgrid(np.linspace(0, width - 1, _GRID), np.linspace(0, height - 1, 4 * _GRID))
    carts = np.concatenate([s.bed.cart_mm for s in result.seen] or [np.array([0.0, _USUAL_PASS_MM])])
    if not len(carts):
        carts = np.array([0.0, _USUAL_PASS_MM])
    points, rows = [], []
    for k in range(len(scanner.sheets)):
        pixels = np.column_stack([u.ravel(), v.ravel()])
        for cart in (float(carts.min()), float(carts.max())):
            samples = laser_samples(scanner, k, StripePoints(pixels, np.ones(len(pixels)), np.full(len(pixels), cart)))
            up = bed_height(scanner, samples.points - scanner.travel * cart)
            with np.errstate(invalid="ignore"):
                samples = samples.take((up > -1.0) & (up < _VOLUME_SHARE * scanner.height_mm()))
            points.append(samples.points)
            by_axis = [
                laser_jacobian(scanner, samples, np.broadcast_to(np.eye(3)[i], samples.points.shape)) for i in range(3)
            ]
            rows.append(np.stack(by_axis, axis=1).reshape(-1, len(scanner.vector())))
    return np.concatenate(points), np.concatenate(rows)


def _agreements(scanner: Scanner, result: ScannerResult) -> tuple[Agreement, ...]:
    """Height maps of the sensors against each other, on objects."""
    clouds = bed_clouds(scanner, [s.objects for s in result.seen])
    names = [f"laser {k + 1}" for k in range(len(clouds))]
    if result.tof is not None and result.observations is not None and result.observations.tof_objects is not None:
        mounted = scanner if scanner.tof is not None else None
        if mounted is not None:
            points = tof_points(mounted, result.observations.tof_objects) @ scanner.axes().T
            clouds.append(points + np.array([0.0, 0.0, scanner.height_mm()]))
            names.append("ToF")
    found = []
    for i in range(len(clouds)):
        for j in range(i + 1, len(clouds)):
            difference = _difference(clouds[i], clouds[j], max(result.cell_mm, _MAP_MM))
            if len(difference) < _FEWEST_COMPARED:
                continue
            size = np.abs(difference)
            found.append(
                Agreement(
                    f"{names[i]} against {names[j]}",
                    len(difference),
                    float(np.median(difference)),
                    float(np.median(size)),
                    float(np.percentile(size, 90)),
                )
            )
    return tuple(found)


def _difference(first: FloatArray, second: FloatArray, cell_mm: float) -> FloatArray:
    if not (np.isfinite(first).all(axis=1).any() and np.isfinite(second).all(axis=1).any()):
        return np.empty(0)
    surface = height_map([first], [], cell_mm)
    other = second[np.isfinite(second).all(axis=1)]
    difference = surface.at(other[:, 0], other[:, 1]) - other[:, 2]
    return np.asarray(difference[np.isfinite(difference)])


def _parts_used(data: ScannerData, result: ScannerResult) -> tuple[str, ...]:
    used = []
    if data.camera is not None:
        used.append(f"camera/: {sum(v.used for v in data.camera.views)} of {len(data.camera.views)} views")
    if data.travel is not None:
        used.append(f"motion/: {len(data.travel.views)} views")
    if data.stripes:
        counts = " and ".join(str(len(s.objects)) for s in result.seen)
        used.append(f"laser/: {len(data.stripes[0].cart_mm)} frames, {counts} points on objects")
    if result.tof is not None:
        used.append(f"tof/: {len(result.tof)} readings")
    used.extend(f"{len(k.offset)} stripes of laser {k.laser + 1} on surfaces of known place" for k in data.known)
    return tuple(used)


def _judge(
    data: ScannerData, result: ScannerResult, groups: Sequence[GroupEvidence], shape: float,
    after: Sequence[Agreement], parameters: Sequence[ParameterEvidence],
) -> tuple[Verdict, tuple[str, ...]]:  # fmt: skip
    refused, doubts = [], list(_instrument_doubts(data.camera, data.travel, data.parts))
    if "sheets" in data.parts and result.joint is not None:
        if not shape <= REFUSED_SHAPE_SD_MM:
            refused.append(
                f"The observations leave the shape of a scan uncertain by {shape:.2f} mm (limit "
                f"{REFUSED_SHAPE_SD_MM:g}): "
                "scan objects of different heights that both lasers see, or add a ToF pass or sheets/."
            )
        elif shape > GOOD_SHAPE_SD_MM:
            doubts.append(
                f"The shape of a scan is uncertain by {shape:.3f} mm (good is {GOOD_SHAPE_SD_MM:g}): add what is "
                "missing of camera/, motion/, tof/ and sheets/, or scan higher objects."
            )
    if "sheets" in data.parts and result.joint is not None:
        refused.extend(
            f"No stripe of laser {k + 1} was found on any surface: check that it was on, and its side in capture.json."
            for k in range(len(result.scanner.sheets))
            if not any(f"laser {k + 1}" in group.kind for group in groups)
        )
    for pair in after:
        if pair.typical_mm > REFUSED_AGREEMENT_MM:
            refused.append(
                f"After calibration {pair.pair} still differ by {pair.typical_mm:.2f} mm typically (limit "
                f"{REFUSED_AGREEMENT_MM:g}): an object moved between the passes, positions are wrong, or stripes lie "
                "on the wrong surface; record the pass again."
            )
        elif pair.p90_mm > REFUSED_AGREEMENT_MM:
            doubts.append(
                f"{pair.pair[0].upper()}{pair.pair[1:]}: one place in ten differs by more than {pair.p90_mm:.2f} mm "
                f"(good is {REFUSED_AGREEMENT_MM:g}); part of the surface does not fit."
            )
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
    if group.systematic_mm > GOOD_AGREEMENT_MM and group.observations >= _FEWEST_COMPARED:
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
