"""Tilt of a board from its shape in the picture alone."""

import cv2
import numpy as np

from twinline.arrays import FloatArray


def tilt_from_homography_deg(board_mm: FloatArray, pixels: FloatArray) -> float:
    """Angle between the normal of a flat board and the line of sight to its middle.

    Near its middle a picture of the board is an affine map of it, which shortens lengths along the direction of the
    tilt by its cosine; the ratio of the map's singular values is that cosine. No focal length is needed.

    Parameters
    ----------
    board_mm : (n, 3) array
        Points in the board's frame, z = 0.
    pixels : (n, 2) array
        Their image points.

    Returns
    -------
    float
        Degrees; NaN where the points do not determine it.
    """
    if len(pixels) < 4:
        return float("nan")
    homography, _ = cv2.findHomography(board_mm[:, :2], pixels)
    if homography is None or not np.isfinite(homography).all():
        return float("nan")
    middle = np.append(board_mm[:, :2].mean(axis=0), 1.0)
    u, v, w = homography @ middle
    if abs(w) < 1e-12:
        return float("nan")
    jacobian = (homography[:2, :2] - np.outer([u / w, v / w], homography[2, :2])) / w
    values = np.linalg.svd(jacobian, compute_uv=False)
    return float(np.degrees(np.arccos(np.clip(values[1] / values[0], 0.0, 1.0))))
