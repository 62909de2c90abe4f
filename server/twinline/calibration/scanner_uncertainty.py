"""How uncertain a calibration leaves the shape of a scan."""

import numpy as np

from twinline.arrays import FloatArray
from twinline.calibration.joint_model import bed_height, laser_jacobian, laser_samples
from twinline.calibration.observations import StripePoints
from twinline.calibration.scanner import ScannerResult

_GRID = 9
_VOLUME_SHARE = 0.1
_USUAL_PASS_MM = 200.0


def shape_sd_mm(result: ScannerResult) -> float:
    """Uncertainty of a scan's shape from the calibration: root mean square over points in the swept volume.

    A rigid motion of the whole scan changes no shape; it is taken out by projection.
    """
    points, jacobian = _volume(result)
    if not len(points):
        return float("nan")
    count = len(points)
    centred = points - points.mean(axis=0)
    rigid = np.zeros((3 * count, 6))
    for i in range(3):
        unit = np.eye(3)[i]
        rigid[i::3, i] = 1.0
        rigid[:, 3 + i] = np.cross(unit, centred).ravel()
    rest = jacobian - rigid @ np.linalg.lstsq(rigid, jacobian, rcond=None)[0]
    return float(np.sqrt(max(np.einsum("ij,jk,ik->", rest, result.covariance, rest), 0.0) / count))


def _volume(result: ScannerResult) -> tuple[FloatArray, FloatArray]:
    """Points over the measuring volume and their derivatives, (n, 3) and (3n, parameters).

    From the bed up to a tenth of the camera's height, over the whole picture and the length of the pass, whether or not
    anything stood there.
    """
    scanner = result.scanner
    width, height = scanner.size
    u, v = np.meshgrid(np.linspace(0, width - 1, _GRID), np.linspace(0, height - 1, 4 * _GRID))
    carts = np.concatenate([s.bed.cart_mm for s in result.seen] or [np.array([0.0, _USUAL_PASS_MM])])
    if not len(carts):
        carts = np.array([0.0, _USUAL_PASS_MM])
    points, rows = [], []
    for k in range(len(scanner.sheets)):
        pixels = np.column_stack([u.ravel(), v.ravel()])
        for cart in (float(carts.min()), float(carts.max())):
            samples = laser_samples(scanner, k, StripePoints(pixels, np.ones(len(pixels)), np.full(len(pixels), cart)))
            up = bed_height(scanner, samples.points - scanner.travel * cart)
            with np.errstate(invalid="ignore"):
                samples = samples.take((up > -1.0) & (up < _VOLUME_SHARE * scanner.height_mm()))
            points.append(samples.points)
            by_axis = [
                laser_jacobian(scanner, samples, np.broadcast_to(np.eye(3)[i], samples.points.shape)) for i in range(3)
            ]
            rows.append(np.stack(by_axis, axis=1).reshape(-1, len(scanner.vector())))
    return np.concatenate(points), np.concatenate(rows)
