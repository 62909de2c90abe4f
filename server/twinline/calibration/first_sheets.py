"""First sheets of all lasers of a scanner, in closed form, from whatever shows where their stripes lie."""

from collections.abc import Sequence

import numpy as np

from twinline.arrays import FloatArray
from twinline.calibration.joint_model import Scanner
from twinline.calibration.joint_types import KnownPoints
from twinline.calibration.observations import StripePoints
from twinline.calibration.sheets import sheet_from_bed_line, sheet_from_points
from twinline.errors import CalibrationError


def first_sheets(
    scanner: Scanner,
    baselines_mm: Sequence[float],
    bed: Sequence[StripePoints],
    known: Sequence[KnownPoints],
    notes: list[str],
) -> FloatArray:
    """Sheets through points of known place where there are such, else through the line on the bed.

    Parameters
    ----------
    scanner
        Its camera and bed are taken as they are; sheets of which nothing is seen are kept.
    baselines_mm, bed
        For each laser its nominal distance from the camera, and its stripes on the bare bed (empty, or none at all).
    notes
        Receives what could not be used.

    Returns
    -------
    (lasers, 3) array
        Inverse-depth parameters.
    """
    camera = scanner.as_camera()
    sheets = scanner.sheets.copy()
    for k, side in enumerate(scanner.sides):
        rays, inverse = _known_depths(scanner, known, k)
        groups = bed[k] if k < len(bed) else StripePoints.join([])
        bed_rays = camera.rays(groups.pixels)
        if len(rays):
            # The bed is a surface of known place too.
            rays = np.concatenate([rays, bed_rays])
            inverse = np.concatenate([inverse, bed_rays @ scanner.bed])
            try:
                sheets[k] = sheet_from_points(rays, inverse, side).inverse_depth
                continue
            except CalibrationError:
                notes.append(f"The surfaces of known height do not fix the sheet of laser {k + 1} alone.")
        if len(groups) >= 2:
            sheets[k] = sheet_from_bed_line(bed_rays, scanner.bed, baselines_mm[k], side).inverse_depth
        else:
            notes.append(f"The stripe of laser {k + 1} is not seen on the bare bed.")
    return sheets


def _known_depths(scanner: Scanner, known: Sequence[KnownPoints], laser: int) -> tuple[FloatArray, FloatArray]:
    """Rays on surfaces of known place, and 1/Z there."""
    camera = scanner.as_camera()
    rays: list[FloatArray] = [np.empty((0, 3))]
    inverse: list[FloatArray] = [np.empty(0)]
    for points in known:
        if points.laser != laser:
            continue
        ray = camera.rays(points.stripes.pixels)
        block = np.isnan(points.normal[:, :1])
        size = float(np.linalg.norm(scanner.bed))
        plane = np.where(
            block,
            scanner.bed / (1.0 - size * np.where(block[:, 0], points.offset, 0.0))[:, None],
            points.normal / points.offset[:, None],
        )
        rays.append(ray)
        inverse.append(np.einsum("ij,ij->i", ray, plane))
    return np.concatenate(rays), np.concatenate(inverse)
