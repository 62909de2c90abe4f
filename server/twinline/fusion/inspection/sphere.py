"""Best-fit sphere: size, form and place."""

from dataclasses import dataclass

import numpy as np

from twinline.arrays import FloatArray, IntArray
from twinline.errors import InputError
from twinline.fusion.inspection.quantity import Quantity, measured_rows, trimmed_range
from twinline.fusion.inspection.robust import robust_fit

_LEAST = 12
_TRIALS = 400
_LOOKED_AT = 2000


@dataclass(frozen=True, eq=False)
class SphereFit:
    """A sphere through points, robust against those of other surfaces.

    Attributes
    ----------
    centre_mm : (3,) array
    diameter
        With its uncertainty.
    form
        Probing form error of VDI/VDE 2634-2: range of the radial deviations of all measured points but the outermost
        0.3 %.
    covariance : (4, 4) array
        Of centre x, y, z and radius, mm².
    rms_mm
        Of the points used.
    deviation_mm : (n,) array
        Distance from the centre minus the radius, NaN where nothing was measured.
    used : (m,) int array
        Rows of the points that the fit used.
    measured
        Number of points with a measurement.
    """

    centre_mm: FloatArray
    diameter: Quantity
    form: Quantity
    covariance: FloatArray
    rms_mm: float
    deviation_mm: FloatArray
    used: IntArray
    measured: int

    def centre_distance(self, other: "SphereFit") -> Quantity:
        """Distance of the centres: the sphere spacing of VDI/VDE 2634-2."""
        between = other.centre_mm - self.centre_mm
        length = float(np.linalg.norm(between))
        direction = between / length if length > 0.0 else np.array([1.0, 0.0, 0.0])
        variance = direction @ (self.covariance[:3, :3] + other.covariance[:3, :3]) @ direction
        return Quantity(length, float(np.sqrt(variance)))


def fit_sphere(points_mm: FloatArray, sigma_mm: FloatArray | None = None) -> SphereFit:
    """Fit the sphere on which most of the points lie; up to half of them may lie elsewhere.

    Parameters
    ----------
    points_mm : (n, 3) array
        NaN means "no measurement".
    sigma_mm : (n,) array, optional
        Standard deviation of each point.

    Raises
    ------
    InputError
        ``too-few-points``, or ``undetermined`` if the points are as good as flat.
    """
    rows = measured_rows(points_mm, least=_LEAST, what="A sphere")
    points = np.asarray(points_mm, dtype=np.float64)[rows]
    weight = None if sigma_mm is None else np.asarray(sigma_mm)[rows]
    origin = np.median(points, axis=0)
    local = points - origin
    fit = robust_fit(_start(local), lambda s: _linearise(s, local), _move, local, sigma_mm=weight)
    radius, sd = float(fit.state[3]), float(np.sqrt(fit.covariance[3, 3]))
    if not sd < 0.25 * radius:
        raise InputError(
            f"The points are as good as flat and determine no sphere (radius {radius:.3g} ± {sd:.2g} mm); "
            "choose a region that shows more of it.",
            code="undetermined",
        )
    deviation = np.full(len(points_mm), np.nan)
    deviation[rows] = fit.residuals_mm
    return SphereFit(
        fit.state[:3] + origin,
        Quantity(2.0 * radius, 2.0 * sd),
        trimmed_range(fit.residuals_mm, weight),
        fit.covariance,
        float(np.sqrt(np.mean(fit.residuals_mm[fit.used] ** 2))),
        deviation,
        rows[fit.used],
        len(rows),
    )


def _start(points: FloatArray) -> FloatArray:
    """The best of many spheres through four points, by its median distance."""
    rng = np.random.default_rng(0)
    some = points if len(points) <= _LOOKED_AT else points[rng.choice(len(points), _LOOKED_AT, replace=False)]
    corners = some[rng.integers(0, len(some), (_TRIALS, 4))]
    # |p|² = 2 c·p + (r² - |c|²), linear in the unknowns once the first point is subtracted.
    sides = 2.0 * (corners[:, 1:] - corners[:, :1])
    squares = (corners[:, 1:] ** 2).sum(axis=2) - (corners[:, :1] ** 2).sum(axis=2)
    size = float(np.ptp(some, axis=0).max() or 1.0)
    solvable = np.abs(np.linalg.det(sides)) > 1e-9 * size**3
    if not solvable.any():
        raise InputError(
            "The points lie in a plane and determine no sphere; choose a region that shows more of it.",
            code="undetermined",
        )
    centres = np.linalg.solve(sides[solvable], squares[solvable][..., None])[..., 0]
    radii = np.linalg.norm(corners[solvable, 0] - centres, axis=1)
    apart = np.linalg.norm(some[:, None, :] - centres[None], axis=2)
    best = int(np.argmin(np.median(np.abs(apart - radii), axis=0)))
    return np.append(centres[best], radii[best])


def _linearise(state: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    outward = points - state[:3]
    length = np.linalg.norm(outward, axis=1)
    direction = outward / np.maximum(length, 1e-12)[:, None]
    return length - state[3], np.column_stack([-direction, -np.ones(len(points))])


def _move(state: FloatArray, step: FloatArray) -> FloatArray:
    return state + step
