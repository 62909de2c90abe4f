"""The account of a calibration: residuals, uncertainties, agreement of the sensors, and the verdict on them."""

import numpy as np

from twinline.arrays import FloatArray
from twinline.calibration.joint import JointResult
from twinline.calibration.joint_model import Scanner, tof_points
from twinline.calibration.joint_priors import nominal_covariance
from twinline.calibration.joint_types import KINDS
from twinline.calibration.scanner import ScannerData, ScannerResult, bed_clouds
from twinline.calibration.scanner_evidence import (
    HIGH_CORRELATION,
    REJECTED_WEIGHT,
    UNSEEN_SHARE,
    Agreement,
    GroupEvidence,
    ParameterEvidence,
    ScannerEvidence,
)
from twinline.calibration.scanner_uncertainty import shape_sd_mm
from twinline.calibration.scanner_verdict import FEWEST_COMPARED, judge
from twinline.calibration.tof_start import height_map

_MAP_MM = 1.5


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
    verdict, reasons = judge(data, result, groups, shape, after, parameters)
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
            if len(difference) < FEWEST_COMPARED:
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
