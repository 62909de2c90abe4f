"""What a joint adjustment takes in and works on."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix

from twinline.arrays import BoolArray, FloatArray, IntArray
from twinline.calibration.joint_model import TofPoints
from twinline.calibration.observations import StripePoints

TOF = 2
KINDS = (
    "laser 1 on the bed",
    "laser 2 on the bed",
    "ToF on the bed",
    "laser 1 against laser 2",
    "laser 1 against ToF",
    "laser 2 against ToF",
    "laser 1 on a board",
    "laser 2 on a board",
    "laser 1 on a block",
    "laser 2 on a block",
)
HOLD_OUT = 5


@dataclass(frozen=True, eq=False)
class KnownPoints:
    """Stripes of one laser on surfaces of known place.

    Attributes
    ----------
    normal, offset : (n, 3) and (n,) arrays
        Each point lies on the plane ``normal . p = offset`` in the camera's frame (boards), or is ``offset`` above the
        bed where ``normal`` is NaN (blocks).
    group : (n,) int array
        Points with a group in common are one observation.
    """

    laser: int
    stripes: StripePoints
    normal: FloatArray
    offset: FloatArray
    group: IntArray


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known beforehand of some parameters: ``values`` with an information matrix.

    ``shift`` (k, m) makes it conditional: the expected values move by ``shift @ (theta[on] - at)``.
    """

    index: IntArray
    values: FloatArray
    information: FloatArray
    on: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    at: FloatArray = field(default_factory=lambda: np.empty(0))
    shift: FloatArray | None = None

    def rows(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals (k,) and their derivatives (k, parameters), whitened."""
        root = self._root
        design = np.zeros((len(self.index), len(theta)))
        design[np.arange(len(self.index)), self.index] = 1.0
        error = theta[self.index] - self.values
        if self.shift is not None:
            error = error - self.shift @ (theta[self.on] - self.at)
            design[:, self.on] -= self.shift
        return root @ error, root @ design

    @cached_property
    def _root(self) -> FloatArray:
        return np.asarray(np.linalg.cholesky(self.information).T)


@dataclass(frozen=True, eq=False)
class Observations:
    """Everything that was measured of the surface.

    Attributes
    ----------
    bed : one StripePoints per laser
        Stripes on the bare bed, already averaged in groups; empty where there are none.
    objects : one StripePoints per laser
        Stripes on everything else.
    tof_bed, tof_objects
        The same of the ToF sensor; None without one.
    known
        Stripes on boards and blocks.
    """

    bed: tuple[StripePoints, ...]
    objects: tuple[StripePoints, ...]
    tof_bed: TofPoints | None = None
    tof_objects: TofPoints | None = None
    known: tuple[KnownPoints, ...] = ()


@dataclass(frozen=True, eq=False)
class Rows:
    """Grouped observations at one scanner.

    Attributes
    ----------
    residual : (r,) array
        Millimetres along the surface's normal.
    noise : (r,) array
        Standard deviation that the noise of the single measurements gives.
    share : (r,) array
        How much of an independent observation it is: sensors that see the same patch are compared pair by pair.
    kind : (r,) int array
        Index into `KINDS`.
    held_out : (r,) bool array
        Belongs to the fifth that may be left out to test the others.
    place : (r, 2) array
        On the bed, mm.
    jacobian : (r, parameters) array or None
    """

    residual: FloatArray
    noise: FloatArray
    share: FloatArray
    kind: IntArray
    held_out: BoolArray
    place: FloatArray
    jacobian: FloatArray | None


@dataclass(frozen=True, eq=False)
class Association:
    """Which points are compared with which; fixed while a few steps are taken.

    Attributes
    ----------
    average : per sensor a sparse (rows, points) matrix
        Residuals of the rows are the sum over sensors of ``average @ (normal . point)``.
    normals : per sensor (points, 3), in the camera's frame
    points : per sensor indices into the observations
    """

    average: tuple[csr_matrix, ...]
    normals: tuple[FloatArray, ...]
    points: tuple[IntArray, ...]
    noise: FloatArray
    share: FloatArray
    kind: IntArray
    held_out: BoolArray
    place: FloatArray
    cells: tuple[FloatArray, ...]
