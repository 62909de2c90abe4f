"""Best-fit cylinder: diameter, form and axis, also from a part of its circumference."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from twinline.arrays import FloatArray, IntArray
from twinline.errors import InputError
from twinline.fusion.inspection.plane import axes_across
from twinline.fusion.inspection.quantity import Quantity, measured_rows, trimmed_range
from twinline.fusion.inspection.robust import robust_fit

_LEAST = 30
_LOOKED_AT = 1500
_NEIGHBOURS = 24
_AXIS_TRIALS = 60
_CIRCLE_TRIALS = 60


@dataclass(frozen=True, eq=False)
class CylinderFit:
    """A cylinder through points, robust against those of other surfaces.

    Attributes
    ----------
    point_mm : (3,) array
        Point of the axis amid the points used.
    axis : (3,) array
        Unit direction; its largest component is positive.
    diameter
        With its uncertainty.
    tilt_sigma_deg
        Standard deviation of the axis' direction.
    form
        Range of the radial deviations of all measured points but the outermost 0.3 %.
    rms_mm
        Of the points used.
    deviation_mm : (n,) array
        Distance from the axis minus the radius, NaN where nothing was measured.
    used : (m,) int array
        Rows of the points that the fit used.
    measured
        Number of points with a measurement.
    """

    point_mm: FloatArray
    axis: FloatArray
    diameter: Quantity
    tilt_sigma_deg: float
    form: Quantity
    rms_mm: float
    deviation_mm: FloatArray
    used: IntArray
    measured: int


def fit_cylinder(points_mm: FloatArray, sigma_mm: FloatArray | None = None) -> CylinderFit:
    """Fit the cylinder on which most of the points lie; up to half of them may lie elsewhere.

    Parameters
    ----------
    points_mm : (n, 3) array
        NaN means "no measurement".
    sigma_mm : (n,) array, optional
        Standard deviation of each point.

    Raises
    ------
    InputError
        ``too-few-points``, or ``undetermined`` if the points are as good as flat, or show no axis (as a sphere's).
    """
    rows = measured_rows(points_mm, least=_LEAST, what="A cylinder")
    points = np.asarray(points_mm, dtype=np.float64)[rows]
    weight = None if sigma_mm is None else np.asarray(sigma_mm)[rows]
    origin = np.median(points, axis=0)
    local = points - origin
    fit = robust_fit(_start(local), lambda s: _linearise(s, local), _move, local, sigma_mm=weight)
    radius, sd = float(fit.state[6]), float(np.sqrt(fit.covariance[4, 4]))
    tilt = float(np.degrees(np.sqrt(fit.covariance[2, 2] + fit.covariance[3, 3])))
    if not sd < 0.25 * radius or not tilt < 30.0:
        raise InputError(
            f"The points determine no cylinder (radius {radius:.3g} ± {sd:.2g} mm, axis ± {tilt:.2g}°); "
            "choose a region that shows more of its circumference and length.",
            code="undetermined",
        )
    axis = fit.state[3:6]
    along = float(np.median((local[fit.used] - fit.state[:3]) @ axis))
    deviation = np.full(len(points_mm), np.nan)
    deviation[rows] = fit.residuals_mm
    return CylinderFit(
        fit.state[:3] + along * axis + origin,
        axis * float(np.sign(axis[int(np.argmax(np.abs(axis)))])),
        Quantity(2.0 * radius, 2.0 * sd),
        tilt,
        trimmed_range(fit.residuals_mm, weight),
        float(np.sqrt(np.mean(fit.residuals_mm[fit.used] ** 2))),
        deviation,
        rows[fit.used],
        len(rows),
    )


def _start(points: FloatArray) -> FloatArray:
    """Point of the axis, direction, radius: the best of many axes across two normals, by its median distance."""
    rng = np.random.default_rng(0)
    places = np.arange(len(points))
    if len(points) > _LOOKED_AT:
        places = rng.choice(len(points), _LOOKED_AT, replace=False)
    some = points[places]
    normals = _normals(points, some)
    pairs = rng.integers(0, len(some), (_AXIS_TRIALS, 2))
    axes = np.cross(normals[pairs[:, 0]], normals[pairs[:, 1]])
    length = np.linalg.norm(axes, axis=1)
    axes = axes[length > 0.05] / length[length > 0.05, None]
    # The direction across all normals is best for a whole cylinder and useless among other surfaces.
    axes = np.vstack([axes, np.linalg.eigh(normals.T @ normals)[1][:, 0]])
    found = [_circle(some, axis, rng) for axis in axes]
    known = [(misfit, state) for misfit, state in found if np.isfinite(misfit)]
    if not known:
        raise InputError(
            "The points lie in a plane and determine no cylinder; choose a region that shows more of it.",
            code="undetermined",
        )
    return min(known, key=lambda one: one[0])[1]


def _normals(points: FloatArray, some: FloatArray) -> FloatArray:
    tree = cKDTree(points)
    near = points[tree.query(some, k=min(_NEIGHBOURS, len(points)))[1]]
    near = near - near.mean(axis=1, keepdims=True)
    return np.asarray(np.linalg.eigh(np.einsum("nki,nkj->nij", near, near))[1][:, :, 0])


def _circle(points: FloatArray, axis: FloatArray, rng: np.random.Generator) -> tuple[float, FloatArray]:
    """Median misfit and state of the best circle that the points show when seen along an axis."""
    across = axes_across(axis)
    flat = points @ across.T
    corners = flat[rng.integers(0, len(flat), (_CIRCLE_TRIALS, 3))]
    sides = 2.0 * (corners[:, 1:] - corners[:, :1])
    squares = (corners[:, 1:] ** 2).sum(axis=2) - (corners[:, :1] ** 2).sum(axis=2)
    size = float(np.ptp(flat, axis=0).max() or 1.0)
    solvable = np.abs(np.linalg.det(sides)) > 1e-6 * size**2
    if not solvable.any():
        return np.inf, np.zeros(7)
    centres = np.linalg.solve(sides[solvable], squares[solvable][..., None])[..., 0]
    radii = np.linalg.norm(corners[solvable, 0] - centres, axis=1)
    apart = np.linalg.norm(flat[:, None, :] - centres[None], axis=2)
    misfit = np.median(np.abs(apart - radii), axis=0)
    # A huge circle is a plane in disguise.
    misfit[radii > 20.0 * size] = np.inf
    best = int(np.argmin(misfit))
    return float(misfit[best]), np.concatenate([centres[best] @ across, axis, radii[best : best + 1]])


def _linearise(state: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Radial residuals; parameters are two shifts and two tilts across the axis, and the radius."""
    point, axis, radius = state[:3], state[3:6], state[6]
    across = axes_across(axis)
    from_axis = points - point
    along = from_axis @ axis
    flat = from_axis @ across.T
    length = np.hypot(flat[:, 0], flat[:, 1])
    direction = flat / np.maximum(length, 1e-12)[:, None]
    return length - radius, np.column_stack([-direction, -direction * along[:, None], -np.ones(len(points))])


def _move(state: FloatArray, step: FloatArray) -> FloatArray:
    across = axes_across(state[3:6])
    axis = state[3:6] + step[2:4] @ across
    return np.concatenate([state[:3] + step[:2] @ across, axis / np.linalg.norm(axis), state[6:] + step[4]])
