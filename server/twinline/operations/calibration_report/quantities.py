"""A scanner's parameters in words: what a person would measure on the machine, with standard deviations."""

from collections.abc import Callable

import numpy as np

from twinline.arrays import BoolArray, FloatArray
from twinline.calibration.joint_model import Scanner
from twinline.calibration.joint_priors import nominal_covariance
from twinline.calibration.scanner import ScannerResult, scanner_of_rig
from twinline.calibration.scanner_evidence import UNSEEN_SHARE
from twinline.geometry.rig import Rig
from twinline.operations.calibration_report.model import Quantity, Seen

_STEP_SDS = 0.01
_LENS = ("k1", "k2", "p1", "p2", "k3")

Item = tuple[str, str, str, int, float]
"""Part, name, unit, decimals, value."""


def readable(scanner: Scanner) -> list[Item]:
    """Properties of a scanner, always in the same order for the same kind of scanner.

    Angles are in degrees. *Tilts* are of the camera's optical axis against the bed's normal, along the travel and
    across it; *yaw* turns about the vertical; *climb* is the rise of a direction against the bed.
    """
    items: list[Item] = [
        ("Camera", name, "px", 2, float(value))
        for name, value in zip(
            ("focal length u", "focal length v", "centre u", "centre v"), scanner.camera, strict=False
        )
    ]
    items += [("Camera", f"lens {n}", "", 5, float(v)) for n, v in zip(_LENS, scanner.camera[4:], strict=True)]
    axes = scanner.axes()
    look = axes[:, 2]
    items += [
        ("Camera", "height above the bed", "mm", 3, scanner.height_mm()),
        ("Camera", "tilt along the travel", "°", 3, _degrees(look[0], -look[2])),
        ("Camera", "tilt across the travel", "°", 3, _degrees(look[1], -look[2])),
    ]
    travel = axes @ scanner.travel
    along, across = (1, 0) if scanner.stripe_runs == "along-u" else (0, 1)
    direction = scanner.travel * np.sign(scanner.travel[along])
    items += [
        ("Travel", "scale", "mm/mm", 5, float(np.linalg.norm(scanner.travel))),
        ("Travel", "yaw against the image", "°", 3, _degrees(direction[across], direction[along])),
        ("Travel", "climb against the bed", "°", 3, _degrees(travel[2], travel[0])),
    ]
    for k, (sheet, plane) in enumerate(zip(scanner.as_sheets(), scanner.sheets, strict=True), 1):
        items += [
            (f"Laser {k}", "baseline", "mm", 3, abs(sheet.baseline_mm)),
            (f"Laser {k}", "angle", "°", 4, float(np.degrees(sheet.angle_rad))),
            (f"Laser {k}", "yaw", "°", 3, _degrees(plane[across], abs(plane[along]))),
        ]
    return items + _tof(scanner, axes)


def _tof(scanner: Scanner, axes: FloatArray) -> list[Item]:
    tof = scanner.tof
    if tof is None:
        return []
    place = axes @ tof.position + np.array([0.0, 0.0, scanner.height_mm()])
    beam, slide = axes @ tof.beam, axes @ tof.slide
    return [
        *[("ToF sensor", f"place {n}", "mm", 2, float(v)) for n, v in zip("xyz", place, strict=True)],
        ("ToF sensor", "beam along the travel", "°", 2, _degrees(beam[0], -beam[2])),
        ("ToF sensor", "beam across the travel", "°", 2, _degrees(beam[1], -beam[2])),
        ("ToF sensor", "slide scale", "mm/mm", 4, float(np.linalg.norm(slide))),
        ("ToF sensor", "slide yaw", "°", 3, _degrees(-slide[0], slide[1])),
        ("ToF sensor", "slide climb", "°", 3, _degrees(slide[2], slide[1])),
        ("ToF sensor", "gain", "mm/unit", 6, tof.gain),
        ("ToF sensor", "lag", "ms", 2, 1000.0 * tof.lag_s),
    ]


def _degrees(rise: float, run: float) -> float:
    return float(np.degrees(np.arctan2(rise, run)))


def compare_quantities(base: Rig, thesis: Rig | None, result: ScannerResult | None) -> tuple[Quantity, ...]:
    """Every property before, by the thesis's method and by the joint one.

    Standard deviations are carried over from the adjustment's covariance to first order. A property counts as held by
    its prior where more than half of the variance that ruler and data sheet left is still there.
    """
    before = {(part, name): value for part, name, _, _, value in readable(scanner_of_rig(base))}
    by_thesis = {
        (part, name): value
        for part, name, _, _, value in (readable(scanner_of_rig(thesis)) if thesis is not None else [])
    }
    leading = result.scanner if result is not None else scanner_of_rig(thesis if thesis is not None else base)
    items = readable(leading)
    sd: FloatArray = np.full(len(items), np.nan)
    seen: list[Seen] = ["fixed"] * len(items)
    if result is not None:
        sd, seen = _certainty(result)
    nan = float("nan")
    return tuple(
        Quantity(
            part, name, unit, decimals,
            before.get((part, name), nan),
            by_thesis.get((part, name), nan),
            value if result is not None else nan,
            float(sd[i]),
            seen[i],
        )
        for i, (part, name, unit, decimals, value) in enumerate(items)
    )  # fmt: skip


def _certainty(result: ScannerResult) -> tuple[FloatArray, list[Seen]]:
    jacobian = _jacobian(lambda theta: _values(result.scanner.with_vector(theta)), result)
    variance = np.einsum("ij,jk,ik->i", jacobian, result.covariance, jacobian)
    prior = np.einsum("ij,jk,ik->i", jacobian, nominal_covariance(result.scanner, result.nominal), jacobian)
    adjusted: BoolArray = np.any(np.abs(jacobian[:, result.free]) > 0, axis=1)
    sd = np.sqrt(np.maximum(variance, 0.0))
    seen: list[Seen] = []
    for free, var, known in zip(adjusted, variance, prior, strict=True):
        if not free or not var > 0:
            seen.append("fixed")
        else:
            seen.append("prior" if var > UNSEEN_SHARE * known else "seen")
    return np.where(adjusted, sd, 0.0), seen


def _values(scanner: Scanner) -> FloatArray:
    return np.array([value for *_, value in readable(scanner)])


def _jacobian(function: Callable[[FloatArray], FloatArray], result: ScannerResult) -> FloatArray:
    """Central differences, in steps of a hundredth of a standard deviation."""
    theta = result.scanner.vector()
    sd = np.sqrt(np.maximum(np.diagonal(result.covariance), 0.0))
    jacobian = np.zeros((len(function(theta)), len(theta)))
    for i in np.flatnonzero(sd > 0):
        step = np.zeros(len(theta))
        step[i] = _STEP_SDS * sd[i]
        jacobian[:, i] = (function(theta + step) - function(theta - step)) / (2.0 * step[i])
    return jacobian
