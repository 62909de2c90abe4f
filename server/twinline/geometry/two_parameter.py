"""The machine's closed-form equations under the two-parameter model of a laser: baseline and angle.

The model takes for granted that the sheet holds the image axis along the stripe, that the camera looks exactly down,
and that the lens has no distortion. It serves for planning, for the two-parameter calibration and as a readable
summary; points are measured with the full model of `twinline.geometry.triangulation`, and a rig's own limits are in
`twinline.geometry.optics`.

The ray angle ``alpha`` is that of a pixel's ray to the optical axis in the travel plane, positive towards the laser.
Equation numbers in docstrings are those of the thesis that describes the machine; where its printed form is wrong, the
docstring says so.
"""

import numpy as np

from twinline.arrays import FloatArray

Value = float | FloatArray
"""A number or an array of them; results have the shape of what went in."""


def cart_advance_mm(step_rad: float, wheel_radius_mm: float, motor_pulley: float, hub_pulley: float) -> float:
    """Travel of the cart per motor step (2.1-2.3): ``R1 step R3 / R2``.

    The default machine's 0.36 degrees, 64 mm, 8 and 32 give 0.10053 mm; rounding that to 0.1 mm is a scale error of
    0.53 %.
    """
    return wheel_radius_mm * step_rad * motor_pulley / hub_pulley


def slide_advance_mm(step_rad: float, pitch_mm: float) -> float:
    """Travel of the slide per motor step (2.4-2.5): ``step / (2 pi) pitch``.

    With 0.72 degrees and a pitch of 2.5 mm this is 0.005 mm; the printed 0.05 mm is ten times too large.
    """
    return step_rad / (2.0 * np.pi) * pitch_mm


def focal_length_px(width_px: float, field_of_view_rad: float) -> float:
    """Focal length in pixels (3.1-3.2): ``(W / 2) / tan(FOV / 2)``; times the size of a pixel, in millimetres."""
    return float(width_px / 2.0 / np.tan(field_of_view_rad / 2.0))


def ray_angle_rad(pixel: Value, principal_px: float, focal_px: float) -> Value:
    """Ray angle alpha of a pixel coordinate across the stripe: ``atan((v - cy) / fy)``; positive towards +v."""
    return np.arctan((np.asarray(pixel) - principal_px) / focal_px)


def depth_mm(baseline_mm: float, angle_rad: float, alpha_rad: Value) -> Value:
    """Depth from the camera (3.3-3.13): ``Z = d / (cot(theta) + tan(alpha))``.

    Equal to ``d sin(theta) cos(alpha) / cos(alpha - theta)`` and, unlike it, harmless at 90 degrees. NaN where the ray
    does not meet the sheet in front of the camera.
    """
    inverse = (1.0 / np.tan(angle_rad) + np.tan(alpha_rad)) / baseline_mm
    return 1.0 / np.where(inverse > 0, inverse, np.nan)


def along_mm(depth: Value, alpha_rad: Value) -> Value:
    """Distance from the optical axis along the travel, positive towards the laser: ``Z tan(alpha)``."""
    return depth * np.tan(alpha_rad)


def across_mm(depth: Value, pixel: Value, principal_px: float, focal_px: float) -> Value:
    """Distance from the optical axis across the bed: ``Z (u - cx) / fx``."""
    return depth * (np.asarray(pixel) - principal_px) / focal_px


def depth_range_mm(baseline_mm: float, angle_rad: float, towards_rad: float, away_rad: float) -> tuple[float, float]:
    """Nearest and farthest depth in view (3.14-3.19).

    ``Zmin = d / (cot(theta) + tan(towards))`` and ``Zmax = d / (cot(theta) - tan(away))``, infinite if the sheet never
    leaves the view. The angles are those of the image's edges on the laser's side and on the other one, **along the
    travel**: the thesis uses a quarter of the horizontal field of view instead.
    """
    cot = 1.0 / float(np.tan(angle_rad))
    near, far = cot + float(np.tan(towards_rad)), cot - float(np.tan(away_rad))
    return (
        baseline_mm / near if near > 0 else float("nan"),
        baseline_mm / far if far > 0 else float("inf"),
    )


def depth_per_pixel_mm(depth: Value, baseline_mm: float, focal_px: float) -> Value:
    """Change of depth per pixel across the stripe (3.20-3.21): ``|dZ/dv| = Z^2 / (d fy)``.

    The printed ``0.0017 Z`` holds only on the optical axis, where ``Z = d tan(theta)``.
    """
    per_pixel: Value = np.square(depth) / (baseline_mm * focal_px)
    return per_pixel


def across_per_pixel_mm(depth: Value, focal_px: float) -> Value:
    """Size of a pixel across the bed: ``Z / fx``."""
    return np.asarray(depth) / focal_px


def depth_per_angle_mm(depth: Value, baseline_mm: float, angle_rad: float) -> Value:
    """Change of depth per radian of the laser's angle: ``dZ/dtheta = Z^2 / (d sin(theta)^2)``."""
    per_radian: Value = np.square(depth) / (baseline_mm * float(np.sin(angle_rad)) ** 2)
    return per_radian


def depth_per_baseline(depth: Value, baseline_mm: float) -> Value:
    """Change of depth per millimetre of the baseline: ``dZ/dd = Z / d``."""
    return np.asarray(depth) / baseline_mm


def crossing_depth_mm(baseline_mm: float, angle_rad: float) -> float:
    """Depth at which a stripe crosses the optical axis: ``d tan(theta)``; infinite from 90 degrees on."""
    return baseline_mm * float(np.tan(angle_rad)) if angle_rad < np.pi / 2 else float("inf")


def meeting_depth_mm(baselines_mm: tuple[float, float], angles_rad: tuple[float, float]) -> float:
    """Depth at which the stripes of two lasers on opposite sides meet: ``(d1 + d2) / (cot(theta1) + cot(theta2))``.

    Between the two crossing depths of the optical axis; infinite if the sheets never meet in front of the camera.
    """
    cot = sum(1.0 / float(np.tan(angle)) for angle in angles_rad)
    return sum(baselines_mm) / cot if cot > 0 else float("inf")


def laser_shadow_mm(height_mm: float, angle_rad: float) -> float:
    """Length along the travel that a step hides from the laser (3.22): ``h cot(theta)``, 0 from 90 degrees on."""
    return height_mm * max(1.0 / float(np.tan(angle_rad)), 0.0)


def camera_shadow_along_mm(height_mm: float, alpha_rad: float) -> float:
    """Length along the travel that a step hides from the camera (3.23): ``h |tan(alpha)|``, alpha taken at the bed.

    The printed form folds the sign and an offset in and is not used.
    """
    return height_mm * abs(float(np.tan(alpha_rad)))


def camera_shadow_across_mm(height_mm: float, across: float, bed_depth_mm: float) -> float:
    """Length across the bed that a step hides from the camera (3.23): ``h |X| / (Z_bed - h)``.

    Parameters
    ----------
    across
        Distance X of the step's top edge from the optical axis, across the bed, in millimetres.
    """
    return height_mm * abs(across) / (bed_depth_mm - height_mm)
