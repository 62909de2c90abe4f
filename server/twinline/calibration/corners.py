"""Sub-pixel position of the corners of a chessboard."""

import cv2
import numpy as np

from twinline.arrays import ByteArray, FloatArray, IntArray

_INNER = 0.45
_BORDER = 0.3
_SMALLEST_PX = 2
_LARGEST_PX = 60
_STEPS = 100
_PRECISION_PX = 1e-4


def refine_corners(
    picture: ByteArray, grid: FloatArray, *, inner: float = _INNER, border: float = _BORDER
) -> FloatArray:
    """Where the edges that meet in each corner cross.

    The position is the one to which all gradients in a window are perpendicular (W. Forstner, E. Gulch, "A fast
    operator for detection and precise location of distinct points, corners and centres of circular features", 1987), as
    OpenCV computes it. Its window is chosen for each corner by the distance to the nearest other corner: a fixed number
    of pixels is too small for near boards, and reaches into the next edges in far ones, which moved the focal length by
    1 % in trials. Corners at the border get a smaller window, since outer squares may be cut narrower.

    Parameters
    ----------
    picture : (h, w) uint8 array
        Luminance.
    grid : (rows, columns, 2) array
        Approximate corners in pixels, good to a few pixels; NaN where a corner was not found.
    inner, border
        Half width of the window as a share of the distance to the nearest corner.

    Returns
    -------
    (rows, columns, 2) array
        Refined corners; as given where the window would leave the picture.
    """
    distance = nearest_corner_px(grid)
    share = np.full(distance.shape, border)
    share[1:-1, 1:-1] = inner
    half = np.where(np.isfinite(distance), np.clip(share * distance, _SMALLEST_PX, _LARGEST_PX), 0).round().astype(int)
    out = np.array(grid, dtype=np.float64)
    for width in np.unique(half[half > 0]):
        chosen = half == width
        out[chosen] = _cross(picture, grid[chosen], int(width))
    # A window that was drawn to another corner is worse than none.
    moved = np.linalg.norm(out - grid, axis=2)
    lost = ~(moved <= np.maximum(0.35 * distance, _SMALLEST_PX))
    out[lost] = grid[lost]
    return out


def _cross(picture: ByteArray, points: FloatArray, half: int) -> FloatArray:
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, _STEPS, _PRECISION_PX)
    start = np.ascontiguousarray(points, dtype=np.float32).reshape(-1, 1, 2)
    refined = cv2.cornerSubPix(picture, start, (half, half), (-1, -1), criteria)
    return np.asarray(refined, dtype=np.float64).reshape(-1, 2)


def nearest_corner_px(grid: FloatArray) -> FloatArray:
    """Distance of each corner to the nearest of its four neighbours, (rows, columns); NaN where there is none."""
    nearest = np.full(grid.shape[:2], np.inf)
    for axis in (0, 1):
        gap = np.linalg.norm(np.diff(grid, axis=axis), axis=2)
        gap = np.where(np.isfinite(gap), gap, np.inf)
        ahead = (slice(None, -1), slice(None)) if axis == 0 else (slice(None), slice(None, -1))
        behind = (slice(1, None), slice(None)) if axis == 0 else (slice(None), slice(1, None))
        nearest[ahead] = np.minimum(nearest[ahead], gap)
        nearest[behind] = np.minimum(nearest[behind], gap)
    return np.where(np.isfinite(nearest), nearest, np.nan)


def grid_of(ids: IntArray, pixels: FloatArray, columns: int, rows: int) -> FloatArray:
    """Points by row and column of the board, (rows, columns, 2); NaN where one was not found."""
    grid = np.full((rows, columns, 2), np.nan)
    grid[ids // columns, ids % columns] = pixels
    return grid
