"""Finding a calibration board in a picture."""

from dataclasses import dataclass

import cv2
import numpy as np

from twinline.arrays import ByteArray, FloatArray, IntArray
from twinline.calibration.board import Board, marker_dictionary
from twinline.calibration.corners import grid_of, refine_corners

_SMALLEST_GRID = 3
_CROSSING = 0.4
_SEARCH_WIDTH = 800
_CHARUCO_MIN_SHARE = 0.15


@dataclass(frozen=True, eq=False)
class Detection:
    """What was found of a board in one picture.

    Attributes
    ----------
    ids : (n,) int array
        Which of the board's points were found, ascending; empty if none.
    pixels : (n, 2) array
        Where, with sub-pixel resolution.
    grid_seen
        Columns and rows of inner corners of the largest chessboard in the picture, the larger number first; None if
        there is none or it was not looked for.
    mirrored
        The board is only found in the mirrored picture; no points are given then.
    """

    ids: IntArray
    pixels: FloatArray
    grid_seen: tuple[int, int] | None = None
    mirrored: bool = False

    def __bool__(self) -> bool:
        return len(self.ids) > 0


def grey(image: ByteArray) -> ByteArray:
    """A picture's luminance, (h, w), from (h, w) or (h, w, 3) blue, green, red."""
    if image.ndim == 2:
        return image
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def detect_board(image: ByteArray, board: Board) -> Detection:
    """Find a board and measure its points.

    Chessboards must be seen whole; of a ChArUco board any part will do. The order of a chessboard's corners follows
    its colours; where those leave a choice (`Board.turns_seen`), the first row runs to the right of the picture.

    Parameters
    ----------
    image : (h, w) or (h, w, 3) uint8 array
        The picture; colour as blue, green, red.
    """
    picture = grey(image)
    if board.kind == "chessboard":
        return _chessboard(picture, board)
    if board.kind == "charuco":
        return _charuco(picture, board)
    return _circles(picture, board)


def _nothing(grid_seen: tuple[int, int] | None = None, *, mirrored: bool = False) -> Detection:
    return Detection(np.empty(0, dtype=np.int64), np.empty((0, 2)), grid_seen, mirrored)


# ---------------------------------------------------------------------------------------------------------- chessboard


def _chessboard(picture: ByteArray, board: Board) -> Detection:
    """The size-free sector-based detector first, which also tells another size; then the classic one.

    A. Duda, U. Frese, "Accurate Detection and Localization of Checkerboard Corners for Calibration", BMVC 2018. The
    classic detector finds boards that the first one cuts short; where there is no such board it is slow, hence the
    reduced picture.
    """
    seen, grid = _largest_grid(picture)
    wanted = (max(board.columns, board.rows), min(board.columns, board.rows))
    if grid is None or seen != wanted:
        grid = _classic(picture, board)
    if grid is None:
        return _nothing(seen)
    corners = refine_corners(picture, _canonical(picture, grid, board))
    return Detection(np.arange(board.points), corners.reshape(-1, 2), seen)


def _largest_grid(picture: ByteArray) -> tuple[tuple[int, int] | None, FloatArray | None]:
    """Size (larger number first) and corners (rows, columns, 2) of the largest chessboard in the picture."""
    flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, points, meta = cv2.findChessboardCornersSBWithMeta(picture, (_SMALLEST_GRID, _SMALLEST_GRID), flags)
    if not found or points is None or meta is None:
        return None, None
    grid = _without_false_lines(picture, np.asarray(points, dtype=np.float64).reshape(*meta.shape[:2], 2))
    if min(grid.shape[:2]) < _SMALLEST_GRID:
        return None, None
    rows, columns = grid.shape[:2]
    return (max(rows, columns), min(rows, columns)), grid


def _without_false_lines(picture: ByteArray, grid: FloatArray) -> FloatArray:
    """The grid without outer lines on which no squares meet, such as the edge of the paper."""
    for _ in range(2):
        crossing = _crossing(picture, grid)
        usual = np.median(crossing)
        for axis in (0, 1):
            lines = np.median(crossing, axis=1 - axis)
            keep = slice(int(lines[0] < _CROSSING * usual), len(lines) - int(lines[-1] < _CROSSING * usual))
            grid = grid[keep] if axis == 0 else grid[:, keep]
            crossing = crossing[keep] if axis == 0 else crossing[:, keep]
        if min(grid.shape[:2]) < 2:
            break
    return grid


def _crossing(picture: ByteArray, grid: FloatArray) -> FloatArray:
    """How much the two dark squares at a corner differ from the two bright ones, (rows, columns), in grey levels.

    The smallest bright one less the largest dark one, since the edge of a sheet shows three of one kind.
    """
    along, down = np.gradient(grid, axis=1), np.gradient(grid, axis=0)
    places = [grid + 0.3 * (i * along + j * down) for i, j in ((1, 1), (-1, -1), (1, -1), (-1, 1))]
    levels = [_levels_at(picture, p) for p in places]
    one = np.minimum(levels[0], levels[1]) - np.maximum(levels[2], levels[3])
    other = np.minimum(levels[2], levels[3]) - np.maximum(levels[0], levels[1])
    return np.asarray(np.maximum(one, other))


def _levels_at(picture: ByteArray, places: FloatArray) -> FloatArray:
    """Grey levels at places (rows, columns, 2) between the pixels, (rows, columns)."""
    maps = places.astype(np.float32)
    levels = cv2.remap(picture, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(levels, dtype=np.float64)


def _classic(picture: ByteArray, board: Board) -> FloatArray | None:
    scale = min(1.0, _SEARCH_WIDTH / max(picture.shape))
    small = picture
    if scale < 1.0:
        small = np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
    found, points = cv2.findChessboardCorners(small, (board.columns, board.rows), flags=flags)
    if not found or points is None:
        return None
    grid = np.asarray(points, dtype=np.float64).reshape(board.rows, board.columns, 2)
    # Pixel centres are at integers, so an image of half the size is not simply at half the coordinates.
    return np.asarray((grid + 0.5) / scale - 0.5)


def _canonical(picture: ByteArray, grid: FloatArray, board: Board) -> FloatArray:
    """The same corners in the board's order: seen from the front, dark square first, first row to the right."""
    turned = [np.rot90(grid, k) for k in range(4)] + [np.rot90(grid[::-1], k) for k in range(4)]
    fitting = [g for g in turned if g.shape[:2] == (board.rows, board.columns) and _seen_from_front(g)]
    dark = [g for g in fitting if _first_square_is_dark(picture, g)]
    return max(dark or fitting, key=lambda g: float((g[:, -1] - g[:, 0]).sum(axis=0)[0]))


def _seen_from_front(grid: FloatArray) -> bool:
    along, down = (grid[:, -1] - grid[:, 0]).sum(axis=0), (grid[-1] - grid[0]).sum(axis=0)
    return bool(along[0] * down[1] - along[1] * down[0] > 0)


def _first_square_is_dark(picture: ByteArray, grid: FloatArray) -> bool:
    """Whether the square between the first four corners is darker than its neighbours of the other colour."""
    centres = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    levels = _levels_at(picture, centres)
    row, column = np.indices(levels.shape[:2])
    even = (row + column) % 2 == 0
    return bool(levels[even].mean() < levels[~even].mean()) if (~even).any() else bool(levels.mean() < picture.mean())


# ------------------------------------------------------------------------------------------------------------- charuco


def _charuco(picture: ByteArray, board: Board) -> Detection:
    detection = _charuco_corners(picture, board)
    if detection:
        return detection
    flipped = np.ascontiguousarray(picture[:, ::-1])
    return _nothing(mirrored=bool(_charuco_corners(flipped, board)))


def _charuco_corners(picture: ByteArray, board: Board) -> Detection:
    """Corners of a ChArUco board in the present layout, or in the one that OpenCV had before version 4.6."""
    least = max(4, round(_CHARUCO_MIN_SHARE * board.points))
    for legacy in (False, True):
        pattern = _charuco_pattern(board)
        pattern.setLegacyPattern(legacy)
        corners, ids, _, _ = cv2.aruco.CharucoDetector(pattern).detectBoard(picture)
        if ids is not None and corners is not None and len(ids) >= least:
            order = np.argsort(ids.ravel())
            found = np.asarray(ids.ravel()[order], dtype=np.int64)
            pixels = np.asarray(corners, dtype=np.float64).reshape(-1, 2)[order]
            return _refined_part(picture, board, found, pixels)
    return _nothing()


def _refined_part(picture: ByteArray, board: Board, ids: IntArray, pixels: FloatArray) -> Detection:
    grid = grid_of(ids, pixels, board.columns, board.rows)
    # Markers stand inside every second square: only what lies before their edge belongs to the corner.
    reach = 0.9 * (1.0 - (board.marker_mm or 0.0) / board.square_mm) / 2.0
    refined = refine_corners(picture, grid, inner=reach, border=reach).reshape(-1, 2)[ids]
    return Detection(ids, refined)


def _charuco_pattern(board: Board) -> cv2.aruco.CharucoBoard:
    size = (board.columns + 1, board.rows + 1)
    dictionary = marker_dictionary(board.dictionary or "")
    return cv2.aruco.CharucoBoard(size, board.square_mm, board.marker_mm or 0.0, dictionary)


# ------------------------------------------------------------------------------------------------------------- circles


def _circles(picture: ByteArray, board: Board) -> Detection:
    kind = cv2.CALIB_CB_SYMMETRIC_GRID if board.kind == "circles" else cv2.CALIB_CB_ASYMMETRIC_GRID
    for flags in (kind, kind | cv2.CALIB_CB_CLUSTERING):
        found, points = cv2.findCirclesGrid(picture, (board.columns, board.rows), flags=flags)
        if found and points is not None:
            return _ordered_circles(np.asarray(points, dtype=np.float64), board)
    return _nothing()


def _ordered_circles(points: FloatArray, board: Board) -> Detection:
    """Circles in the board's order: of those orders that a flat board can have, one seen from the front."""
    grid = points.reshape(board.rows, board.columns, 2)
    orders = [np.rot90(g, k) for g in (grid, grid[::-1]) for k in range(4)]
    orders = [g for g in orders if g.shape[:2] == (board.rows, board.columns)]
    misfits = [_misfit_px(g, board) for g in orders]
    fitting = [g for g, misfit in zip(orders, misfits, strict=True) if misfit <= 2 * min(misfits) + 0.1]
    best = max(
        [g for g in fitting if _seen_from_front(g)] or fitting,
        key=lambda g: float((g[:, -1] - g[:, 0]).sum(axis=0)[0]),
    )
    return Detection(np.arange(board.points), best.reshape(-1, 2))


def _misfit_px(grid: FloatArray, board: Board) -> float:
    """Root mean square distance of circles from the best image of a flat board."""
    plane, pixels = board.points_mm()[:, :2], grid.reshape(-1, 2)
    homography = np.asarray(cv2.findHomography(plane, pixels)[0])
    if homography.shape != (3, 3):
        return float("inf")
    mapped = cv2.perspectiveTransform(plane[:, None], homography)[:, 0]
    return float(np.sqrt(((mapped - pixels) ** 2).sum(axis=1).mean()))
