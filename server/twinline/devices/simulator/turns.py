"""Rotations by hand, so that the simulator needs no geometry of the package."""

import numpy as np

from twinline.arrays import FloatArray


def turn_deg(axis: FloatArray, angle_deg: float) -> FloatArray:
    """(3, 3) rotation about a unit axis, right-handed (O. Rodrigues' formula)."""
    angle = np.radians(angle_deg)
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)
