"""Best-fit plane and flatness."""

from dataclasses import dataclass

import numpy as np

from twinline.arrays import FloatArray, IntArray
from twinline.errors import InputError
from twinline.fusion.inspection.quantity import Quantity, measured_rows, trimmed_range
from twinline.fusion.inspection.robust import robust_fit

_LEAST = 10
_TRIALS = 300
_LOOKED_AT = 2000


@dataclass(frozen=True, eq=False)
class PlaneFit:
    """A plane through points, robust against those of other surfaces.

    Attributes
    ----------
    normal : (3,) array
        Unit normal, upwards (its z, else its largest component, is positive).
    centre_mm : (3,) array
        Point of the plane amid the points used.
    axes : (2, 3) array
        Unit directions in the plane to which the covariance's two tilts belong.
    covariance : (3, 3) array
        Of the offset along the normal (mm) and of the normal's tilts towards the two axes (rad).
    flatness
        Range of the deviations of **all** measured points but the outermost 0.3 %, so that a dent counts although the
        fit does not follow it.
    rms_mm
        Of the points used.
    deviation_mm : (n,) array
        Signed distance along the normal of every point, NaN where nothing was measured.
    used : (m,) int array
        Rows of the points that the fit used.
    measured
        Number of points with a measurement.
    """

    normal: FloatArray
    centre_mm: FloatArray
    axes: FloatArray
    covariance: FloatArray
    flatness: Quantity
    rms_mm: float
    deviation_mm: FloatArray
    used: IntArray
    measured: int

    def distance(self, point_mm: FloatArray) -> Quantity:
        """Signed distance of an exactly known point from the plane, along the normal."""
        offset = np.asarray(point_mm, dtype=np.float64) - self.centre_mm
        slope = np.array([-1.0, *(self.axes @ offset)])
        return Quantity(float(self.normal @ offset), float(np.sqrt(slope @ self.covariance @ slope)))

    @property
    def tilt(self) -> Quantity:
        """Angle between the normal and the bed's z, degrees."""
        across = float(np.hypot(*self.normal[:2]))
        sigma = np.degrees(np.sqrt(float(np.trace(self.covariance[1:, 1:])) / 2))
        return Quantity(float(np.degrees(np.arctan2(across, self.normal[2]))), float(sigma), "deg")


def fit_plane(points_mm: FloatArray, sigma_mm: FloatArray | None = None) -> PlaneFit:
    """Fit the plane on which most of the points lie; up to half of them may lie elsewhere.

    Parameters
    ----------
    points_mm : (n, 3) array
        NaN means "no measurement".
    sigma_mm : (n,) array, optional
        Standard deviation of each point.

    Raises
    ------
    InputError
        ``too-few-points``, or ``undetermined`` if the points lie on a line.
    """
    rows = measured_rows(points_mm, least=_LEAST, what="A plane")
    points = np.asarray(points_mm, dtype=np.float64)[rows]
    weight = None if sigma_mm is None else np.asarray(sigma_mm)[rows]
    # Distances far from the origin would cost digits.
    origin = np.median(points, axis=0)
    local = points - origin
    fit = robust_fit(_start(local), lambda s: _linearise(s, local), _move, local, sigma_mm=weight)
    normal, offset = fit.state[:3], float(fit.state[3])
    middle = local[fit.used].mean(axis=0)
    centre = middle - (normal @ middle - offset) * normal
    normal = normal if _upward(normal) else -normal
    axes = axes_across(normal)
    deviation = np.full(len(points_mm), np.nan)
    deviation[rows] = (local - centre) @ normal
    jacobian = _to_centre(fit.state[:3], normal, axes, centre)
    used_deviation = deviation[rows][fit.used]
    return PlaneFit(
        normal,
        centre + origin,
        axes,
        jacobian @ fit.covariance @ jacobian.T,
        trimmed_range(deviation[rows], weight),
        float(np.sqrt(np.mean(used_deviation**2))),
        deviation,
        rows[fit.used],
        len(rows),
    )


def _start(points: FloatArray) -> FloatArray:
    """The best of many planes through three points, by its median distance."""
    rng = np.random.default_rng(0)
    some = points if len(points) <= _LOOKED_AT else points[rng.choice(len(points), _LOOKED_AT, replace=False)]
    corners = some[rng.integers(0, len(some), (_TRIALS, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    wide = length > 1e-12 * float(np.ptp(some, axis=0).max() or 1.0) ** 2
    if not wide.any():
        raise InputError("The points lie on a line and determine no plane; choose a wider region.", code="undetermined")
    normals = normals[wide] / length[wide, None]
    offsets = np.einsum("ij,ij->i", normals, corners[wide, 0])
    misfit = np.median(np.abs(some @ normals.T - offsets), axis=0)
    best = int(np.argmin(misfit))
    return np.append(normals[best], offsets[best])


def _linearise(state: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    axes = axes_across(state[:3])
    return points @ state[:3] - state[3], np.column_stack([-np.ones(len(points)), points @ axes.T])


def _move(state: FloatArray, step: FloatArray) -> FloatArray:
    """The plane with its offset moved by step[0] and its normal tilted by step[1:] towards its axes."""
    normal = state[:3] + axes_across(state[:3]).T @ step[1:]
    length = float(np.linalg.norm(normal))
    return np.append(normal / length, (state[3] + step[0]) / length)


def axes_across(direction: FloatArray) -> FloatArray:
    """Two unit vectors, (2, 3), that stand at right angles to a unit vector and to each other."""
    along = np.eye(3)[int(np.argmin(np.abs(direction)))]
    first = np.cross(direction, along)
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first)])


def _upward(normal: FloatArray) -> bool:
    lead = normal[2] if abs(normal[2]) > 1e-6 else normal[int(np.argmax(np.abs(normal)))]
    return bool(lead > 0.0)


def _to_centre(normal: FloatArray, upward: FloatArray, axes: FloatArray, centre: FloatArray) -> FloatArray:
    """Jacobian from the fit's offset and tilts at the origin to those at the plane's centre."""
    sign = float(np.sign(normal @ upward))
    own = axes_across(normal)
    jacobian = np.zeros((3, 3))
    jacobian[0] = sign * np.array([1.0, *(-(own @ centre))])
    jacobian[1:, 1:] = sign * axes @ own.T
    return jacobian
