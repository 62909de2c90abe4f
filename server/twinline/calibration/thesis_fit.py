"""The thesis's calibration of a laser: baseline and angle by Nelder-Mead against ToF depths (4.1, 4.2)."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from twinline.arrays import FloatArray
from twinline.calibration.thesis_picks import PickedPoints
from twinline.calibration.thesis_simplex import NelderMeadTrace, nelder_mead
from twinline.errors import CalibrationError
from twinline.geometry.camera import Camera
from twinline.geometry.sheet import LaserSheet, Side
from twinline.geometry.two_parameter import depth_mm

Lens = Literal["ignored", "undistorted"]
"""Whether a pixel's ray is the pinhole's, as in the thesis, or that of the calibrated lens."""

NAMES = ("baseline_mm", "angle_deg")
_STEPS = np.array([5.0, 2.0])
_NARROWEST = 2e-3
_TOLERANCE = 1e-8


@dataclass(frozen=True, eq=False)
class SheetFit:
    """A laser's two parameters, fitted.

    Attributes
    ----------
    sheet
        The plane of ``baseline_mm`` and ``angle_rad``.
    points
        The picked points that counted, without those that had no depth.
    residual_mm : (n,) array
        Z_laser - Z_ToF of each.
    lens
        What rays the fit used; a rig measures the same only with the same ones.
    trace
        Parameters ``baseline_mm`` and ``angle_deg``; the value is the sum of absolute residuals.
    """

    sheet: LaserSheet
    baseline_mm: float
    angle_rad: float
    points: PickedPoints
    residual_mm: FloatArray
    lens: Lens
    trace: NelderMeadTrace

    @property
    def sum_mm(self) -> float:
        """Sum of |Z_ToF - Z_laser|."""
        return float(np.abs(self.residual_mm).sum())


def fit_sheet(
    camera: Camera,
    side: Side,
    points: PickedPoints,
    *,
    start: LaserSheet | None = None,
    lens: Lens = "ignored",
    tolerance: float = _TOLERANCE,
) -> SheetFit:
    """Baseline d and angle theta of one laser by Nelder-Mead (4.1, 4.2).

    Minimised is ``sum_i |Z_ToF,i - d / (cot(theta) + tan(alpha_i))|``, the depth being (3.3-3.13) with
    ``tan(alpha) = (v - cy) / fy``, positive towards the laser. The model takes for granted that the sheet holds the
    image axis along the stripe and that the camera looks exactly down. Two points at two heights just determine it;
    then the sum ends at zero whatever the truth is, and says nothing about the calibration. With more points the sum of
    absolute differences follows the majority and passes over strays.

    Printed for the thesis's machine: d 246 + 5.6284 mm and theta 60 + 5.7536 degrees for laser 1, 246 + 5.4805 and
    60 + 2.4899 for laser 2.

    Parameters
    ----------
    side
        The side of the image on which the laser stands.
    start
        First guess; the thesis's 246 mm and 60 degrees where it is not given.
    lens
        ``"ignored"``, as in the thesis, or ``"undistorted"`` rays.
    tolerance
        Spread of the simplex, in millimetres and degrees, at which the search ends.

    Raises
    ------
    CalibrationError
        ``too-few-points``, ``sheet-unobservable``, ``bad-start`` or ``not-converged``.
    """
    tangent = _tangent(camera, side, points.pixels, lens)
    usable = np.isfinite(tangent) & np.isfinite(points.depth_mm)
    tangent, depth = tangent[usable], points.depth_mm[usable]
    _require_two_heights(tangent, depth, len(points))
    alpha = np.arctan(tangent)

    def residuals(parameters: FloatArray) -> FloatArray:
        return np.asarray(depth_mm(float(parameters[0]), float(np.radians(parameters[1])), alpha)) - depth

    def total(parameters: FloatArray) -> float:
        if not (parameters[0] > 0 and 0 < parameters[1] < 180):
            return float("inf")
        value = float(np.abs(residuals(parameters)).sum())
        # A depth that the model cannot give is worse than any other.
        return value if np.isfinite(value) else float("inf")

    first = np.array([246.0, 60.0]) if start is None else np.array([start.baseline_mm, np.degrees(start.angle_rad)])
    trace = nelder_mead(total, first, _STEPS, NAMES, tolerance=tolerance)
    baseline, angle = float(trace.parameters[-1, 0]), float(np.radians(trace.parameters[-1, 1]))
    return SheetFit(
        LaserSheet.from_baseline_angle(baseline, angle, side),
        baseline,
        angle,
        PickedPoints(points.pixels[usable], depth),
        residuals(trace.parameters[-1]),
        lens,
        trace,
    )


def _tangent(camera: Camera, side: Side, pixels: FloatArray, lens: Lens) -> FloatArray:
    axis = "uv".index(side[1])
    if lens == "undistorted":
        tangent = camera.rays(pixels)[:, axis]
    else:
        centre, focal = ((camera.cx, camera.fx), (camera.cy, camera.fy))[axis]
        tangent = (pixels[:, axis] - centre) / focal
    return np.asarray(tangent if side[0] == "+" else -tangent)


def _require_two_heights(tangent: FloatArray, depth: FloatArray, given: int) -> None:
    if len(tangent) < 2:
        raise CalibrationError(
            f"Of {given} picked points {len(tangent)} have both a stripe and a ToF depth, and two parameters need two "
            "points: pick more places that both passes saw.",
            code="too-few-points",
        )
    if (depth <= 0).any():
        raise CalibrationError(
            f"A ToF depth of {depth.min():.1f} mm lies behind the camera: depths count from the camera downwards, so "
            "give the camera's height less the surface's.",
            code="bad-picks",
        )
    if np.ptp(tangent) < _NARROWEST or np.ptp(depth) <= 0:
        raise CalibrationError(
            f"All picked points have the same height within {np.ptp(depth):.2f} mm, which leaves baseline and angle of "
            "the laser undetermined: add points on an object at least 10 mm high.",
            code="sheet-unobservable",
        )
