"""The laser sheet: a plane of light in the camera frame."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from twinline.arrays import FloatArray
from twinline.errors import RigError

Side = Literal["+u", "-u", "+v", "-v"]
"""The side of the image to which a rising surface moves a laser's stripe."""

SIDES: tuple[Side, ...] = ("+u", "-u", "+v", "-v")


def _direction(side: Side) -> FloatArray:
    sign = 1.0 if side[0] == "+" else -1.0
    return sign * (np.array([1.0, 0.0, 0.0]) if side[1] == "u" else np.array([0.0, 1.0, 0.0]))


@dataclass(frozen=True, eq=False)
class LaserSheet:
    """A laser's plane ``normal . p = offset_mm`` in the camera frame.

    Attributes
    ----------
    normal : (3,) array
        Unit normal; its sign is chosen so that ``offset_mm`` is positive (the camera is on the negative side).
    offset_mm
        Distance of the plane from the camera centre.
    side
        The side of the image to which a rising surface moves this laser's stripe.
    """

    normal: FloatArray
    offset_mm: float
    side: Side

    def __post_init__(self) -> None:
        normal = np.array(self.normal, dtype=np.float64).ravel()
        length = float(np.linalg.norm(normal)) if normal.shape == (3,) else float("nan")
        if not (np.isfinite(length) and length > 0 and np.isfinite(self.offset_mm) and self.offset_mm != 0):
            raise RigError("A laser sheet needs a normal of three finite numbers and an offset that is not zero.")
        if self.side not in SIDES:
            raise RigError(f"A laser's side must be one of {', '.join(SIDES)}, not {self.side!r}.")
        sign = 1.0 if self.offset_mm > 0 else -1.0
        # A normal that is already of unit length keeps its bits, so that writing and reading a rig changes nothing.
        length = 1.0 if abs(length - 1.0) < 1e-14 else length
        normal = sign * normal / length
        normal.setflags(write=False)
        object.__setattr__(self, "normal", normal)
        object.__setattr__(self, "offset_mm", sign * float(self.offset_mm) / length)

    @classmethod
    def from_baseline_angle(cls, baseline_mm: float, angle_rad: float, side: Side) -> "LaserSheet":
        """Sheet of the two-parameter model: it holds the stripe's image axis and the camera looks exactly down.

        With ``y`` along the baseline towards the laser, ``z cot(angle) + y = baseline``.

        Parameters
        ----------
        baseline_mm
            Distance d from the camera centre to the laser, along the travel.
        angle_rad
            Angle theta between the sheet and the baseline.
        side
            The side of the image on which the laser stands.
        """
        if not (baseline_mm > 0 and 0 < angle_rad < np.pi):
            raise RigError("A laser's baseline must be positive and its angle between 0 and 180 degrees.")
        normal = np.sin(angle_rad) * _direction(side) + np.array([0.0, 0.0, np.cos(angle_rad)])
        return cls(normal, baseline_mm * float(np.sin(angle_rad)), side)

    @property
    def angle_rad(self) -> float:
        """Theta of the two-parameter view: angle to the baseline in the travel plane."""
        return float(np.arctan2(self.normal @ _direction(self.side), self.normal[2]))

    @property
    def baseline_mm(self) -> float:
        """Length d of the two-parameter view: where the sheet meets the baseline in the travel plane.

        Infinite if it never does; negative if the sheet contradicts its side.
        """
        slope = float(self.normal @ _direction(self.side))
        return self.offset_mm / slope if slope != 0.0 else float("inf")

    @property
    def inverse_depth(self) -> FloatArray:
        """Coefficients a, b, c of 1/Z = a x + b y + c on the ray (x, y, 1), per millimetre."""
        return self.normal / self.offset_mm

    def signed_distance_mm(self, points_in_camera: FloatArray) -> FloatArray:
        """Distance of points, (n, 3) in the camera frame, to the sheet; positive beyond it."""
        return np.asarray(np.asarray(points_in_camera) @ self.normal - self.offset_mm)
