"""Which points of different sensors are compared: cells of surface that both saw, averaged over patches.

A patch is some millimetres wide and of one slope. On a curved surface a spot of light is displaced by about its own
width squared times the curvature, in a way that no parameter explains; patches count the less the more they are bent.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from twinline.arrays import BoolArray, FloatArray, IntArray
from twinline.calibration.joint_cells import CellEntries, find_cells
from twinline.calibration.joint_model import Scanner, laser_gain, laser_samples, tof_points
from twinline.calibration.joint_types import HOLD_OUT, KINDS, TOF, Association, Observations

_PAIRS = ((0, 1, 3), (0, TOF, 4), (1, TOF, 5))
_PATCH_MM = 12.0
_SLOPE_CLASS = 0.5
_SPOT_MM = 0.7
_FEWEST_CELLS = (4, 2, 1)
_FEWEST_ROWS = 12
"""Where so few patches have enough cells, as of small round objects under sparse sweeps, smaller ones count too."""
_OUTLIER_SCALES = 3.0
_LEAST_SCALE_MM = 0.02
_TOF_NOISE_MM = 0.02


def associate(scanner: Scanner, observations: Observations, cell_mm: float) -> Association:
    """Compare sensors where they saw the same smooth surface, cell by cell, and average the cells over patches."""
    axes, camera = scanner.axes(), scanner.as_camera()
    samples = [laser_samples(scanner, k, s, camera) for k, s in enumerate(observations.objects)]
    clouds = [s.points @ axes.T for s in samples]
    while len(clouds) < TOF:
        clouds.append(np.empty((0, 3)))
    tof = observations.tof_objects
    clouds.append(tof_points(scanner, tof) @ axes.T if tof is not None else np.empty((0, 3)))
    cells = find_cells(tuple(clouds), cell_mm)
    normals, height, noise = [], np.zeros(len(cells.cell)), np.zeros(len(cells.cell))
    counts = np.zeros(len(cells.cell))
    for sensor, (chosen, entry) in enumerate(zip(cells.points, cells.entry, strict=True)):
        normal = cells.normal[cells.cell[entry]]
        normals.append(normal @ axes)
        if not len(chosen):
            continue
        along = np.einsum("ij,ij->i", normal, clouds[sensor][chosen])
        counts += np.bincount(entry, minlength=len(counts))
        height += np.bincount(entry, weights=along, minlength=len(counts))
        if sensor == TOF:
            sd = np.full(len(chosen), _TOF_NOISE_MM)
        else:
            picked = samples[sensor].take(chosen)
            sd = laser_gain(scanner, picked, normals[sensor]) * observations.objects[sensor].sd_px[chosen]
        noise += np.bincount(entry, weights=sd**2, minlength=len(counts))
    with np.errstate(invalid="ignore", divide="ignore"):
        height, noise = height / counts, noise / counts**2
    return _patches(cells, tuple(normals), height, noise, counts)


@dataclass(frozen=True, eq=False)
class _Pair:
    """Rows of one pair of sensors, and how they are made of cell entries: ``weight * (plus - minus)`` summed by row."""

    kind: int
    row: IntArray
    plus: IntArray
    minus: IntArray
    weight: FloatArray
    noise: FloatArray
    share: FloatArray
    held_out: BoolArray
    place: FloatArray
    difference: FloatArray


def _patches(
    cells: CellEntries, normals: tuple[FloatArray, ...], height: FloatArray, variance: FloatArray, counts: FloatArray
) -> Association:
    """Rows from cells: for each patch and pair of sensors the weighted mean difference."""
    table = np.full((TOF + 1, cells.cells), -1, np.int64)
    table[cells.sensor, cells.cell] = np.arange(len(cells.cell))
    slope = cells.normal[:, :2] / cells.normal[:, 2:]
    keys = np.concatenate([np.floor(cells.place / _PATCH_MM), np.round(slope / _SLOPE_CLASS)], axis=1).astype(np.int64)
    patch = np.unique(keys, axis=0, return_inverse=True)[1].ravel() if len(keys) else np.empty(0, np.int64)
    pairs = [_pair(cells, table, patch, height, variance, which) for which in _PAIRS]
    starts = np.concatenate([[0], np.cumsum([len(p.noise) for p in pairs])])
    total = int(starts[-1])
    if not total:
        return _no_association()
    row = np.concatenate([p.row + start for p, start in zip(pairs, starts[:-1], strict=True)])
    weight = np.concatenate([p.weight for p in pairs])
    entry = np.concatenate([p.plus for p in pairs] + [p.minus for p in pairs])
    entries = len(cells.cell)
    to_rows = csr_matrix((np.concatenate([weight, -weight]), (np.tile(row, 2), entry)), shape=(total, entries))
    average = []
    for chosen, own in zip(cells.points, cells.entry, strict=True):
        mean = csr_matrix((1.0 / counts[own], (own, np.arange(len(chosen)))), shape=(entries, len(chosen)))
        average.append(csr_matrix(to_rows @ mean))
    single: list[FloatArray] = [np.empty(0)] * len(KINDS)
    for p in pairs:
        single[p.kind] = p.difference
    return Association(
        tuple(average),
        normals,
        cells.points,
        np.concatenate([p.noise for p in pairs]),
        np.concatenate([p.share for p in pairs]),
        np.concatenate([np.full(len(p.noise), p.kind) for p in pairs]),
        np.concatenate([p.held_out for p in pairs]),
        np.concatenate([p.place for p in pairs]),
        tuple(single),
    )


def _pair(
    cells: CellEntries,
    table: IntArray,
    patch: IntArray,
    height: FloatArray,
    variance: FloatArray,
    which: tuple[int, int, int],
) -> _Pair:
    """Mean difference of two sensors per patch; cells far off the others lose their weight."""
    first, second, kind = which
    both = np.flatnonzero((table[first] >= 0) & (table[second] >= 0))
    if not len(both):
        none, index = np.empty(0), np.empty(0, np.int64)
        return _Pair(kind, index, index, index, none, none, none, np.empty(0, bool), np.empty((0, 2)), none)
    a, b = table[first, both], table[second, both]
    difference = height[a] - height[b]
    spread = variance[a] + variance[b]
    middle = float(np.median(difference))
    scale = max(1.4826 * float(np.median(np.abs(difference - middle))), _LEAST_SCALE_MM)
    robust = 1.0 / (1.0 + ((difference - middle) / (_OUTLIER_SCALES * scale)) ** 2) ** 2
    groups, index = np.unique(patch[both], return_inverse=True)
    weight = robust / np.maximum(spread, 1e-6)
    many = _large_enough(np.asarray(np.bincount(index, weights=robust), dtype=np.float64))
    weight = weight / np.bincount(index, weights=weight)[index]

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(index, weights=weight * values)[many], dtype=np.float64)

    sensors = (table >= 0).sum(axis=0)[both]
    bent = mean(cells.curvature[both]) * _SPOT_MM**2
    noise = np.sqrt(np.bincount(index, weights=weight**2 * spread)[many] + bent**2)
    keep = many[index]
    return _Pair(
        kind,
        (np.cumsum(many) - 1)[index][keep],
        a[keep],
        b[keep],
        weight[keep],
        noise,
        # Of three sensors' three differences two are independent.
        mean(2.0 / sensors),
        groups[many] % HOLD_OUT == 2,
        np.stack([mean(cells.place[both, i]) for i in (0, 1)], axis=1),
        difference,
    )


def _large_enough(cells_seen: FloatArray) -> BoolArray:
    """Which patches count, by the number of cells that agree in each."""
    many = np.zeros(len(cells_seen), bool)
    for fewest in _FEWEST_CELLS:
        # A lone cell never quite has the weight 1.
        many = cells_seen >= 0.7 * fewest if fewest == 1 else cells_seen >= fewest
        if many.sum() >= _FEWEST_ROWS:
            break
    return np.asarray(many)


def _no_association() -> Association:
    none = np.empty(0)
    return Association(
        (), (), (), none, none, np.empty(0, np.int64), np.empty(0, bool), np.empty((0, 2)), (none,) * len(KINDS)
    )
