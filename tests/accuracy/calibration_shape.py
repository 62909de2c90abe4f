"""How far a calibrated scanner bends what it sees, against the true one: the same stripes, triangulated with both."""

import numpy as np

from twinline.arrays import FloatArray
from twinline.calibration.scanner import ScannerResult
from twinline.geometry.rig import Rig
from twinline.geometry.triangulation import pack_laser, stripe_points_packed

_SAMPLED = 1500
_GRID = 12
_HEIGHT_MM = 50.0
_LENGTH_MM = 100.0


def shape_error_mm(result: ScannerResult, calibrated: Rig, true: Rig) -> float:
    """Root mean square distance of the points of both rigs, after the best rigid motion without scale.

    Over the stripes on the bed in the whole width of the picture, and as many on objects.
    """
    here: list[FloatArray] = []
    there: list[FloatArray] = []
    for laser, seen in enumerate(result.seen):
        for stripes in (seen.bed, seen.objects):
            rows = np.unique(np.linspace(0, len(stripes) - 1, min(_SAMPLED, len(stripes))).astype(int))
            part = stripes.take(rows)
            here.append(_points(calibrated, laser, part.pixels, part.cart_mm))
            there.append(_points(true, laser, part.pixels, part.cart_mm))
    return _after_rigid_motion(np.concatenate(here), np.concatenate(there))


def volume_error_mm(calibrated: Rig, true: Rig) -> float:
    """The same over a volume: every pixel in which the true rig sees a laser between the bed and a height.

    Over 100 mm of travel, whether or not anything stood there.
    """
    here: list[FloatArray] = []
    there: list[FloatArray] = []
    width, height = true.camera.size
    u, v = np.meshgrid(np.linspace(0, width - 1, _GRID), np.linspace(0, height - 1, 4 * _GRID))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    for laser in range(len(true.sheets)):
        for cart in (0.0, _LENGTH_MM):
            carts = np.full(len(pixels), cart)
            expected = _points(true, laser, pixels, carts)
            with np.errstate(invalid="ignore"):
                inside = (expected[:, 2] > 0.0) & (expected[:, 2] < _HEIGHT_MM)
            there.append(expected[inside])
            here.append(_points(calibrated, laser, pixels[inside], carts[inside]))
    return _after_rigid_motion(np.concatenate(here), np.concatenate(there))


def _after_rigid_motion(a: FloatArray, b: FloatArray) -> float:
    known = np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
    a, b = a[known] - a[known].mean(axis=0), b[known] - b[known].mean(axis=0)
    # B. K. P. Horn, "Closed-form solution of absolute orientation", in the form of a singular value decomposition.
    u, _, v = np.linalg.svd(a.T @ b)
    turn = (u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v).T
    return float(np.sqrt(((a @ turn.T - b) ** 2).sum(axis=1).mean()))


def _points(rig: Rig, laser: int, pixels: FloatArray, cart_mm: FloatArray) -> FloatArray:
    packed = pack_laser(rig, laser)
    points, _ = stripe_points_packed(packed, np.ascontiguousarray(pixels), np.zeros(len(pixels)), 0.0)
    return np.asarray(points + rig.travel * cart_mm[:, None])
