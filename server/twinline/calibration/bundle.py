"""Least squares over a camera and the poses of a board in many views, with the poses eliminated.

The normal equations of such a problem are block sparse: each pose meets only its own view. Eliminating the poses leaves
a small system for the camera alone (the Schur complement), whose inverse is the covariance of the camera with the poses
accounted for. B. Triggs et al., "Bundle Adjustment - A Modern Synthesis", Vision Algorithms (2000), section 6.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from twinline.arrays import BoolArray, FloatArray, IntArray
from twinline.geometry.camera import distort, distort_jacobian

PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
"""Order of a camera's parameters in the vectors of this module."""

_MAX_STEPS = 100
_STOP = 1e-9
_GIVE_UP = 1e12


@dataclass(frozen=True, eq=False)
class Sightings:
    """Corners of a board in several views, padded to the same number in each.

    Attributes
    ----------
    board_mm : (v, n, 3) array
        Points on the board, in its frame.
    pixels : (v, n, 2) array
        Where they were seen.
    weights : (v, n) array
        1 where there is a corner to be believed, 0 for padding and rejected corners.
    """

    board_mm: FloatArray
    pixels: FloatArray
    weights: FloatArray

    def __len__(self) -> int:
        return len(self.pixels)

    def take(self, views: IntArray | BoolArray) -> "Sightings":
        """Some of the views."""
        return Sightings(self.board_mm[views], self.pixels[views], self.weights[views])


@dataclass(frozen=True, eq=False)
class Solution:
    """A camera and the board's poses.

    Attributes
    ----------
    theta : (9,) array
        Values of `PARAMETERS`.
    rotations : (v, 3, 3) array
        Rotations ``camera_from_board``.
    translations_mm : (v, 3) array
        And translations.
    """

    theta: FloatArray
    rotations: FloatArray
    translations_mm: FloatArray

    def take(self, views: IntArray | BoolArray) -> "Solution":
        """The same camera with some of the poses."""
        return Solution(self.theta, self.rotations[views], self.translations_mm[views])


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations per view: of the camera (v, p, p), mixed (v, p, 6), of the poses (v, 6, 6), and gradients."""

    camera: FloatArray
    mixed: FloatArray
    pose: FloatArray
    camera_gradient: FloatArray
    pose_gradient: FloatArray


def stack_sightings(board_mm: Sequence[FloatArray], pixels: Sequence[FloatArray]) -> Sightings:
    """Pad views with different numbers of corners to one shape."""
    n = max(len(view) for view in pixels)
    points = np.zeros((len(pixels), n, 3))
    seen = np.zeros((len(pixels), n, 2))
    weights = np.zeros((len(pixels), n))
    for i, (here, there) in enumerate(zip(board_mm, pixels, strict=True)):
        points[i, : len(here)], seen[i, : len(here)], weights[i, : len(here)] = here, there, 1.0
        # Padding repeats a real point so that no projection of it can be invalid.
        points[i, len(here) :], seen[i, len(here) :] = here[0], there[0]
    return Sightings(points, seen, weights)


def residuals(sightings: Sightings, solution: Solution) -> FloatArray:
    """Predicted minus seen image points, (v, n, 2) in pixels; huge for points that are not in front of the camera."""
    points = np.einsum("vij,vnj->vni", solution.rotations, sightings.board_mm) + solution.translations_mm[:, None]
    z = points[..., 2]
    safe = np.where(z > 1e-6, z, np.nan)
    x, y = distort(points[..., 0] / safe, points[..., 1] / safe, solution.theta[4:])
    fx, fy, cx, cy = solution.theta[:4]
    predicted = np.stack([fx * x + cx, fy * y + cy], axis=-1)
    return np.nan_to_num(predicted - sightings.pixels, nan=1e6, posinf=1e6, neginf=-1e6)


def cost(sightings: Sightings, solution: Solution) -> float:
    """Weighted sum of squared residuals, square pixels."""
    return float(np.sum(sightings.weights[..., None] * residuals(sightings, solution) ** 2))


def view_rms(sightings: Sightings, solution: Solution) -> FloatArray:
    """Root mean square length of the residuals of each view, (v,) in pixels."""
    squares = (residuals(sightings, solution) ** 2).sum(axis=2)
    return np.asarray(np.sqrt((sightings.weights * squares).sum(axis=1) / sightings.weights.sum(axis=1)))


def _jacobians(sightings: Sightings, solution: Solution) -> tuple[FloatArray, FloatArray]:
    """Derivatives of the image points by the camera, (v, n, 2, 9), and by the pose, (v, n, 2, 6).

    A pose is varied by a small rotation in the camera frame, before its translation, and by that translation.
    """
    turned = np.einsum("vij,vnj->vni", solution.rotations, sightings.board_mm)
    points = turned + solution.translations_mm[:, None]
    z = np.maximum(points[..., 2], 1e-6)
    x, y = points[..., 0] / z, points[..., 1] / z
    fx, fy = solution.theta[:2]
    k = solution.theta[4:]
    by_camera = camera_jacobian(x, y, solution.theta)
    a, b, d = distort_jacobian(x, y, k)
    by_x = np.stack([fx * a, fy * b], axis=-1)
    by_y = np.stack([fx * b, fy * d], axis=-1)
    by_point = np.stack([by_x, by_y, -(x[..., None] * by_x + y[..., None] * by_y)], axis=-1) / z[..., None, None]
    by_pose = np.empty((*x.shape, 2, 6))
    by_pose[..., :3] = np.cross(turned[..., None, :], by_point)
    by_pose[..., 3:] = by_point
    return by_camera, by_pose


def camera_jacobian(x: FloatArray, y: FloatArray, theta: FloatArray) -> FloatArray:
    """Derivatives of image points by `PARAMETERS` at fixed rays.

    Parameters
    ----------
    x, y : (...) arrays
        Undistorted normalised coordinates.

    Returns
    -------
    (..., 2, 9) array
        Pixels per unit of the parameter.
    """
    fx, fy = theta[:2]
    xd, yd = distort(x, y, theta[4:])
    r2 = x * x + y * y
    out = np.zeros((*np.shape(x), 2, 9))
    out[..., 0, 0], out[..., 1, 1] = xd, yd
    out[..., 0, 2] = out[..., 1, 3] = 1.0
    for column, factor in ((4, r2), (5, r2 * r2), (8, r2 * r2 * r2)):
        out[..., 0, column], out[..., 1, column] = fx * x * factor, fy * y * factor
    out[..., 0, 6], out[..., 1, 6] = fx * 2 * x * y, fy * (r2 + 2 * y * y)
    out[..., 0, 7], out[..., 1, 7] = fx * (r2 + 2 * x * x), fy * 2 * x * y
    return out


def normal_equations(sightings: Sightings, solution: Solution, active: IntArray) -> Normal:
    """Normal equations of the active camera parameters and all poses, kept view by view."""
    by_camera, by_pose = _jacobians(sightings, solution)
    views, rows = len(sightings), 2 * sightings.weights.shape[1]
    weights = np.repeat(sightings.weights, 2, axis=1)[..., None]
    camera = by_camera[..., active].reshape(views, rows, len(active))
    pose = by_pose.reshape(views, rows, 6)
    error = residuals(sightings, solution).reshape(views, rows, 1)
    camera_t = np.swapaxes(camera * weights, 1, 2)
    pose_t = np.swapaxes(pose * weights, 1, 2)
    return Normal(
        camera_t @ camera, camera_t @ pose, pose_t @ pose, (camera_t @ error)[..., 0], (pose_t @ error)[..., 0]
    )


def camera_information(normal: Normal) -> FloatArray:
    """What each view says about the camera with its own pose unknown, (v, p, p): the Schur complement by views."""
    scale = np.sqrt(np.maximum(np.einsum("vii->vi", normal.pose), 1e-300))
    pose = normal.pose / (scale[:, :, None] * scale[:, None, :]) + 1e-14 * np.eye(6)
    mixed = normal.mixed / scale[:, None, :]
    return np.asarray(normal.camera - mixed @ np.linalg.solve(pose, np.swapaxes(mixed, 1, 2)))


def solve(sightings: Sightings, start: Solution, active: IntArray, *, max_steps: int = _MAX_STEPS) -> Solution:
    """Minimise the weighted squared residuals over the active camera parameters and all poses.

    Levenberg-Marquardt with the analytic Jacobian; damping is in units of the curvature (J. J. More, "The
    Levenberg-Marquardt algorithm: implementation and theory", 1978).

    Parameters
    ----------
    active : (p,) int array
        Indices into `PARAMETERS`; the others keep their values. With none, only the poses are adjusted.
    """
    best, best_cost, damping = start, cost(sightings, start), 1e-4
    normal = normal_equations(sightings, best, active)
    for _ in range(max_steps):
        step = _step(normal, damping)
        if step is None:
            damping *= 10
            continue
        trial = _moved(best, active, *step)
        trial_cost = cost(sightings, trial)
        if trial_cost > best_cost * (1 + 1e-15):
            damping *= 10
            if damping > _GIVE_UP:
                break
            continue
        small = _relative_size(normal, step) <= _STOP * np.sqrt(trial_cost)
        best, best_cost, damping = trial, trial_cost, max(damping / 10, 1e-12)
        if small:
            break
        normal = normal_equations(sightings, best, active)
    return best


def _relative_size(normal: Normal, step: tuple[FloatArray, FloatArray]) -> float:
    """By how many pixels, all corners together, a step moves the predictions at most."""
    camera = np.einsum("vii->i", normal.camera) * step[0] ** 2
    pose = np.einsum("vii->vi", normal.pose) * step[1] ** 2
    return float(np.sqrt(camera.sum() + pose.sum()))


def _step(normal: Normal, damping: float) -> tuple[FloatArray, FloatArray] | None:
    """Step of the camera (p,) and of the poses (v, 6); None where the damped equations are singular."""
    diagonal = np.einsum("vii->vi", normal.pose)
    pose = normal.pose + np.eye(6) * (damping * diagonal[:, :, None] + 1e-300)
    camera = normal.camera.sum(axis=0)
    camera = camera + np.diag(damping * np.diagonal(camera))
    try:
        right = np.linalg.solve(
            pose, np.concatenate([np.swapaxes(normal.mixed, 1, 2), normal.pose_gradient[..., None]], 2)
        )
        by_camera, by_gradient = right[..., :-1], right[..., -1]
        reduced = camera - np.einsum("vpi,viq->pq", normal.mixed, by_camera)
        gradient = normal.camera_gradient.sum(axis=0) - np.einsum("vpi,vi->p", normal.mixed, by_gradient)
        scale = np.sqrt(np.diagonal(camera))
        camera_step = -np.linalg.solve(reduced / np.outer(scale, scale), gradient / scale) / scale
    except np.linalg.LinAlgError:
        return None
    pose_step = -by_gradient - np.einsum("vip,p->vi", by_camera, camera_step)
    if not (np.isfinite(camera_step).all() and np.isfinite(pose_step).all()):
        return None
    return camera_step, pose_step


def _moved(solution: Solution, active: IntArray, camera: FloatArray, poses: FloatArray) -> Solution:
    theta = solution.theta.copy()
    theta[active] += camera
    # A focal length may not change its sign on the way.
    theta[:2] = np.clip(theta[:2], solution.theta[:2] / 3, solution.theta[:2] * 3)
    turns = np.stack([cv2.Rodrigues(turn)[0] for turn in poses[:, :3]])
    return Solution(theta, turns @ solution.rotations, solution.translations_mm + poses[:, 3:])
