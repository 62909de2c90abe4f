"""Points whose laser spot straddles an edge: found by comparing each stripe with its neighbours along the travel.

The spot of a line laser is wider than a pixel. Where it falls half on a step's upper and half on its lower face, or
half on a dark patch, its centre lies on neither; such points are the largest errors of a scan. One frame alone shows
little of it when the edge runs along the stripe. The frames before and after do: there the stripe jumps or ends, or it
is much brighter.

The filter is fed frame by frame, in order, so that a live view and an offline run see the same points.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numba import njit

from twinline.arrays import BoolArray, FloatArray, IntArray
from twinline.fusion.cloud import PointCloud

SPOT_COLUMNS = 2
"""A spot reaches so many columns to either side through the lens's point spread."""

PARTIAL_SHARE = 0.6
"""A spot weaker than this share of the strongest one that it overlaps is taken as partial."""

STEEPEST = 2.2
"""Steepest slope, in mm of height per mm of travel, that counts as one surface."""

LEAST_JUMP_PX = 1.0
MOST_REACH_FRAMES = 16


@dataclass(frozen=True, eq=False)
class FramePoints:
    """One frame's points, and the stripes they come from.

    Attributes
    ----------
    cloud
        n points.
    laser, column : (n,) int arrays
        Row and column of ``centre_px`` that each point comes from.
    centre_px, amplitude_dn : (lasers, columns) float32 arrays
        The stripes; NaN where there is none.
    lit : (lasers,) bool array
        Which lasers were on.
    """

    cloud: PointCloud
    laser: IntArray
    column: IntArray
    centre_px: FloatArray
    amplitude_dn: FloatArray
    lit: BoolArray


@dataclass(frozen=True)
class EdgeLimits:
    """The filter's measures in frames and pixels, for one scan.

    Attributes
    ----------
    reach
        Frames to either side whose spots overlap a frame's; 0 where frames lie further apart than spots are wide, so
        that one frame tells nothing of the edges in another.
    jump_px
        A stripe that moves further than this between neighbouring frames has left its surface.
    """

    reach: int
    jump_px: float

    @classmethod
    def for_scan(cls, *, pitch_mm: float, spot_sd_mm: float, px_per_mm_height: float) -> "EdgeLimits":
        """Limits from the distance between frames, the spot's width on the surface and the image scale."""
        reach = int(np.clip(round(2.0 * spot_sd_mm / max(pitch_mm, 1e-6)), 0, MOST_REACH_FRAMES))
        return cls(reach, LEAST_JUMP_PX + STEEPEST * pitch_mm * px_per_mm_height)


class EdgeFilter:
    """Drops straddling points from a stream of frames; a frame comes out ``reach`` frames after it went in."""

    def __init__(self, limits: EdgeLimits, lasers: int) -> None:
        self._limits = limits
        self._lasers = [_LaserFilter(limits) for _ in range(lasers)]
        self._waiting: deque[tuple[FramePoints, list[BoolArray | None]]] = deque()
        self.rejected = 0

    def add(self, frame: FramePoints) -> list[PointCloud]:
        """Take in the next frame; returns the clouds of the frames that can now be judged."""
        verdicts: list[BoolArray | None] = [None] * len(self._lasers)
        self._waiting.append((frame, verdicts))
        for k, laser in enumerate(self._lasers):
            if frame.lit[k]:
                laser.add(frame.centre_px[k], frame.amplitude_dn[k], verdicts, k)
            else:
                laser.skip()
                verdicts[k] = np.zeros(frame.centre_px.shape[1], bool)
        return self._ready()

    def finish(self) -> list[PointCloud]:
        """Judge the last frames by the neighbours they have."""
        for laser in self._lasers:
            laser.finish()
        return self._ready()

    def _ready(self) -> list[PointCloud]:
        clouds = []
        while self._waiting and all(v is not None for v in self._waiting[0][1]):
            frame, verdicts = self._waiting.popleft()
            whole = np.concatenate([v for v in verdicts if v is not None])
            keep = np.flatnonzero(whole.take(frame.laser * frame.centre_px.shape[1] + frame.column))
            self.rejected += len(frame.laser) - len(keep)
            clouds.append(frame.cloud.select(keep))
        return clouds


class _LaserFilter:
    """The frames in which one laser was on, and the verdicts owed to them.

    Frames are kept in a ring: frame n in row n modulo its length.
    """

    def __init__(self, limits: EdgeLimits) -> None:
        self._limits = limits
        self._centres, self._heights, self._widest = (np.empty((0, 0), np.float32) for _ in range(3))
        self._owed: deque[tuple[list[BoolArray | None], int]] = deque()
        self._seen = self._judged = 0
        self._dark = 0

    def skip(self) -> None:
        """The laser was off in a frame; off for long, its last frames are judged by the neighbours they have."""
        self._dark += 1
        if self._dark > 4 * (self._limits.reach + 1):
            self.finish()

    def add(self, centre: FloatArray, amplitude: FloatArray, verdicts: list[BoolArray | None], slot: int) -> None:
        self._dark = 0
        if not self._centres.size:
            shape = (2 * self._limits.reach + 3, len(centre))
            self._centres, self._heights, self._widest = (np.empty(shape, np.float32) for _ in range(3))
        row = self._seen % len(self._centres)
        self._centres[row] = centre
        enter_heights(amplitude, self._heights[row], self._widest[row])
        self._seen += 1
        self._owed.append((verdicts, slot))
        if self._seen - self._judged > self._limits.reach:
            self._judge()

    def finish(self) -> None:
        while self._owed:
            self._judge()

    def _judge(self) -> None:
        """Give the verdict on the first unjudged frame."""
        at, reach = self._judged, self._limits.reach
        first, last = max(at - reach, 0), min(at + reach, self._seen - 1)
        verdicts, slot = self._owed.popleft()
        verdicts[slot] = whole_spots(
            self._centres, self._heights, self._widest, at, first, last, reach, self._limits.jump_px
        )
        self._judged += 1


@njit(cache=True, error_model="numpy")
def enter_heights(amplitude: FloatArray, heights: FloatArray, widest: FloatArray) -> None:  # pragma: no cover
    """Heights of one stripe with 0 where there is none, and the highest of those that a spot reaches."""
    n = amplitude.size
    for c in range(n):
        heights[c] = amplitude[c] if amplitude[c] == amplitude[c] else 0.0
    for c in range(n):
        top = np.float32(0.0)
        for k in range(max(c - SPOT_COLUMNS, 0), min(c + SPOT_COLUMNS, n - 1) + 1):
            top = max(top, heights[k])
        widest[c] = top


@njit(cache=True, error_model="numpy")
def whole_spots(
    centres: FloatArray, heights: FloatArray, widest: FloatArray, at: int, first: int, last: int, reach: int,
    jump_px: float,
) -> BoolArray:  # fmt: skip  # pragma: no cover - compiled
    """Columns of frame ``at`` whose spot lies on one surface, judged by the frames from ``first`` to ``last``.

    Parameters
    ----------
    centres, heights, widest : (rows, columns) arrays
        Rings of frames, frame n in row n modulo ``rows``.
    """
    rows, columns = centres.shape
    here = at % rows
    strongest = np.zeros(columns, np.float32)
    whole = np.ones(columns, np.bool_)
    for n in range(first, last + 1):
        row = n % rows
        if abs(n - at) <= reach:
            for c in range(columns):
                strongest[c] = max(strongest[c], widest[row, c])
        if abs(n - at) == 1:
            for c in range(columns):
                whole[c] &= abs(centres[row, c] - centres[here, c]) <= jump_px
    for c in range(columns):
        whole[c] &= heights[here, c] >= PARTIAL_SHARE * strongest[c]
    return whole
