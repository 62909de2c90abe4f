"""First laser sheets in closed form: the model is linear in inverse depth, ``1/Z = a x + b y + c``."""

import numpy as np

from twinline.arrays import FloatArray
from twinline.errors import CalibrationError
from twinline.geometry.sheet import LaserSheet, Side

_ROUNDS = 12
_GROSS_SCALES = 6.0
_FLATTEST = 1e-3


def sheet_from_points(rays: FloatArray, inverse_depth: FloatArray, side: Side) -> LaserSheet:
    """Sheet through points of known depth: linear least squares over all of them but gross errors.

    A robust fit tells which those are; it would itself lean to whichever part of the points is the densest.

    Parameters
    ----------
    rays : (n, 3) array
        Rays of the stripe's pixels, scaled to z = 1.
    inverse_depth : (n,) array
        1/Z of the surface that each ray meets, per millimetre.

    Raises
    ------
    CalibrationError
        ``sheet-unobservable`` if the points lie on a line, so that the sheet could turn about it.
    """
    usable = np.isfinite(rays).all(axis=1) & np.isfinite(inverse_depth)
    rays, inverse_depth = rays[usable], inverse_depth[usable]
    points = rays / inverse_depth[:, None]
    if len(points) < 3 or _second_extent(points) < _FLATTEST:
        raise CalibrationError(
            "The stripe lies on one line of all surfaces of known depth, so the sheet could turn about it: show it at "
            "two heights at least, better on boards in several poses.",
            code="sheet-unobservable",
        )
    weights = np.ones(len(rays))
    m: FloatArray = np.zeros(3)
    scale = np.inf
    for _ in range(_ROUNDS):
        m = np.linalg.lstsq(rays * weights[:, None], inverse_depth * weights, rcond=None)[0]
        error = rays @ m - inverse_depth
        scale = max(1.4826 * float(np.median(np.abs(error))), 1e-12)
        weights = 1.0 / (1.0 + (error / (3.0 * scale)) ** 2)
    kept = np.abs(rays @ m - inverse_depth) <= _GROSS_SCALES * scale
    return _sheet(np.linalg.lstsq(rays[kept], inverse_depth[kept], rcond=None)[0], side)


def _second_extent(points: FloatArray) -> float:
    """How wide the points spread across their main direction, as a share of their extent along it."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return float(spread[1] / spread[0]) if spread[0] > 0 else 0.0


def sheet_from_bed_line(rays: FloatArray, bed: FloatArray, baseline_mm: float, side: Side) -> LaserSheet:
    """Sheet through the stripe on the bed and through the laser's nominal place beside the camera.

    The rays on the bed span a line ``l . r = 0`` of the image. All sheets ``bed + s l`` meet the bed in it; the laser's
    place chooses one of them.

    Parameters
    ----------
    rays : (n, 3) array
        Rays of the stripe on the bare bed.
    bed : (3,) array
        The bed plane in the camera frame, ``bed . p = 1``.
    baseline_mm
        Nominal distance from the camera to the laser, in the plane parallel to the bed, towards ``side``.
    """
    rays = rays[np.isfinite(rays).all(axis=1)]
    line = _line_of(rays)
    towards = np.zeros(3)
    towards[0 if side[1] == "u" else 1] = 1.0 if side[0] == "+" else -1.0
    normal = bed / np.linalg.norm(bed)
    towards = towards - normal * (normal @ towards)
    laser = baseline_mm * towards / np.linalg.norm(towards)
    share = (1.0 - bed @ laser) / (line @ laser)
    return _sheet(bed + share * line, side)


def _line_of(rays: FloatArray) -> FloatArray:
    weights = np.ones(len(rays))
    line = np.zeros(3)
    for _ in range(_ROUNDS):
        line = np.linalg.svd(rays * weights[:, None], full_matrices=False)[2][-1]
        error = rays @ line / np.hypot(line[0], line[1])
        scale = max(1.4826 * float(np.median(np.abs(error))), 1e-9)
        weights = 1.0 / (1.0 + (error / (3.0 * scale)) ** 2)
    return np.asarray(line)


def _sheet(m: FloatArray, side: Side) -> LaserSheet:
    length = float(np.linalg.norm(m))
    return LaserSheet(m / length, 1.0 / length, side)
