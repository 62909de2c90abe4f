"""What a set of views says about a camera, and how surely: covariance, held-out errors, the choice of lens model."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinline.arrays import BoolArray, FloatArray, IntArray
from twinline.calibration.bundle import (
    PARAMETERS,
    Sightings,
    Solution,
    camera_information,
    camera_jacobian,
    cost,
    normal_equations,
    residuals,
    solve,
    view_rms,
)
from twinline.errors import RigError
from twinline.geometry.camera import Camera

MODELS = {"none": 4, "k1": 5, "k1 k2": 6, "k1 k2 p1 p2": 8, "k1 k2 p1 p2 k3": 9}
"""Lens models, from the simplest on, with how many of `PARAMETERS` each estimates."""

_FOLDS = 6
_LEAST_GAIN = 0.01
_REJECT_SIGMAS = 5.0
_MEDIAN_PER_SIGMA = 1.17741
_MAX_VARIANCE = 1e12


@dataclass(frozen=True)
class ModelEvidence:
    """How one lens model did.

    Attributes
    ----------
    rms_px, held_out_rms_px
        Root mean square distance of corners from their prediction: over the views it was fitted to, and over views
        left out of the fit, with only their poses adjusted.
    verdict
        Why it was or was not chosen.
    """

    name: str
    parameters: int
    rms_px: float
    held_out_rms_px: float
    chosen: bool
    verdict: str


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Covariance of a camera.

    Attributes
    ----------
    matrix : (p, p) array
        Covariance of the first p of `PARAMETERS`, including `inflation`.
    corner_sd_px
        Standard deviation of a corner along one axis, from the residuals.
    inflation
        By how many times the views disagree more about the camera than independent errors of corners explain, as a
        ratio of variances; 1 at least.
    """

    matrix: FloatArray
    corner_sd_px: float
    inflation: float


def reject_corners(sightings: Sightings, solution: Solution) -> Sightings:
    """Take the weight of corners that lie more than five standard deviations off, by their own view or by all."""
    error = np.linalg.norm(residuals(sightings, solution), axis=2)
    believed = sightings.weights > 0
    by_view = np.nanmedian(np.where(believed, error, np.nan), axis=1)
    sigma = np.maximum(by_view, np.median(error[believed])) / _MEDIAN_PER_SIGMA
    return Sightings(
        sightings.board_mm, sightings.pixels, sightings.weights * (error <= _REJECT_SIGMAS * sigma[:, None])
    )


def fit_model(sightings: Sightings, start: Solution, parameters: int) -> Solution:
    """Least squares for the first parameters, the remaining lens coefficients held at zero."""
    theta = start.theta.copy()
    theta[parameters:] = 0.0
    return solve(sightings, Solution(theta, start.rotations, start.translations_mm), np.arange(parameters))


def uncertainty(sightings: Sightings, solution: Solution, parameters: int) -> Uncertainty:
    """Covariance of a fitted camera.

    The inverse information with the variance of corners from the residuals, times a factor for what views have in
    common within themselves (a bent board, a bias of its lighting): the sum of squares of the views' scores against
    its expectation under independent errors, in the metric of the information. This is the trace of the
    cluster-robust covariance (K.-Y. Liang, S. L. Zeger, Biometrika 73, 1986) against that of the plain one, each
    corrected for the degrees of freedom that the fit took from the scores.
    """
    active = np.arange(parameters)
    normal = normal_equations(sightings, solution, active)
    information = camera_information(normal)
    inverse = _inverse(information.sum(axis=0))
    freedom = 2 * sightings.weights.sum() - 6 * len(sightings) - parameters
    variance = cost(sightings, solution) / max(freedom, 1.0)
    by_pose = np.linalg.solve(normal.pose, normal.pose_gradient[..., None])
    scores = normal.camera_gradient - (normal.mixed @ by_pose)[..., 0]
    share = information @ inverse
    expected = variance * (parameters - np.einsum("vij,vji->", share, share))
    found = np.einsum("vi,ij,vj->", scores, inverse, scores)
    inflation = max(1.0, float(found / expected)) if expected > 0 else 1.0
    return Uncertainty(inverse * (variance * inflation), float(np.sqrt(variance)), inflation)


def _inverse(information: FloatArray) -> FloatArray:
    """Inverse; directions that the data do not see get a very large variance instead of an infinite one."""
    scale = np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    inverse = (vectors / np.maximum(values, 1.0 / _MAX_VARIANCE)) @ vectors.T
    symmetric = (inverse + inverse.T) / 2
    return np.asarray(symmetric / np.outer(scale, scale))


def held_out_squares(sightings: Sightings, solution: Solution, parameters: int) -> FloatArray:
    """Mean squared error of each view under a camera fitted to views of which it is none, (v,) in square pixels."""
    views = len(sightings)
    active = np.arange(parameters)
    fold = np.arange(views) % min(views, _FOLDS)
    squares = np.empty(views)
    for number in range(int(fold.max()) + 1):
        test = fold == number
        fitted = solve(sightings.take(~test), solution.take(~test), active, max_steps=25)
        squares[test] = view_rms(sightings.take(test), pose_only(sightings, solution, fitted.theta, test)) ** 2
    return squares


def pose_only(sightings: Sightings, solution: Solution, theta: FloatArray, views: BoolArray | IntArray) -> Solution:
    """The poses of some views under a given camera."""
    start = Solution(theta, solution.rotations[views], solution.translations_mm[views])
    return solve(sightings.take(views), start, np.arange(0), max_steps=25)


def choose_model(
    sightings: Sightings, start: Solution, size: tuple[int, int], names: Sequence[str]
) -> tuple[str, Solution, tuple[ModelEvidence, ...]]:
    """Fit lens models and choose the simplest one that predicts views it has not seen.

    From the simplest on, a model replaces the present one if it lowers the mean squared error on held-out views by more
    than the standard error of that difference over the views and by more than 1 %. One that folds back inside
    the image is not considered.

    Raises
    ------
    RigError
        If every model folds back.
    """
    fits = {name: fit_model(sightings, start, MODELS[name]) for name in names}
    held_out = {name: held_out_squares(sightings, fit, MODELS[name]) for name, fit in fits.items()}
    present: str | None = None
    verdicts: dict[str, str] = {}
    for name in names:
        if not one_to_one(fits[name].theta, size):
            verdicts[name] = "folds back inside the image"
            continue
        if present is None:
            present, verdicts[name] = name, "the simplest possible"
            continue
        gain = held_out[present] - held_out[name]
        least = max(_standard_error(gain), _LEAST_GAIN * float(held_out[present].mean()))
        share = 100 * float(gain.mean() / held_out[present].mean())
        if gain.mean() > least:
            verdicts[name] = f"lowers the squared error on held-out views by {share:.1f} % against {present}"
            present = name
        else:
            verdicts[name] = f"no surer gain on held-out views ({share:+.1f} %) than {present}"
    if present is None:
        raise RigError("Every lens model that fits these views folds back inside the image.")
    evidence = tuple(
        ModelEvidence(
            name,
            MODELS[name],
            float(np.sqrt(cost(sightings, fits[name]) / sightings.weights.sum())),
            float(np.sqrt(held_out[name].mean())),
            name == present,
            verdicts[name],
        )
        for name in names
    )
    return present, fits[present], evidence


def _standard_error(values: FloatArray) -> float:
    return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else float("inf")


def one_to_one(theta: FloatArray, size: tuple[int, int]) -> bool:
    """Whether every pixel at the border of the image has a ray."""
    try:
        camera = camera_of(theta, size)
    except RigError:
        return False
    u, v = np.linspace(0, size[0] - 1, 9), np.linspace(0, size[1] - 1, 9)
    border = [(x, y) for x in u for y in (0, size[1] - 1)] + [(x, y) for y in v for x in (0, size[0] - 1)]
    return bool(np.isfinite(camera.rays(np.array(border, dtype=np.float64))).all())


def camera_of(theta: FloatArray, size: tuple[int, int]) -> Camera:
    """The camera with the given values of `PARAMETERS`."""
    fx, fy, cx, cy = theta[:4]
    return Camera(np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), size, theta[4:])


def half_focal_lengths(sightings: Sightings, solution: Solution, parameters: int) -> tuple[float, float]:
    """Focal length along u from every second view, and from the others, in pixels."""
    number = np.arange(len(sightings))
    fits = []
    for half in (0, 1):
        views = number % 2 == half
        fits.append(solve(sightings.take(views), solution.take(views), np.arange(parameters), max_steps=50))
    return float(fits[0].theta[0]), float(fits[1].theta[0])


def lens_sd_px(theta: FloatArray, covariance: FloatArray, size: tuple[int, int], steps: int = 9) -> FloatArray:
    """How surely the lens model places a ray in the image, apart from a rotation of the whole camera.

    Returns
    -------
    (steps, steps) array
        Standard deviation (root of the sum over u and v) in pixels on a grid over the image, by row and column; NaN
        where the lens model has no ray.
    """
    u, v = np.meshgrid(np.linspace(0, size[0] - 1, steps), np.linspace(0, size[1] - 1, steps))
    rays = camera_of(theta, size).rays(np.column_stack([u.ravel(), v.ravel()]))
    known = np.isfinite(rays).all(axis=1)
    x, y = rays[known, 0], rays[known, 1]
    parameters = len(covariance)
    by_camera = camera_jacobian(x, y, theta)[..., :parameters].reshape(-1, parameters)
    fx, fy = theta[:2]
    turns = np.stack([np.stack([fx * x * y, fy * (1 + y * y)], -1), np.stack([fx * (1 + x * x), fy * x * y], -1)], -1)
    turns = np.concatenate([turns, np.stack([-fx * y, fy * x], -1)[..., None]], -1).reshape(-1, 3)
    seen = by_camera - turns @ np.linalg.lstsq(turns, by_camera, rcond=None)[0]
    variance = np.einsum("ij,jk,ik->i", seen, covariance, seen).reshape(-1, 2).sum(axis=1)
    out = np.full(len(rays), np.nan)
    out[known] = np.sqrt(np.maximum(variance, 0.0))
    return out.reshape(steps, steps)


def parameter_names(parameters: int) -> tuple[str, ...]:
    """Names of the first parameters as a rig's covariance calls them."""
    return tuple(f"camera.{name}" for name in PARAMETERS[:parameters])
