"""How sharp and how well exposed a board is in a picture."""

from dataclasses import dataclass

import cv2
import numpy as np

from twinline.arrays import ByteArray, FloatArray

_SAMPLES = 41
_ACROSS = 5
_SATURATED = 254
_PLATEAU = 6


@dataclass(frozen=True)
class Appearance:
    """Measured at the edges of the board's own squares or circles.

    Attributes
    ----------
    blur_px
        Standard deviation of the point spread across an edge: median over the edges along the board's rows or along
        its columns, whichever is larger, since motion blurs one of them only. A sharp camera has 0.5 to 1.2. NaN where
        no edge could be measured.
    dark, bright
        Grey levels of the dark and bright parts, 0 to 255.
    saturated
        Share of the bright parts at the end of the scale.
    growth_px
        How far bright parts reach over the edge into dark ones; a burnt picture has more than half a pixel.
    """

    blur_px: float
    dark: float
    bright: float
    saturated: float
    growth_px: float

    @property
    def contrast(self) -> float:
        """Difference of the grey levels of the bright and the dark parts."""
        return self.bright - self.dark


def board_appearance(picture: ByteArray, grid: FloatArray, *, circles: bool = False, reach: float = 0.4) -> Appearance:
    """Sharpness and exposure of a board that was found.

    Parameters
    ----------
    picture : (h, w) uint8 array
        Luminance.
    grid : (rows, columns, 2) array
        Corners or circle centres in pixels; NaN where one was not found.
    circles
        Edges lie between a centre and the middle to its neighbour, not across the line between two corners.
    reach
        How far to look to both sides of an edge, as a share of a square; short of the markers on a ChArUco board.
    """
    families = [
        _edge_profiles_along(grid, axis) if circles else _edge_profiles_across(grid, axis, reach) for axis in (0, 1)
    ]
    measured = [found for starts, ends in families if (found := _measured_edges(picture, starts, ends)) is not None]
    if not measured:
        return Appearance(float("nan"), float("nan"), float("nan"), 0.0, 0.0)
    dark, bright = min(m.dark for m in measured), max(m.bright for m in measured)
    saturated = max(m.saturated for m in measured)
    growth = 0.0 if circles else max(m.growth_px for m in measured)
    return Appearance(float(np.nanmax([m.blur_px for m in measured])), dark, bright, saturated, growth)


def _measured_edges(picture: ByteArray, starts: FloatArray, ends: FloatArray) -> Appearance | None:
    """Appearance from profiles along the lines from ``starts`` to ``ends``, (n, 2); None without any contrast."""
    known = np.isfinite(starts).all(axis=1) & np.isfinite(ends).all(axis=1)
    if not known.any():
        return None
    starts, ends = starts[known], ends[known]
    position = np.linspace(0.0, 1.0, _SAMPLES)
    points = (starts[:, None] + (ends - starts)[:, None] * position[:, None]).astype(np.float32)
    levels = cv2.remap(picture, points[..., 0], points[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    profiles = np.asarray(levels, dtype=np.float64)
    first, last = profiles[:, :_PLATEAU].mean(axis=1), profiles[:, -_PLATEAU:].mean(axis=1)
    step = last - first
    clear = np.abs(step) > 0.5 * np.median(np.abs(step))
    if not clear.any():
        return None
    dark, bright = float(np.median(np.minimum(first, last))), float(np.median(np.maximum(first, last)))
    bright_pixels = profiles[profiles > (dark + bright) / 2]
    rise = np.clip((profiles[clear] - first[clear, None]) / step[clear, None], 0.0, 1.0)
    pitch_px = np.linalg.norm(ends - starts, axis=1)[clear] / (_SAMPLES - 1)
    # The area between an edge and a step at its place measures its width: 2 sigma / sqrt(2 pi) for a Gaussian.
    place = (1.0 - rise).sum(axis=1)
    ideal = np.clip(np.arange(_SAMPLES)[None, :] + 1.0 - place[:, None], 0.0, 1.0)
    blur = np.abs(rise - ideal).sum(axis=1) * np.sqrt(2 * np.pi) / 2 * pitch_px
    growth = (_SAMPLES / 2 - place) * np.sign(step[clear]) * pitch_px
    saturated = float((bright_pixels >= _SATURATED).mean()) if bright_pixels.size else 0.0
    return Appearance(float(np.median(blur)), dark, bright, saturated, float(np.median(growth)))


def _edge_profiles_across(grid: FloatArray, axis: int, reach: float) -> tuple[FloatArray, FloatArray]:
    """Ends of short lines that cross the edges along one axis of the grid, from one square into the next."""
    edge = np.diff(grid, axis=axis)
    first = grid[:, :-1] if axis == 1 else grid[:-1]
    side = np.nanmedian(np.diff(grid, axis=1 - axis).reshape(-1, 2), axis=0)
    middles = np.concatenate([(first + edge * share).reshape(-1, 2) for share in np.linspace(0.35, 0.65, _ACROSS)])
    return middles - reach * side, middles + reach * side


def _edge_profiles_along(grid: FloatArray, axis: int) -> tuple[FloatArray, FloatArray]:
    """Ends of lines from each circle's centre to the middle of the way to its neighbour along one axis of the grid."""
    first = grid[:, :-1] if axis == 1 else grid[:-1]
    return first.reshape(-1, 2), (first + np.diff(grid, axis=axis) / 2).reshape(-1, 2)


def picture_sharpness(picture: ByteArray) -> float:
    """Blur of a picture's strongest edges, as a standard deviation in pixels; NaN for an empty picture.

    For pictures in which no board was found. A Gaussian edge of height h and spread s has the greatest slope
    h / (s sqrt(2 pi)).
    """
    smooth = cv2.GaussianBlur(picture, (0, 0), 0.8).astype(np.float32)
    slope = np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)) / 8.0
    low, high = np.percentile(picture, (2, 98))
    steepest = float(np.percentile(slope, 99.8))
    if high - low < 10 or steepest <= 0:
        return float("nan")
    spread = float(high - low) / (steepest * np.sqrt(2 * np.pi))
    return float(np.sqrt(max(spread**2 - 0.8**2, 0.0)))
