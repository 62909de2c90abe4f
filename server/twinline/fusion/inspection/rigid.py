"""A rigid motion with what is known of it."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from twinline.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class RigidMotion:
    """Turns and shifts points: ``rotation @ p + translation_mm``.

    Attributes
    ----------
    rotation : (3, 3) array
    translation_mm : (3,) array
    """

    rotation: FloatArray
    translation_mm: FloatArray

    @classmethod
    def none(cls) -> "RigidMotion":
        """The motion that leaves everything where it is."""
        return cls(np.eye(3), np.zeros(3))

    def apply(self, points_mm: FloatArray) -> FloatArray:
        """The moved points, (n, 3)."""
        return np.asarray(points_mm, dtype=np.float64) @ self.rotation.T + self.translation_mm

    def after(self, earlier: "RigidMotion") -> "RigidMotion":
        """An earlier motion, and then this one."""
        return RigidMotion(
            self.rotation @ earlier.rotation, self.rotation @ earlier.translation_mm + self.translation_mm
        )

    def about(self, centre_mm: FloatArray) -> "RigidMotion":
        """The motion that does about a centre what this one does about the origin."""
        return RigidMotion(self.rotation, self.translation_mm + centre_mm - self.rotation @ centre_mm)

    @property
    def angle_deg(self) -> float:
        """By how much it turns."""
        return float(np.degrees(Rotation.from_matrix(self.rotation).magnitude()))


def small_motion(turn_rad: FloatArray, shift_mm: FloatArray) -> RigidMotion:
    """The motion of a rotation vector and a shift."""
    return RigidMotion(np.asarray(Rotation.from_rotvec(turn_rad).as_matrix()), np.asarray(shift_mm, dtype=np.float64))
