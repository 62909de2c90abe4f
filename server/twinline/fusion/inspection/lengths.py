"""Lengths between points and between surfaces: distances and step heights."""

from dataclasses import dataclass

import numpy as np

from twinline.arrays import FloatArray, IntArray
from twinline.errors import InputError
from twinline.fusion.inspection.plane import axes_across, fit_plane
from twinline.fusion.inspection.quantity import Quantity, measured_rows
from twinline.fusion.inspection.robust import robust_fit

_LEAST = 10


@dataclass(frozen=True, eq=False)
class Length:
    """A length and the points it came from.

    Attributes
    ----------
    length
        With its uncertainty.
    used : (m,) int array
        Rows of the points that it used.
    """

    length: Quantity
    used: IntArray


@dataclass(frozen=True, eq=False)
class StepHeight:
    """Height of one flat surface over another.

    Attributes
    ----------
    height
        Positive where the upper surface lies further along the normal.
    normal : (3,) array
        Common unit normal of both surfaces.
    parallel_deg
        Angle between the planes fitted to each surface alone.
    rms_mm
        Of the points used, from their plane.
    used_lower, used_upper : int arrays
        Rows, of each array given, that the fit used.
    """

    height: Quantity
    normal: FloatArray
    parallel_deg: float
    rms_mm: float
    used_lower: IntArray
    used_upper: IntArray


def point_distance(points_mm: FloatArray, first: int, second: int, sigma_mm: FloatArray | None = None) -> Length:
    """Distance between two measured points.

    Parameters
    ----------
    points_mm : (n, 3) array
    first, second
        Rows.
    sigma_mm : (n,) array, optional
        Standard deviation of each point; without it the uncertainty is NaN, since two points alone do not tell it.

    Raises
    ------
    InputError
        If a row does not exist or has no measurement.
    """
    for row in (first, second):
        if not 0 <= row < len(points_mm):
            raise InputError(f"There is no point {row}; the cloud has points 0 to {len(points_mm) - 1}.")
        if not np.isfinite(points_mm[row]).all():
            raise InputError(f"Point {row} has no measurement; choose another one.")
    between = np.asarray(points_mm[second], dtype=np.float64) - np.asarray(points_mm[first], dtype=np.float64)
    sigma = np.nan if sigma_mm is None else float(np.hypot(sigma_mm[first], sigma_mm[second]))
    return Length(Quantity(float(np.linalg.norm(between)), sigma), np.array([first, second]))


def step_height(
    lower_mm: FloatArray,
    upper_mm: FloatArray,
    lower_sigma_mm: FloatArray | None = None,
    upper_sigma_mm: FloatArray | None = None,
) -> StepHeight:
    """Height between two flat surfaces as the distance of two parallel planes fitted together.

    One common normal for both is what ISO 5436-1 (type A1) does with its two lines; two separate planes would let the
    tilt of the smaller one into the height.

    Parameters
    ----------
    lower_mm, upper_mm : (n, 3) and (m, 3) arrays
        NaN means "no measurement".
    lower_sigma_mm, upper_sigma_mm : (n,) and (m,) arrays, optional
        Standard deviation of each point.

    Raises
    ------
    InputError
        ``too-few-points``, ``undetermined``, or ``not-parallel`` beyond 5 degrees.
    """
    lower, upper = fit_plane(lower_mm, lower_sigma_mm), fit_plane(upper_mm, upper_sigma_mm)
    angle = float(np.degrees(np.arcsin(min(1.0, float(np.linalg.norm(np.cross(lower.normal, upper.normal)))))))
    if angle > 5.0:
        raise InputError(
            f"The surfaces lie at {angle:.1f}° to each other, so there is no step height between them; "
            "choose regions on parallel surfaces.",
            code="not-parallel",
        )
    places = (
        measured_rows(lower_mm, least=_LEAST, what="A step"),
        measured_rows(upper_mm, least=_LEAST, what="A step"),
    )
    origin = (lower.centre_mm + upper.centre_mm) / 2
    points = np.concatenate([lower_mm[places[0]], upper_mm[places[1]]]).astype(np.float64) - origin
    on_upper = np.arange(len(points)) >= len(places[0])
    members = np.column_stack([~on_upper, on_upper]).astype(np.float64)
    sigma = None
    if lower_sigma_mm is not None and upper_sigma_mm is not None:
        sigma = np.concatenate([lower_sigma_mm[places[0]], upper_sigma_mm[places[1]]])

    def linearise(state: FloatArray) -> tuple[FloatArray, FloatArray]:
        residuals = points @ state[:3] - members @ state[3:]
        return residuals, np.column_stack([-members, points @ axes_across(state[:3]).T])

    def move(state: FloatArray, step: FloatArray) -> FloatArray:
        normal = state[:3] + step[2:] @ axes_across(state[:3])
        size = float(np.linalg.norm(normal))
        return np.concatenate([normal, state[3:] + step[:2]]) / size

    normal = lower.normal if len(lower.used) >= len(upper.used) else upper.normal
    heights = [float(normal @ (plane.centre_mm - origin)) for plane in (lower, upper)]
    fit = robust_fit(np.append(normal, heights), linearise, move, points, sigma_mm=sigma)
    change = np.array([-1.0, 1.0, 0.0, 0.0])
    kept = fit.used
    return StepHeight(
        Quantity(float(fit.state[4] - fit.state[3]), float(np.sqrt(change @ fit.covariance @ change))),
        fit.state[:3],
        angle,
        float(np.sqrt(np.mean(fit.residuals_mm[kept] ** 2))),
        places[0][kept[: len(places[0])]],
        places[1][kept[len(places[0]) :]],
    )
