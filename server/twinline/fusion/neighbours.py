"""Points by the place they lie over, and the surface that they form around other places."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from twinline.arrays import FloatArray, IntArray

_MOST_CELLS = 40_000_000
_FLATTEST = 1e-3
"""Points that lie nearly on one line over the bed fix no plane: least spread across it, in shares of the reach."""


@dataclass(frozen=True, eq=False)
class LocalSurface:
    """Planes through the points around places, arrays of (n,); NaN where there are too few of them.

    Attributes
    ----------
    height_mm, variance_mm2
        Height of the plane over the place, and its variance.
    slope_x, slope_y
        Of the plane.
    misfit
        Mean square distance of the points to their plane, in units of their variance.
    lean
        How far the points' middle lies from the place, in shares of the reach: near 1 the plane is continued beyond
        its end.
    count
        How many points.
    """

    height_mm: FloatArray
    variance_mm2: FloatArray
    slope_x: FloatArray
    slope_y: FloatArray
    misfit: FloatArray
    lean: FloatArray
    count: FloatArray

    @property
    def steepness(self) -> FloatArray:
        """Rise per mm over the bed."""
        return np.asarray(np.hypot(self.slope_x, self.slope_y))


class PointGrid:
    """Points in square cells over the bed.

    Parameters
    ----------
    points_mm : (n, 3) array
    sigma_mm : (n,) array
        Their standard deviations. Points without a place or a deviation are passed over.
    cell_mm
        Size of the cells; about the reach of the questions.
    """

    def __init__(self, points_mm: FloatArray, sigma_mm: FloatArray, cell_mm: float) -> None:
        points = np.asarray(points_mm, np.float64).reshape(-1, 3)
        good = np.isfinite(points).all(axis=1) & np.isfinite(sigma_mm) & (np.asarray(sigma_mm) > 0)
        self._points = np.ascontiguousarray(points[good].T)
        self._sigma = np.asarray(sigma_mm, np.float64)[good]
        self._rows = np.flatnonzero(good)
        self._low, self._shape, self._cell_mm = np.zeros(2), (1, 1), cell_mm
        if good.any():
            low, high = self._points[:2].min(axis=1), self._points[:2].max(axis=1)
            # A stray point kilometres away must not ask for memory.
            while np.prod((high - low) / self._cell_mm + 1.0) > _MOST_CELLS:
                self._cell_mm *= 2.0
            rows, columns = (int(n) + 1 for n in np.floor((high - low) / self._cell_mm))
            self._low, self._shape = low, (rows, columns)
        self._start, self._order = sort_by_cell(self._points, self._low, self._cell_mm, *self._shape)

    def __len__(self) -> int:
        return len(self._rows)

    def surface(self, places_mm: FloatArray, reach_mm: tuple[float, float]) -> LocalSurface:
        """Planes around places.

        Each point counts by its inverse variance and by how near it is: a tent that is 0 at the reach, which on a
        regular raster with that spacing is linear interpolation.

        Parameters
        ----------
        places_mm : (n, 2 or 3) array
            x, y; further columns are ignored.
        reach_mm : (float, float)
            Half width of the tent along x and y.
        """
        places = np.ascontiguousarray(np.asarray(places_mm, np.float64)[:, :2])
        if not len(self) or not len(places):
            return LocalSurface(*np.broadcast_to(np.float64(np.nan), (7, len(places))))
        out = np.full((7, len(places)), np.nan)
        _planes(
                places, self._points, self._sigma, self._start, self._order, self._low, self._cell_mm, *self._shape,
                *reach_mm, out,
            )  # fmt: skip
        return LocalSurface(*out)

    def nearest(self, points_mm: FloatArray, limit_mm: float) -> tuple[FloatArray, IntArray]:
        """Distance in space (n,) from each point (n, 3) to the nearest of the grid's, and that one's row.

        Infinity and -1 where there is none within the limit.
        """
        wanted = np.asarray(points_mm, np.float64).reshape(-1, 3)
        gap, index = np.full(len(wanted), np.inf), np.full(len(wanted), -1, np.int64)
        if len(self) and len(wanted):
            _nearest(
                wanted, self._points, self._start, self._order, self._low, self._cell_mm, *self._shape, limit_mm, gap,
                index,
            )  # fmt: skip
            index = np.where(index >= 0, self._rows[index], -1)
        return gap, index

    def crowd(self, points_mm: FloatArray, reach_mm: float) -> IntArray:
        """How many of the grid's points lie within a ball around each point (n, 3); 0 around NaN."""
        wanted = np.asarray(points_mm, np.float64).reshape(-1, 3)
        count = np.zeros(len(wanted), np.int64)
        if len(self) and len(wanted):
            _crowd(
                wanted, self._points, self._start, self._low, self._order, self._cell_mm, *self._shape, reach_mm, count
            )
        return count


@njit(cache=True, error_model="numpy")
def sort_by_cell(
    points: FloatArray, low: FloatArray, cell_mm: float, rows: int, columns: int
) -> tuple[IntArray, IntArray]:  # pragma: no cover - compiled
    """Points (3, n) by cell, in their own order within each: where each cell starts, and the points' numbers."""
    n = points.shape[1]
    start = np.zeros(rows * columns + 1, np.int64)
    key = np.empty(n, np.int64)
    for i in range(n):
        a = int((points[0, i] - low[0]) / cell_mm)
        b = int((points[1, i] - low[1]) / cell_mm)
        key[i] = min(a, rows - 1) * columns + min(b, columns - 1)
        start[key[i] + 1] += 1
    for k in range(rows * columns):
        start[k + 1] += start[k]
    fill = start[:-1].copy()
    order = np.empty(n, np.int64)
    for i in range(n):
        order[fill[key[i]]] = i
        fill[key[i]] += 1
    return start, order


@njit(cache=True, error_model="numpy")
def _nearest(
    wanted: FloatArray, points: FloatArray, start: IntArray, order: IntArray, low: FloatArray, cell_mm: float,
    rows: int, columns: int, limit_mm: float, gap: FloatArray, index: IntArray,
) -> None:  # fmt: skip  # pragma: no cover - compiled
    for i in range(wanted.shape[0]):
        px, py, pz = wanted[i, 0], wanted[i, 1], wanted[i, 2]
        if not (np.isfinite(px) and np.isfinite(py) and np.isfinite(pz)):
            continue
        a0 = max(int(np.floor((px - limit_mm - low[0]) / cell_mm)), 0)
        a1 = min(int(np.floor((px + limit_mm - low[0]) / cell_mm)), rows - 1)
        b0 = max(int(np.floor((py - limit_mm - low[1]) / cell_mm)), 0)
        b1 = min(int(np.floor((py + limit_mm - low[1]) / cell_mm)), columns - 1)
        best = limit_mm * limit_mm
        for a in range(a0, a1 + 1):
            if b1 < b0:
                break
            for q in range(start[a * columns + b0], start[a * columns + b1 + 1]):
                j = order[q]
                dx, dy, dz = points[0, j] - px, points[1, j] - py, points[2, j] - pz
                square = dx * dx + dy * dy + dz * dz
                if square <= best:
                    best = square
                    index[i] = j
        if index[i] >= 0:
            gap[i] = np.sqrt(best)


@njit(cache=True, error_model="numpy")
def _crowd(
    wanted: FloatArray, points: FloatArray, start: IntArray, low: FloatArray, order: IntArray, cell_mm: float,
    rows: int, columns: int, reach_mm: float, count: IntArray,
) -> None:  # fmt: skip  # pragma: no cover - compiled
    for i in range(wanted.shape[0]):
        px, py, pz = wanted[i, 0], wanted[i, 1], wanted[i, 2]
        if not (np.isfinite(px) and np.isfinite(py) and np.isfinite(pz)):
            continue
        a0 = max(int(np.floor((px - reach_mm - low[0]) / cell_mm)), 0)
        a1 = min(int(np.floor((px + reach_mm - low[0]) / cell_mm)), rows - 1)
        b0 = max(int(np.floor((py - reach_mm - low[1]) / cell_mm)), 0)
        b1 = min(int(np.floor((py + reach_mm - low[1]) / cell_mm)), columns - 1)
        for a in range(a0, a1 + 1):
            if b1 < b0:
                break
            for q in range(start[a * columns + b0], start[a * columns + b1 + 1]):
                j = order[q]
                dx, dy, dz = points[0, j] - px, points[1, j] - py, points[2, j] - pz
                count[i] += dx * dx + dy * dy + dz * dz <= reach_mm * reach_mm


@njit(cache=True, error_model="numpy")
def _planes(
    places: FloatArray, points: FloatArray, sigma: FloatArray, start: IntArray, order: IntArray, low: FloatArray,
    cell_mm: float, rows: int, columns: int, reach_x: float, reach_y: float, out: FloatArray,
) -> None:  # fmt: skip  # pragma: no cover - compiled
    for i in range(places.shape[0]):
        px, py = places[i, 0], places[i, 1]
        if not (np.isfinite(px) and np.isfinite(py)):
            continue
        a0 = max(int(np.floor((px - reach_x - low[0]) / cell_mm)), 0)
        a1 = min(int(np.floor((px + reach_x - low[0]) / cell_mm)), rows - 1)
        b0 = max(int(np.floor((py - reach_y - low[1]) / cell_mm)), 0)
        b1 = min(int(np.floor((py + reach_y - low[1]) / cell_mm)), columns - 1)
        if b1 < b0:
            continue
        w0, wx, wy, wz, wxx, wxy, wyy, wxz, wyz, wzz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        ww, tents, count, base = 0.0, 0.0, 0, 0.0
        for a in range(a0, a1 + 1):
            for q in range(start[a * columns + b0], start[a * columns + b1 + 1]):
                j = order[q]
                dx, dy = points[0, j] - px, points[1, j] - py
                tx, ty = 1.0 - abs(dx) / reach_x, 1.0 - abs(dy) / reach_y
                if tx <= 0.0 or ty <= 0.0:
                    continue
                w = tx * ty / (sigma[j] * sigma[j])
                if count == 0:
                    base = points[2, j]
                dz = points[2, j] - base
                count += 1
                tents += tx * ty
                ww += w * tx * ty
                w0 += w
                wx += w * dx
                wy += w * dy
                wz += w * dz
                wxx += w * dx * dx
                wxy += w * dx * dy
                wyy += w * dy * dy
                wxz += w * dx * dz
                wyz += w * dy * dz
                wzz += w * dz * dz
        out[6, i] = count
        if count < 4:
            continue
        mx, my, mz = wx / w0, wy / w0, wz / w0
        sxx, sxy, syy = wxx / w0 - mx * mx, wxy / w0 - mx * my, wyy / w0 - my * my
        sxz, syz, szz = wxz / w0 - mx * mz, wyz / w0 - my * mz, wzz / w0 - mz * mz
        determinant = sxx * syy - sxy * sxy
        if determinant < _FLATTEST * (reach_x * reach_y) ** 2:
            continue
        gx, gy = (sxz * syy - syz * sxy) / determinant, (syz * sxx - sxz * sxy) / determinant
        out[0, i] = base + mz - gx * mx - gy * my
        lever = (mx * mx * syy - 2.0 * mx * my * sxy + my * my * sxx) / determinant
        out[1, i] = ww / (w0 * w0) * (1.0 + lever)
        out[2, i], out[3, i] = gx, gy
        out[4, i] = max(szz - gx * sxz - gy * syz, 0.0) * w0 / tents
        out[5, i] = max(abs(mx) / reach_x, abs(my) / reach_y)
