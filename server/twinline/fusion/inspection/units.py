"""The unit of a mesh that does not say it, from its size beside the scan's."""

from dataclasses import dataclass

import numpy as np

from twinline.arrays import FloatArray
from twinline.errors import InputError

UNITS_MM = {"mm": 1.0, "inch": 25.4, "m": 1000.0}
# A part of an object, or an object on a part of the bed, may be seen; more than this is another object.
_LIKELY = 3.0


@dataclass(frozen=True)
class UnitGuess:
    """The unit that a mesh most likely has.

    Attributes
    ----------
    unit
        ``mm``, ``inch`` or ``m``.
    factor
        Millimetres of one unit.
    ratio
        Size of the scan in mm over that of the mesh in its own numbers.
    likely
        Whether the sizes agree within a factor of three in that unit.
    """

    unit: str
    factor: float
    ratio: float
    likely: bool


def guess_unit(points_mm: FloatArray, vertices: FloatArray) -> UnitGuess:
    """Compare the diagonals of a scan and of a mesh.

    Parameters
    ----------
    points_mm : (n, 3) array
        The scan of the object, without the bed; all finite.
    vertices : (m, 3) array
        The mesh in its own unit; all finite.

    Raises
    ------
    InputError
        ``bad-mesh`` if the mesh has no size.
    """
    scan = float(np.linalg.norm(np.ptp(np.percentile(points_mm, (0.5, 99.5), axis=0), axis=0)))
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    if not size > 0.0 or not scan > 0.0:
        raise InputError("The scan or the reference mesh has no size; give those of the same object.", code="bad-mesh")
    ratio = scan / size
    unit, factor = min(UNITS_MM.items(), key=lambda one: abs(np.log(ratio / one[1])))
    return UnitGuess(unit, factor, ratio, bool(1 / _LIKELY < ratio / factor < _LIKELY))
