"""Corners of a board as a camera with known parameters sees them, with noise; no pictures."""

import numpy as np

from tests.unit.calibration.board_pictures import SIZE, TRUE_CAMERA, Pose, project, random_poses
from twinline.calibration.board import Board
from twinline.calibration.views import BoardView, view_of_points

BOARD = Board("chessboard", 9, 6, 12.0)


def views_of(
    poses: list[Pose], rng: np.random.Generator, *, noise_px: float = 0.1, camera: np.ndarray = TRUE_CAMERA
) -> list[BoardView]:
    seen = []
    for number, where in enumerate(poses):
        pixels = project(BOARD.points_mm(), where, camera)
        seen.append(view_of_points(f"view {number}", SIZE, BOARD, pixels + rng.normal(0, noise_px, pixels.shape)))
    return seen


def good_views(
    seed: int, count: int = 18, *, noise_px: float = 0.1, camera: np.ndarray = TRUE_CAMERA
) -> list[BoardView]:
    rng = np.random.default_rng(seed)
    return views_of(random_poses(BOARD, count, rng, camera=camera), rng, noise_px=noise_px, camera=camera)


def camera_error_px(theta: np.ndarray, truth: np.ndarray = TRUE_CAMERA) -> float:
    """Root mean square difference of two cameras over the picture, after the best rotation between them.

    A rotation of the whole camera is no error of the intrinsics: the pose of whatever is measured takes it up.
    """
    u, v = np.meshgrid(np.linspace(0, SIZE[0] - 1, 17), np.linspace(0, SIZE[1] - 1, 11))
    x, y = (u.ravel() - truth[2]) / truth[0], (v.ravel() - truth[3]) / truth[1]
    rays = np.column_stack([x, y, np.ones(x.size)])
    still = Pose(np.eye(3), np.zeros(3))
    difference = (project(rays, still, theta) - project(rays, still, truth)).ravel()
    turns = []
    for axis in np.eye(3) * 1e-6:
        turned = rays + np.cross(axis, rays)
        turns.append((project(turned, still, truth) - project(rays, still, truth)).ravel() / 1e-6)
    design = np.column_stack(turns)
    left = difference - design @ np.linalg.lstsq(design, difference, rcond=None)[0]
    return float(np.sqrt((left**2).mean() * 2))
