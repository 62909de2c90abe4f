"""Robust least squares whose covariance comes from the residuals themselves, neighbours' correlation included."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from twinline.arrays import BoolArray, FloatArray, IntArray
from twinline.errors import InputError

State = TypeVar("State")

# 95 % efficiency for normal residuals: P. Holland and R. Welsch, "Robust regression using iteratively reweighted
# least-squares", Communications in Statistics 6 (1977).
TUKEY = 4.685
_HUBER = 1.345
# Residuals of exact data are rounding; their scale must not become zero.
_LEAST_SCALE_MM = 1e-9
_CELLS_PER_AXIS = 5


@dataclass(frozen=True, eq=False)
class RobustFit(Generic[State]):
    """A fitted state with what is known of it.

    Attributes
    ----------
    state
        What was fitted.
    covariance : (p, p) array
        Of the local parameters (those of `linearise`'s Jacobian), squared.
    residuals_mm : (n,) array
        Of all points.
    used : (n,) bool array
        Points with a weight above zero.
    scale_mm
        Robust standard deviation of the residuals.
    correlation
        Factor of variance, at least 1, by which neighbouring residuals hang together.
    """

    state: State
    covariance: FloatArray
    residuals_mm: FloatArray
    used: BoolArray
    scale_mm: float
    correlation: float


def robust_fit(
    start: State,
    linearise: Callable[[State], tuple[FloatArray, FloatArray]],
    move: Callable[[State, FloatArray], State],
    positions_mm: FloatArray,
    *,
    sigma_mm: FloatArray | None = None,
    iterations: int = 60,
    least_scale_mm: float = _LEAST_SCALE_MM,
) -> RobustFit[State]:
    """Fit by Gauss-Newton, first with Huber's loss, then with Tukey's, which drops outliers altogether.

    The covariance is the sandwich of M-estimation (P. Huber and E. Ronchetti, "Robust Statistics", 2nd edition,
    equation 7.29), so it needs no belief about the noise, times a factor for the correlation of neighbours: the scores
    are summed over cells of space, whose sums vary more than independent points would (K.-Y. Liang and S. Zeger,
    "Longitudinal data analysis using generalized linear models", Biometrika 73 (1986)).

    Parameters
    ----------
    start
        First state; near enough for Gauss-Newton.
    linearise
        Gives residuals (n,) in mm and their Jacobian (n, p) by the local parameters.
    move
        Gives the state moved by local parameters (p,).
    positions_mm : (n, d) array
        Where the points lie, to tell neighbours.
    sigma_mm : (n,) array, optional
        Relative standard deviations; points with a smaller one weigh more.
    least_scale_mm
        The residuals' scale is taken as at least this, so that data on a raster do not make outliers of each other.

    Raises
    ------
    InputError
        ``undetermined`` if the points do not determine every parameter.
    """
    state = start
    relative = _relative(sigma_mm, len(positions_mm))
    for tukey in (False, True):
        for _ in range(iterations):
            residuals, jacobian = linearise(state)
            u = residuals / relative
            scale = _scale(u, least_scale_mm)
            weight = _tukey_weight(u / scale) if tukey else np.minimum(1.0, _HUBER / np.maximum(abs(u) / scale, 1e-12))
            weight = weight / relative**2
            step = _solve(jacobian.T @ (jacobian * weight[:, None]), -(jacobian.T @ (weight * residuals)))
            state = move(state, step)
            # A millionth of the scale in all residuals is nothing that a measurement could show.
            if float(np.abs(jacobian @ step).max()) < 1e-6 * scale * float(relative.min()):
                break
    return _described(state, linearise, relative, positions_mm, least_scale_mm)


def _described(
    state: State,
    linearise: Callable[[State], tuple[FloatArray, FloatArray]],
    relative: FloatArray,
    positions_mm: FloatArray,
    least_scale_mm: float,
) -> RobustFit[State]:
    residuals, jacobian = linearise(state)
    p = jacobian.shape[1]
    u = residuals / relative
    scale = _scale(u, least_scale_mm)
    rows = jacobian / relative[:, None]
    t = u / scale
    inside = np.abs(t) < TUKEY
    q = np.where(inside, 1.0 - (t / TUKEY) ** 2, 0.0)
    psi = u * q**2
    slope = np.where(inside, q * (1.0 - 5.0 * (t / TUKEY) ** 2), 0.0)
    # The mean slope with all rows stays positive definite where single slopes are negative.
    bread = rows.T @ (rows * inside[:, None]) * (slope.sum() / max(inside.sum(), 1))
    scores = rows * psi[:, None]
    freedom = max(int(inside.sum()) - p, 1)
    meat = scores.T @ scores * (int(inside.sum()) / freedom)
    inverse = _inverse(bread)
    correlation = max(1.0, _correlation(scores, positions_mm, inverse, meat))
    return RobustFit(
        state, inverse @ meat @ inverse.T * correlation, residuals, inside, float(scale), float(correlation)
    )


def _correlation(scores: FloatArray, positions_mm: FloatArray, inverse: FloatArray, meat: FloatArray) -> float:
    """By how much the scores' sums over cells of space vary more than those of independent points."""
    cells = _cells(positions_mm)
    count = int(cells.max()) + 1
    p = scores.shape[1]
    if count <= 2 * p or len(scores) < 4 * count:
        return 1.0
    sums = np.stack([np.bincount(cells, weights=column, minlength=count) for column in scores.T], axis=1)
    clustered = sums.T @ sums * (count / (count - p))
    # Compared in the parameters' own units, each against its own variance.
    plain = np.diag(inverse @ meat @ inverse.T)
    return float(np.mean(np.diag(inverse @ clustered @ inverse.T) / np.maximum(plain, 1e-300)))


def _cells(positions_mm: FloatArray) -> IntArray:
    low, high = positions_mm.min(axis=0), positions_mm.max(axis=0)
    edge = float(np.max(high - low)) / _CELLS_PER_AXIS
    if edge <= 0.0:
        return np.zeros(len(positions_mm), dtype=np.int64)
    index = np.minimum((positions_mm - low) / edge, _CELLS_PER_AXIS - 1).astype(np.int64)
    key = index @ (_CELLS_PER_AXIS ** np.arange(index.shape[1]))
    return np.unique(key, return_inverse=True)[1].astype(np.int64)


def _tukey_weight(t: FloatArray) -> FloatArray:
    return np.where(np.abs(t) < TUKEY, (1.0 - (t / TUKEY) ** 2) ** 2, 0.0)


def _scale(u: FloatArray, least: float) -> float:
    """Standard deviation from the median of the absolute residuals, as for normal noise."""
    return max(float(np.median(np.abs(u))) * 1.4826, least)


def _relative(sigma_mm: FloatArray | None, n: int) -> FloatArray:
    if sigma_mm is None:
        return np.ones(n)
    sigma = np.asarray(sigma_mm, dtype=np.float64)
    known = sigma[np.isfinite(sigma) & (sigma > 0.0)]
    if not len(known):
        return np.ones(n)
    middle = float(np.median(known))
    relative = np.where(np.isfinite(sigma) & (sigma > 0.0), sigma, middle) / middle
    # One over-confident point must not decide the fit.
    return np.clip(relative, 0.25, 100.0)


def _solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    return _inverse(matrix) @ right


def _inverse(matrix: FloatArray) -> FloatArray:
    """Inverse of a normal matrix, scaled first, so that millimetres and radians do not look degenerate."""
    size = np.sqrt(np.abs(np.diag(matrix)))
    if not np.isfinite(size).all() or (size <= 0.0).any():
        raise _undetermined()
    scaled = matrix / np.outer(size, size)
    if not np.linalg.cond(scaled) < 1e14:
        raise _undetermined()
    return np.asarray(np.linalg.inv(scaled) / np.outer(size, size))


def _undetermined() -> InputError:
    return InputError(
        "The points do not determine the shape: they lie on too small a part of it; choose a larger region.",
        code="undetermined",
    )
