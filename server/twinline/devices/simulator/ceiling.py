"""An upper limit of the heights on the bed, to leave out rays that only meet air."""

from dataclasses import dataclass

import cv2
import numba
import numpy as np

from twinline.arrays import FloatArray, IntArray

_CELL_MM = 2.0
_REACH_CELLS = 4
CEILING_REACH_MM = _CELL_MM * _REACH_CELLS
"""How far sideways of a thing the ceiling still knows of it."""


@dataclass(frozen=True, eq=False)
class Ceiling:
    """Upper limit of the height of everything near each cell of the bed.

    A cheap test that never misses a surface: what lies higher than the ceiling, at any point within
    ``CEILING_REACH_MM``, is empty air.

    Attributes
    ----------
    heights_mm : (rows along x, columns along y) array
        0 where only the bed is near.
    origin_mm : (float, float)
        Corner x, y of cell 0, 0.
    cell_mm
        Side of a cell.
    """

    heights_mm: FloatArray
    origin_mm: tuple[float, float]
    cell_mm: float

    @property
    def highest_mm(self) -> float:
        """Height of the highest thing."""
        return float(self.heights_mm.max(initial=0.0))


def build_ceiling(triangles: FloatArray) -> Ceiling:
    """Heights of the boxes around triangles, (n, 3, 3) in mm, widened by the reach in every direction."""
    if not len(triangles):
        return Ceiling(np.zeros((1, 1)), (0.0, 0.0), _CELL_MM)
    lower, upper = triangles.min(axis=1), triangles.max(axis=1)
    border = (_REACH_CELLS + 1) * _CELL_MM
    origin = lower[:, :2].min(axis=0) - border
    first = np.floor((lower[:, :2] - origin) / _CELL_MM).astype(np.int64)
    last = np.floor((upper[:, :2] - origin) / _CELL_MM).astype(np.int64)
    size = last.max(axis=0) + _REACH_CELLS + 2
    heights = np.zeros((int(size[0]), int(size[1])))
    _raise_cells(first, last, np.ascontiguousarray(upper[:, 2]), heights)
    width = 2 * _REACH_CELLS + 1
    heights = np.asarray(cv2.dilate(heights, np.ones((width, width), dtype=np.uint8)), dtype=np.float64)
    return Ceiling(heights, (float(origin[0]), float(origin[1])), _CELL_MM)


@numba.njit(cache=True, nogil=True)
def _raise_cells(
    first: IntArray, last: IntArray, tops: FloatArray, heights: FloatArray
) -> None:  # pragma: no cover - compiled
    for k in range(tops.size):
        for i in range(first[k, 0], last[k, 0] + 1):
            for j in range(first[k, 1], last[k, 1] + 1):
                heights[i, j] = max(heights[i, j], tops[k])
