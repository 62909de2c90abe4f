"""Heights on a grid over the bed: what 2.5-D output, live pictures and the search for holes work on.

A wall has many heights over one place. The map keeps the highest surface of each cell; the cloud beside it keeps the
wall.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.ndimage import distance_transform_edt, label, maximum_filter

from twinline.arrays import BoolArray, FloatArray, IntArray
from twinline.errors import InputError
from twinline.fusion.cloud import PointCloud

LAYER_MM = 1.0
"""Points of a cell further than this below its highest one belong to another surface."""

_MOST_CELLS = 40_000_000
_UNEVEN_MM = 2.0


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Heights over the bed.

    Attributes
    ----------
    height_mm : (rows, columns) float32 array
        Row i, column j stands for x = low_mm[0] + (i + 1/2) cell_mm, y = low_mm[1] + (j + 1/2) cell_mm; NaN where
        there is no point.
    sigma_mm : (rows, columns) float32 array
        Its standard deviation.
    count : (rows, columns) int array
        Points of the highest surface in each cell.
    low_mm : (2,) array
        Corner of the first cell.
    """

    height_mm: FloatArray
    sigma_mm: FloatArray
    count: IntArray
    low_mm: FloatArray
    cell_mm: float

    @property
    def shape(self) -> tuple[int, int]:
        """Rows along x, columns along y."""
        rows, columns = self.height_mm.shape
        return rows, columns

    def places(self) -> FloatArray:
        """Middles of the cells, (rows, columns, 2), mm."""
        rows, columns = self.shape
        x = self.low_mm[0] + (np.arange(rows) + 0.5) * self.cell_mm
        y = self.low_mm[1] + (np.arange(columns) + 0.5) * self.cell_mm
        return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)


def height_map(
    cloud: PointCloud,
    cell_mm: float,
    *,
    low_mm: tuple[float, float] | None = None,
    high_mm: tuple[float, float] | None = None,
) -> HeightMap:
    """The highest surface of each cell: the mean of its points by inverse variance.

    Parameters
    ----------
    cell_mm
        Size of the cells.
    low_mm, high_mm : (float, float)
        Area x, y; by default that of the cloud.

    Raises
    ------
    InputError
        An empty cloud without an area, a size that is not positive, or more cells than fit into memory.
    """
    good = np.isfinite(cloud.points_mm).all(axis=1) & (cloud.sigma_mm > 0)
    points, sigma = cloud.points_mm[good].astype(np.float64), cloud.sigma_mm[good].astype(np.float64)
    if not (np.isfinite(cell_mm) and cell_mm > 0):
        raise InputError(f"The cells of a height map must be larger than 0 mm, not {cell_mm:g} mm.")
    if not len(points) and (low_mm is None or high_mm is None):
        raise InputError("A cloud without points has no height map: give the area, or scan again.")
    low = np.asarray(low_mm if low_mm is not None else points[:, :2].min(axis=0), np.float64)
    high = np.asarray(high_mm if high_mm is not None else points[:, :2].max(axis=0), np.float64)
    rows, columns = (max(int(n), 0) + 1 for n in np.floor((high - low) / cell_mm))
    if rows * columns > _MOST_CELLS:
        raise InputError(
            f"A height map of {high[0] - low[0]:.0f} x {high[1] - low[1]:.0f} mm in cells of {cell_mm:g} mm is too "
            "large: crop the cloud, or take larger cells."
        )
    height, deviation, count = _highest(points, sigma, low, cell_mm, rows, columns, LAYER_MM)
    return HeightMap(height, deviation, count, low, cell_mm)


@njit(cache=True, error_model="numpy")
def _highest(
    points: FloatArray, sigma: FloatArray, low: FloatArray, cell_mm: float, rows: int, columns: int, layer_mm: float
) -> tuple[FloatArray, FloatArray, IntArray]:  # pragma: no cover - compiled
    top = np.full((rows, columns), -np.inf)
    for i in range(points.shape[0]):
        a, b = int(np.floor((points[i, 0] - low[0]) / cell_mm)), int(np.floor((points[i, 1] - low[1]) / cell_mm))
        if 0 <= a < rows and 0 <= b < columns:
            top[a, b] = max(top[a, b], points[i, 2])
    weight, total = np.zeros((rows, columns)), np.zeros((rows, columns))
    count = np.zeros((rows, columns), np.int32)
    for i in range(points.shape[0]):
        a, b = int(np.floor((points[i, 0] - low[0]) / cell_mm)), int(np.floor((points[i, 1] - low[1]) / cell_mm))
        if 0 <= a < rows and 0 <= b < columns and points[i, 2] >= top[a, b] - layer_mm:
            w = 1.0 / (sigma[i] * sigma[i])
            weight[a, b] += w
            total[a, b] += w * points[i, 2]
            count[a, b] += 1
    height, deviation = np.full((rows, columns), np.float32(np.nan)), np.full((rows, columns), np.float32(np.nan))
    for a in range(rows):
        for b in range(columns):
            if count[a, b]:
                height[a, b] = total[a, b] / weight[a, b]
                deviation[a, b] = np.sqrt(1.0 / weight[a, b])
    return height, deviation, count


def grown(height_mm: FloatArray) -> FloatArray:
    """The same with each gap closed from its edge, (rows, columns); NaN only where there is nothing at all.

    Cells take the height of the nearest cell at a gap's edge. Where the edge is partly high and partly low, as around a
    shadow, only its lower half counts: what an object hides is most often the ground that it stands on.
    """
    heights = np.asarray(height_mm, np.float64)
    missing: BoolArray = ~np.isfinite(heights)
    if not missing.any() or missing.all():
        return heights.copy()
    eight = np.ones((3, 3), bool)
    gap, number = label(missing, eight)
    # The gap that each known cell borders on; of several one.
    beside = np.where(missing, 0, maximum_filter(gap, footprint=eight, mode="constant"))
    edge = beside > 0
    low, high = np.full(number + 1, np.inf), np.full(number + 1, -np.inf)
    np.minimum.at(low, beside[edge], heights[edge])
    np.maximum.at(high, beside[edge], heights[edge])
    low[~np.isfinite(low)], high[~np.isfinite(high)] = 0.0, 0.0
    limit = np.where(high - low > _UNEVEN_MM, 0.5 * (low + high), np.inf)
    lenders = edge & (heights <= limit[beside])
    nearest = distance_transform_edt(~lenders, return_distances=False, return_indices=True)
    return np.where(missing, heights[tuple(nearest)], heights)
