"""Where the cart was at any moment, from telemetry: a pure function of what was recorded.

Two things blur it. The board samples its position at an exactly known moment of its own clock, but that clock is known
in host time only to about a millisecond, which at 50 mm/s is 0.05 mm: so host time is turned into board time by a line
fitted to many samples at once. And positions have noise of their own: so a position is taken from a parabola through as
many neighbouring samples as still lie on one, which are few where the cart changes its acceleration and many where it
runs evenly.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from twinline.arrays import BoolArray, FloatArray, IntArray

MOST_GAP_S = 0.5
"""Between samples further apart nobody knows what the cart did, unless it stood still."""

CLOCK_SPAN_S = 20.0
"""Length of the pieces in which the two clocks are taken to drift evenly."""

_RESTART_S = 1.0
_REACHES = (2, 4, 8)
_FEWEST_FOR_FIT = 5
_STILL_MM = 0.02
_EXACT_MM = 0.002
_REJECT = 4.0


@dataclass(frozen=True, eq=False)
class CartTrack:
    """Telemetry as far as it tells the cart's position.

    Attributes
    ----------
    host_time_s : (k,) array
        When each sample was taken, in host time: without bias, but noisy.
    board_time_s : (k,) array
        The same by the board's own clock, exactly; starts anew when the board does.
    cart_mm : (k,) array
    """

    host_time_s: FloatArray
    board_time_s: FloatArray
    cart_mm: FloatArray

    def legs(self) -> Iterator["CartTrack"]:
        """The track between restarts of the board, each part in the order of the board's clock."""
        if not len(self.cart_mm):
            return
        offset = self.host_time_s - self.board_time_s
        cuts = np.flatnonzero((np.diff(self.board_time_s) <= 0) | (np.abs(np.diff(offset)) > _RESTART_S)) + 1
        for part in np.split(np.arange(len(offset)), cuts):
            yield CartTrack(self.host_time_s[part], self.board_time_s[part], self.cart_mm[part])


def cart_at(track: CartTrack, host_time_s: FloatArray) -> FloatArray:
    """Positions of the cart at moments of host time.

    Parameters
    ----------
    host_time_s : (m,) array
        Any order; NaN allowed.

    Returns
    -------
    (m,) array
        Millimetres; NaN where the telemetry does not tell: before its start, after its end, within a gap of more than
        `MOST_GAP_S` in which the cart moved.
    """
    host_time_s = np.asarray(host_time_s, np.float64)
    positions = np.full(host_time_s.shape, np.nan)
    for leg in track.legs():
        if len(leg.cart_mm) < 2:
            continue
        board = host_to_board(leg, host_time_s)
        # A frame right at either end may lie beyond the last sample by what the clocks disagree.
        slack_s = 0.5 * float(np.median(np.diff(leg.board_time_s)))
        inside = (board >= leg.board_time_s[0] - slack_s) & (board <= leg.board_time_s[-1] + slack_s)
        positions[inside] = _positions(leg.board_time_s, leg.cart_mm, board[inside])
    return positions


def host_to_board(leg: CartTrack, host_time_s: FloatArray) -> FloatArray:
    """Moments of host time on the board's clock.

    Each piece of about `CLOCK_SPAN_S` has a line fitted to it, outliers left out (a sample that came late); between
    the middles of pieces the lines are blended, so that the clock has no steps.

    Parameters
    ----------
    leg
        Telemetry without a restart of the board.
    """
    offset = leg.host_time_s - leg.board_time_s
    times = leg.host_time_s
    pieces = max(int((times[-1] - times[0]) / CLOCK_SPAN_S), 1)
    knots, at_knots = [], []
    for part in np.array_split(np.arange(len(times)), pieces):
        middle = float(times[part].mean())
        slope, level = _line(times[part] - middle, offset[part])
        knots.append(middle)
        at_knots.append(level)
    if pieces == 1:
        return np.asarray(host_time_s - (at_knots[0] + slope * (host_time_s - knots[0])))
    # Straight on beyond the outer middles.
    first, last = times[0], times[-1]
    ends = [_beyond(knots[:2], at_knots[:2], first), _beyond(knots[-2:], at_knots[-2:], last)]
    blended = np.interp(host_time_s, [first, *knots, last], [ends[0], *at_knots, ends[1]])
    return np.asarray(host_time_s - blended)


def _beyond(knots: list[float], levels: list[float], time_s: float) -> float:
    return levels[0] + (levels[1] - levels[0]) * (time_s - knots[0]) / (knots[1] - knots[0])


def _line(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Slope and level of a line, by least squares without what lies far off; level alone for a few points."""
    kept = np.ones(len(x), bool)
    slope, level = 0.0, float(np.median(y))
    for _ in range(4):
        if np.ptp(x[kept]) > 1.0:
            slope, level = (float(value) for value in np.polyfit(x[kept], y[kept], 1))
        else:
            slope, level = 0.0, float(y[kept].mean())
        off = np.abs(y - (level + slope * x))
        kept = off <= max(_REJECT * 1.4826 * float(np.median(off)), 1e-9)
        if kept.sum() < 2:
            break
    return slope, level


def _positions(time_s: FloatArray, cart_mm: FloatArray, at_s: FloatArray) -> FloatArray:
    """Positions at moments of the board's clock."""
    after = np.clip(np.searchsorted(time_s, at_s), 1, len(time_s) - 1)
    before = after - 1
    gap_s, moved_mm = time_s[after] - time_s[before], cart_mm[after] - cart_mm[before]
    share = (at_s - time_s[before]) / gap_s
    positions = cart_mm[before] + share * moved_mm
    positions[(gap_s > MOST_GAP_S) & (np.abs(moved_mm) > _STILL_MM)] = np.nan
    noise_mm = _noise_mm(cart_mm)
    nearest = np.where(share < 0.5, before, after)
    usable = np.isfinite(positions)
    for reach in _REACHES:
        fitted, good = _parabolas(time_s, cart_mm, at_s, nearest, reach, noise_mm)
        # Samples that no longer lie on one parabola with their neighbours are not helped by more of them.
        usable &= good
        positions = np.where(usable, fitted, positions)
    return positions


def _parabolas(
    time_s: FloatArray, cart_mm: FloatArray, at_s: FloatArray, nearest: IntArray, reach: int, noise_mm: float
) -> tuple[FloatArray, BoolArray]:
    """Values of parabolas through the samples around each moment, and whether the samples lie on them."""
    count = 2 * reach + 1
    if len(time_s) < max(count, _FEWEST_FOR_FIT):
        return np.zeros(len(at_s)), np.zeros(len(at_s), bool)
    first = np.clip(nearest - reach, 0, len(time_s) - count)
    rows = first[:, None] + np.arange(count)
    middle_s = time_s[rows].mean(axis=1)
    scale_s = time_s[rows[:, -1]] - time_s[rows[:, 0]]
    x = (time_s[rows] - middle_s[:, None]) / scale_s[:, None]
    y = cart_mm[rows] - cart_mm[nearest][:, None]
    design = np.stack([np.ones_like(x), x, x * x], axis=-1)
    normal = np.einsum("mki,mkj->mij", design, design)
    right = np.einsum("mki,mk->mi", design, y)
    coefficients = np.linalg.solve(normal, right[..., None])[..., 0]
    off = y - np.einsum("mki,mi->mk", design, coefficients)
    rms = np.sqrt((off * off).sum(axis=1) / (count - 3))
    spacing_s = np.diff(time_s[rows], axis=1)
    even = spacing_s.max(axis=1) <= MOST_GAP_S
    at = (at_s - middle_s) / scale_s
    value = coefficients[:, 0] + at * (coefficients[:, 1] + at * coefficients[:, 2]) + cart_mm[nearest]
    return value, (rms <= 1.5 * noise_mm + _EXACT_MM) & even


def _noise_mm(cart_mm: FloatArray) -> float:
    """Standard deviation of single positions while the cart moves, from their third differences."""
    third = np.diff(cart_mm, 3)
    moving = np.abs(cart_mm[3:] - cart_mm[:-3]) > 0
    if moving.sum() < _FEWEST_FOR_FIT:
        return 0.0
    return float(1.4826 * np.median(np.abs(third[moving])) / np.sqrt(20.0))
