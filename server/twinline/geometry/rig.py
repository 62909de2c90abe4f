"""The rig: everything about a scanner that calibration finds out, and nothing else."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from twinline.arrays import FloatArray
from twinline.errors import RigError
from twinline.geometry.camera import Camera
from twinline.geometry.noise import NoiseModel
from twinline.geometry.sheet import LaserSheet

StripeRuns = Literal["along-u", "along-v"]
"""Whether a stripe crosses every image column once ("along-u") or every row ("along-v")."""


@dataclass(frozen=True, eq=False)
class Transform:
    """A rigid motion ``p_to = rotation @ p_from + translation_mm``; named ``to_from_from``, as ``bed_from_camera``."""

    rotation: FloatArray
    translation_mm: FloatArray

    def __post_init__(self) -> None:
        rotation = np.array(self.rotation, dtype=np.float64)
        translation = np.array(self.translation_mm, dtype=np.float64).ravel()
        if rotation.shape != (3, 3) or translation.shape != (3,) or not np.isfinite(translation).all():
            raise RigError("A pose needs a 3 x 3 rotation and a translation of three finite numbers.")
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0:
            raise RigError("A pose's rotation must be orthonormal with determinant +1.")
        for name, value in (("rotation", rotation), ("translation_mm", translation)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    def apply(self, points: FloatArray) -> FloatArray:
        """Move points, (n, 3) in millimetres."""
        return np.asarray(np.asarray(points) @ self.rotation.T + self.translation_mm)

    def inverse(self) -> "Transform":
        """The motion back."""
        return Transform(self.rotation.T, -self.rotation.T @ self.translation_mm)


@dataclass(frozen=True, eq=False)
class TofMount:
    """Where the ToF sensor sits and how its reading becomes a distance.

    The measured point in the bed frame is ``position_mm + travel * cart + slide * slide_mm + beam * distance``
    with ``distance = offset_mm + gain_mm_per_unit * reading``.

    Attributes
    ----------
    position_mm : (3,) array
        Sensor at cart and slide position 0, in the bed frame.
    beam : (3,) array
        Unit direction of the beam in the bed frame, about (0, 0, -1).
    slide : (3,) array
        Bed millimetres per commanded slide millimetre, about (0, 1, 0).
    gain_mm_per_unit, offset_mm
        Distance from a reading in the recording's own unit (ADC counts, volts or millimetres).
    range_mm : (float, float)
        Shortest and longest valid distance.
    lag_s
        Time constant of the sensor's first-order lag.
    """

    position_mm: FloatArray
    beam: FloatArray
    slide: FloatArray
    gain_mm_per_unit: float
    offset_mm: float
    range_mm: tuple[float, float]
    lag_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("position_mm", "beam", "slide"):
            value = np.array(getattr(self, name), dtype=np.float64).ravel()
            if value.shape != (3,) or not np.isfinite(value).all():
                raise RigError(f"The ToF sensor's {name} must be three finite numbers.")
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if abs(float(np.linalg.norm(self.beam)) - 1.0) > 1e-6:
            raise RigError("The ToF sensor's beam must be a direction of length 1.")
        if not (np.isfinite([self.gain_mm_per_unit, self.offset_mm]).all() and self.gain_mm_per_unit != 0):
            raise RigError("The ToF sensor's gain and offset must be finite numbers and the gain not zero.")
        if not (len(self.range_mm) == 2 and -np.inf < self.range_mm[0] < self.range_mm[1] < np.inf):
            raise RigError("The ToF sensor's range must be its shortest and its longest distance, in this order.")
        if not (np.isfinite(self.lag_s) and self.lag_s >= 0):
            raise RigError("The ToF sensor's lag must be zero or a positive number of seconds.")


@dataclass(frozen=True)
class Drives:
    """Calibrated steps per millimetre of the two motors; commanded positions are computed from them."""

    cart_steps_per_mm: float = 1.0 / 0.10053096491487339
    slide_steps_per_mm: float = 200.0

    def __post_init__(self) -> None:
        if not (0 < self.cart_steps_per_mm < np.inf and 0 < self.slide_steps_per_mm < np.inf):
            raise RigError("The drives' steps per millimetre must be positive finite numbers.")


@dataclass(frozen=True, eq=False)
class Covariance:
    """Joint covariance of named rig parameters; absent names are taken as exactly known.

    Names, each in the unit of the parameter:

    - ``camera.fx fy cx cy k1 k2 p1 p2 k3``
    - ``sheet1.a b c`` and ``sheet2...``: inverse depth 1/Z = a x + b y + c, per millimetre
    - ``bed.rx ry rz``: a small rotation in radians about the axes of the bed frame, after ``bed_from_camera``'s
      rotation and before its translation; ``bed.x y z``: that translation
    - ``travel.x y z``
    - ``tof....``: whatever the ToF calibration estimates
    """

    names: tuple[str, ...]
    matrix: FloatArray

    def __post_init__(self) -> None:
        matrix = np.array(self.matrix, dtype=np.float64)
        n = len(self.names)
        object.__setattr__(self, "names", tuple(self.names))
        if matrix.shape != (n, n) or len(set(self.names)) != n:
            raise RigError(f"A covariance of {n} names needs {n} x {n} numbers and no name twice.")
        if not np.isfinite(matrix).all() or not _symmetric(matrix):
            raise RigError("A covariance must be finite, symmetric and without negative variances.")
        matrix.setflags(write=False)
        object.__setattr__(self, "matrix", matrix)

    def sd(self, name: str) -> float:
        """Standard deviation of one parameter; 0 if it is not part of this covariance."""
        if name not in self.names:
            return 0.0
        i = self.names.index(name)
        return float(np.sqrt(self.matrix[i, i]))


def _symmetric(matrix: FloatArray) -> bool:
    # Parameters differ by many orders of magnitude: compare in units of their standard deviations.
    variances = np.diagonal(matrix)
    scale = np.sqrt(np.outer(variances, variances)) if (variances >= 0).all() else np.full(matrix.shape, -1.0)
    return bool((np.abs(matrix - matrix.T) <= 1e-6 * scale).all())


@dataclass(frozen=True, eq=False)
class Rig:
    """A calibrated scanner.

    A point that the camera sees at ``p_in_camera`` while the cart stands at the commanded position ``cart_mm`` lies at
    ``bed_from_camera.apply(p_in_camera) + travel * cart_mm`` in the bed frame (x along the travel, y across, z up,
    z = 0 on the bed).

    Attributes
    ----------
    travel : (3,) array
        Bed millimetres per commanded millimetre of the cart: direction and scale.
    noise
        Noise of the stripe's pixels, measured on this rig; None where it has not been.
    sources
        Where each part came from: "nominal", "given", "calibrated ...".
    evidence
        What the calibration recorded about itself; any JSON value, kept as it is and not interpreted.
    """

    name: str
    camera: Camera
    stripe_runs: StripeRuns
    sheets: tuple[LaserSheet, ...]
    bed_from_camera: Transform
    travel: FloatArray
    tof: TofMount | None = None
    noise: NoiseModel | None = None
    drives: Drives = field(default_factory=Drives)
    covariance: Covariance | None = None
    sources: Mapping[str, str] = field(default_factory=dict)
    evidence: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        travel = np.array(self.travel, dtype=np.float64).ravel()
        if travel.shape != (3,) or not np.isfinite(travel).all() or np.linalg.norm(travel) < 1e-6:
            raise RigError("The rig's travel must be three finite numbers that are not all zero.")
        if self.stripe_runs not in ("along-u", "along-v"):
            raise RigError(f'stripe_runs must be "along-u" or "along-v", not {self.stripe_runs!r}.')
        if not 1 <= len(self.sheets) <= 2:
            raise RigError(f"A rig has one or two lasers, not {len(self.sheets)}.")
        across = "v" if self.stripe_runs == "along-u" else "u"
        for number, sheet in enumerate(self.sheets, 1):
            if sheet.side[1] != across:
                raise RigError(
                    f"Laser {number} has side {sheet.side!r}, but stripes that run {self.stripe_runs} "
                    f"move along {across}: use +{across} or -{across}."
                )
        if len({s.side for s in self.sheets}) != len(self.sheets):
            raise RigError("Two lasers on the same side of the image cannot be told apart: give them opposite sides.")
        travel.setflags(write=False)
        object.__setattr__(self, "travel", travel)
        object.__setattr__(self, "sheets", tuple(self.sheets))
