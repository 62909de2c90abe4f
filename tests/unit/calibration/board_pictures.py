"""Pictures of boards whose corners are known, by casting a ray through every part of a pixel; independent of Twinline.

The lens model and the poses are written out here again, so that a mistake in the package cannot cancel itself.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from twinline.calibration.board import Board

TRUE_CAMERA = np.array([1041.3, 1040.1, 633.9, 371.2, -0.128, 0.07, -0.0007, 0.0005, 0.0])
"""fx, fy, cx, cy, k1, k2, p1, p2, k3 of a camera of 1280 x 720 px."""
SIZE = (1280, 720)


@dataclass(frozen=True)
class Pose:
    """camera_from_board."""

    rotation: np.ndarray
    translation_mm: np.ndarray


def distorted(x: np.ndarray, y: np.ndarray, k: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    k1, k2, p1, p2, k3 = k
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    return x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2), y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y


def project(points_mm: np.ndarray, pose: Pose, camera: np.ndarray = TRUE_CAMERA) -> np.ndarray:
    p = points_mm @ pose.rotation.T + pose.translation_mm
    x, y = distorted(p[:, 0] / p[:, 2], p[:, 1] / p[:, 2], camera[4:])
    return np.column_stack([camera[0] * x + camera[2], camera[1] * y + camera[3]])


def rotation(axis_deg: tuple[float, float, float]) -> np.ndarray:
    """Turns about x, y and z, in this order."""
    x, y, z = np.radians(axis_deg)
    about_x = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    about_y = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    about_z = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


def pose(board: Board, turn_deg: tuple[float, float, float], centre_mm: tuple[float, float, float]) -> Pose:
    """The board's middle at a place in the camera frame, turned about it."""
    r = rotation(turn_deg)
    middle = board.points_mm().mean(axis=0)
    return Pose(r, np.array(centre_mm) - r @ middle)


def random_poses(
    board: Board, count: int, rng: np.random.Generator, *, tilt_deg: float = 40.0, camera: np.ndarray = TRUE_CAMERA
) -> list[Pose]:
    """Poses in which the whole board is inside the picture."""
    found: list[Pose] = []
    while len(found) < count:
        turn = (rng.uniform(-tilt_deg, tilt_deg), rng.uniform(-tilt_deg, tilt_deg), rng.uniform(-180, 180))
        z = rng.uniform(280, 450)
        centre = (rng.uniform(-0.45, 0.45) * z, rng.uniform(-0.25, 0.25) * z, z)
        candidate = pose(board, turn, centre)
        pixels = project(board.points_mm(), candidate, camera)
        if (pixels > 8).all() and (pixels < np.array(SIZE) - 9).all():
            found.append(candidate)
    return found


def face(board: Board, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Reflectance of the board's face at its own coordinates in millimetres, 0 or 1; NaN beside it."""
    side = board.square_mm
    if "circles" in board.kind:
        centres = board.points_mm()
        nearest = np.full(x.shape, np.inf)
        for cx, cy, _ in centres:
            nearest = np.minimum(nearest, np.hypot(x - cx, y - cy))
        value = (nearest > 0.3 * side).astype(float)
        right, bottom = centres[:, 0].max() + 1.5 * side, centres[:, 1].max() + 1.5 * side
    else:
        column, row = np.floor(x / side + 1).astype(int), np.floor(y / side + 1).astype(int)
        inside = (column >= 0) & (column <= board.columns) & (row >= 0) & (row <= board.rows)
        value = np.where(inside & ((column + row) % 2 == 0), 0.0, 1.0)
        if board.kind == "charuco":
            value = np.minimum(value, _markers(board, x, y, column, row))
        right, bottom = (board.columns + 0.7) * side, (board.rows + 0.7) * side
    return np.where((x > -1.7 * side) & (y > -1.7 * side) & (x < right) & (y < bottom), value, np.nan)


def _markers(board: Board, x: np.ndarray, y: np.ndarray, column: np.ndarray, row: np.ndarray) -> np.ndarray:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, str(board.dictionary)))
    side, marker = board.square_mm, float(board.marker_mm or 0)
    out, number = np.ones(x.shape), 0
    for r in range(board.rows + 1):
        for c in range(board.columns + 1):
            if (r + c) % 2 == 0:
                continue
            cells = int(dictionary.markerSize) + 2
            picture = dictionary.generateImageMarker(number, cells) > 0
            number += 1
            here = (column == c) & (row == r)
            inset = (side - marker) / 2
            i = np.floor((y[here] - (r - 1) * side - inset) / marker * cells).astype(int)
            j = np.floor((x[here] - (c - 1) * side - inset) / marker * cells).astype(int)
            inside = (i >= 0) & (i < cells) & (j >= 0) & (j < cells)
            out[here] = np.where(inside, picture[np.clip(i, 0, cells - 1), np.clip(j, 0, cells - 1)], 1.0)
    return out


def _extent(board: Board, where: Pose, camera: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the part of the picture that can show the board."""
    points = board.points_mm()
    low, high = points.min(axis=0) - 2 * board.square_mm, points.max(axis=0) + 2 * board.square_mm
    t = np.linspace(0, 1, 20)[:, None]
    ends = [
        np.array([x, y, 0.0]) for x, y in ((low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1]))
    ]
    outline = np.concatenate([a + (b - a) * t for a, b in zip(ends, ends[1:] + ends[:1], strict=True)])
    pixels = project(outline, where, camera)
    first = np.clip(np.floor(pixels.min(axis=0)) - 2, 0, np.array(size) - 1).astype(int)
    last = np.clip(np.ceil(pixels.max(axis=0)) + 3, first + 1, np.array(size)).astype(int)
    return first, last


def picture(
    board: Board,
    where: Pose,
    *,
    camera: np.ndarray = TRUE_CAMERA,
    size: tuple[int, int] = SIZE,
    dark: float = 28.0,
    bright: float = 205.0,
    blur_px: float = 0.7,
    noise: float = 1.5,
    seed: int = 0,
) -> np.ndarray:
    """What the camera sees of a board in front of a grey wall, (h, w) uint8."""
    parts, wall = 3, dark + 0.18 * (bright - dark)
    offsets = (np.arange(parts) - (parts - 1) / 2) / parts
    total = np.full((size[1], size[0]), wall)
    low, high = _extent(board, where, camera, size)
    u, v = np.meshgrid(np.arange(low[0], high[0], dtype=float), np.arange(low[1], high[1], dtype=float))
    part = np.zeros(u.shape)
    normal, anchor = where.rotation[:, 2], where.translation_mm
    for du in offsets:
        for dv in offsets:
            xd, yd = (u + du - camera[2]) / camera[0], (v + dv - camera[3]) / camera[1]
            x, y = xd.copy(), yd.copy()
            for _ in range(8):
                fx, fy = distorted(x, y, camera[4:])
                x, y = x - (fx - xd), y - (fy - yd)
            depth = (normal @ anchor) / (normal[0] * x + normal[1] * y + normal[2])
            p = np.stack([x * depth, y * depth, depth], axis=-1) - anchor
            on_board = p @ where.rotation
            value = face(board, on_board[..., 0], on_board[..., 1])
            part += np.where(np.isnan(value), wall, dark + (bright - dark) * value) / parts**2
    total[low[1] : high[1], low[0] : high[0]] = part
    sharp = cv2.GaussianBlur(total, (0, 0), blur_px) if blur_px else total
    noisy = sharp + np.random.default_rng(seed).normal(0, noise, sharp.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)
