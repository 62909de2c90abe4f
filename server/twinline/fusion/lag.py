"""The ToF sensor's lag from its own raster: sweeps in opposite directions must show the same edges.

A lag draws every edge along with the sweep, so that neighbouring sweeps in opposite directions disagree by twice that.
The lag that is sought makes them agree best.
"""

from itertools import pairwise

import numpy as np

from twinline.arrays import FloatArray
from twinline.fusion.tof import TofRaster, freed_distances
from twinline.geometry.rig import TofMount

LONGEST_LAG_S = 0.12
_CUT_MM = 1.0
_COARSE = 25
_ROUNDS = 3
_FEWEST = 200
_TELLING_MM = 1.0
_NEAR_MM = 3.0
_CLEARER = 0.9


def estimate_lag(raster: TofRaster, mount: TofMount) -> float | None:
    """Time constant in seconds at which opposite sweeps agree best.

    Returns
    -------
    float or None
        None where the raster cannot tell: it has sweeps in one direction only, or shows no edges.
    """
    pairs = _opposite_pairs(raster, mount)
    if pairs is None:
        return None
    lags = np.linspace(0.0, LONGEST_LAG_S, _COARSE)
    costs = np.array([_disagreement(raster, mount, pairs, lag) for lag in lags])
    best = float(lags[np.argmin(costs)])
    none, least = float(costs[0]), float(costs.min())
    step = float(lags[1] - lags[0])
    for _ in range(_ROUNDS):
        lags = np.clip(best + step * np.linspace(-1.0, 1.0, 9), 0.0, LONGEST_LAG_S)
        costs = np.array([_disagreement(raster, mount, pairs, lag) for lag in lags])
        best, step = float(lags[np.argmin(costs)]), step / 4.0
        least = min(least, float(costs.min()))
    if not np.isfinite(least) or best >= LONGEST_LAG_S or (best > 0 and least > _CLEARER * none):
        return None
    return best


def _opposite_pairs(raster: TofRaster, mount: TofMount) -> list[tuple[FloatArray, FloatArray]] | None:
    """Rows of neighbouring sweeps in opposite directions, and where along the slide they show edges."""
    if len(raster) < _FEWEST:
        return None
    line = raster.sweeps()
    cuts = np.flatnonzero(np.diff(line)) + 1
    parts = [rows for rows in np.split(np.arange(len(raster)), cuts) if len(rows) > 20]
    distance, _ = freed_distances(raster, mount, 0.0)
    pairs = []
    for one, other in pairwise(parts):
        ways = [raster.slide_mm[rows[-1]] - raster.slide_mm[rows[0]] for rows in (one, other)]
        if ways[0] * ways[1] >= 0:
            continue
        rows = one[np.isfinite(distance[one])]
        if len(rows) < 20:
            continue
        jumps = np.abs(distance[rows[10:]] - distance[rows[:-10]]) > _TELLING_MM
        telling = raster.slide_mm[rows[5 : 5 + len(jumps)]][jumps]
        if len(telling):
            pairs.append((np.concatenate([one, [-1], other]), telling))
    return pairs if sum(len(telling) for _, telling in pairs) >= _FEWEST else None


def _disagreement(
    raster: TofRaster, mount: TofMount, pairs: list[tuple[FloatArray, FloatArray]], lag_s: float
) -> float:
    """Mean truncated difference of heights of opposite sweeps near edges, mm."""
    freed, _ = freed_distances(raster, mount, lag_s)
    total, count = 0.0, 0
    for rows, telling in pairs:
        split = int(np.flatnonzero(rows < 0)[0])
        sides = []
        places = np.unique(np.round(telling[:, None] + np.linspace(-_NEAR_MM, _NEAR_MM, 13), 1))
        for sweep in (rows[:split], rows[split + 1 :]):
            part = sweep[np.isfinite(freed[sweep])]
            if len(part) < 2:
                break
            order = part[np.argsort(raster.slide_mm[part], kind="stable")]
            sides.append(np.interp(places, raster.slide_mm[order], freed[order], left=np.nan, right=np.nan))
        if len(sides) < 2:
            continue
        difference = np.abs(sides[0] - sides[1])
        difference = difference[np.isfinite(difference)]
        total += float(np.minimum(difference, _CUT_MM).sum())
        count += len(difference)
    return total / count if count else float("inf")
