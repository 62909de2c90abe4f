"""The thesis's alignments by Nelder-Mead: laser 1 to laser 2 (4.3), and the ToF cloud to both (4.4).

Both compare heights over the same place of the bed. A place that only one cloud saw says nothing, and no gap is filled:
a surface stretched over a shadow would draw the clouds together by half the shadow's length.

The sum of absolute differences goes over the places that have a partner, and these change as a cloud moves. So that no
shift wins by losing places, the sum is the mean over the pairs times the number of pairs at the start, and a shift that
loses half of them counts as impossible.

Where everything within reach of a shift is flat, the difference is the same whatever the shift. The lasers are compared
without such places where there are enough others: on a large bed, tilts and the lens that the two-parameter sheets
leave out add up to far more than what the objects say.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from twinline.arrays import BoolArray, FloatArray
from twinline.calibration.thesis_simplex import NelderMeadTrace, Objective, indifference, nelder_mead
from twinline.calibration.thesis_surface import Surface, cell_means, extent, finite_points
from twinline.errors import CalibrationError

_FEWEST_PAIRS = 20
_FEWEST_TELLING = 100
_LEAST_SHARE = 0.5
_REACH_MM = 5.0
_REACH_DEG = 2.0
_FLAT_MM = 1.5
_DETERMINED_MM = 0.5
_TOLERANCE = 1e-4
_MOST_POINTS = 20_000


@dataclass(frozen=True, eq=False)
class LaserShift:
    """Laser 1's cloud against laser 2's.

    Attributes
    ----------
    shift_mm
        To be added to laser 1's x, along the travel.
    before_mm, after_mm
        Sum of |Z1 - Z2| at shift 0 and at ``shift_mm``, over as many places as had a partner at shift 0.
    places
        How many those were, one per cell of the grid.
    height_mm
        Mean height of the slopes that tell the shift.
    indifferent_mm : (float, float)
        Shifts between which the sum stays within a twentieth of its minimum. Flat tops with sharp shadows allow a
        range of shifts: a shadow moves onto the other cloud without contradicting it.
    trace
        Parameter ``shift_mm``.
    """

    shift_mm: float
    before_mm: float
    after_mm: float
    places: int
    height_mm: float
    indifferent_mm: tuple[float, float]
    trace: NelderMeadTrace

    @property
    def determined(self) -> bool:
        """Whether the clouds themselves fix the shift within half a millimetre to either side."""
        low, high = self.indifferent_mm
        return self.shift_mm - low <= _DETERMINED_MM and high - self.shift_mm <= _DETERMINED_MM


@dataclass(frozen=True, eq=False)
class TofAlignment:
    """The ToF cloud against the lasers' merged cloud.

    Attributes
    ----------
    shift_mm : (3,) array
        To be added to the ToF points, in the bed frame, after the turn.
    yaw_rad
        Turn about the vertical through ``pivot_mm``; 0 where it was not asked for.
    pivot_mm : (2,) array
        x, y of the raster's middle.
    before_mm, after_mm
        Mean of |Z_ToF - Z_laser(x, y)|.
    points
        How many ToF points lie over the lasers' surface at the start.
    indifferent : (p, 2) array
        For each of the trace's parameters the interval within which the mean stays within a twentieth of its minimum.
    trace
        Parameters ``x_mm``, ``y_mm``, ``z_mm`` and perhaps ``yaw_deg``; the value is the mean.
    """

    shift_mm: FloatArray
    yaw_rad: float
    pivot_mm: FloatArray
    before_mm: float
    after_mm: float
    points: int
    indifferent: FloatArray
    trace: NelderMeadTrace

    def apply(self, points_mm: FloatArray) -> FloatArray:
        """Aligned ToF points (n, 3), bed frame."""
        return _moved(np.asarray(points_mm, dtype=np.float64), self.shift_mm, self.yaw_rad, self.pivot_mm)


def align_lasers(
    laser_1_mm: FloatArray, laser_2_mm: FloatArray, *, cell_mm: float = 1.0, start_mm: float = 0.0
) -> LaserShift:
    """Shift of laser 1 along the travel by Nelder-Mead (4.3).

    Minimised is ``sum |Z1(x - s, y) - Z2(x, y)|`` over the places that both clouds hold: the mean point of each cell of
    laser 1's cloud against laser 2's surface, without cells that are flat all around.

    Parameters
    ----------
    laser_1_mm, laser_2_mm : (n, 3) and (m, 3) arrays
        Clouds in the bed frame; NaN rows are ignored.
    cell_mm
        Size of the grid's cells; not below the distance of frames and pixels on the bed.
    start_mm
        First shift tried.

    Raises
    ------
    CalibrationError
        ``no-points``, ``no-overlap`` or ``not-converged``.
    """
    first = finite_points(laser_1_mm, "The cloud of laser 1")
    surface = Surface.of_points(finite_points(laser_2_mm, "The cloud of laser 2"), cell_mm)
    low, shape = extent(first, cell_mm)
    means = cell_means(first, cell_mm, low, shape)
    places = _telling_places(means, surface, start_mm)

    def differences(parameters: FloatArray) -> FloatArray:
        return np.asarray(surface.at(places[:, 0] + parameters[0], places[:, 1]) - places[:, 2])

    origin = np.array([start_mm])
    pairs = _require_pairs(differences(origin), "the clouds of laser 1 and laser 2")
    total = _sum_over_pairs(differences, pairs)
    trace = nelder_mead(total, origin, np.array([1.0]), ("shift_mm",), tolerance=_TOLERANCE)
    best = trace.parameters[-1]
    # A shift is not refuted by losing the places that could refute it.
    ends = indifference(_sum_over_pairs(differences, pairs, least_share=0.0), best, np.array([_REACH_MM]))[0]
    return LaserShift(
        float(best[0]),
        total(np.zeros(1)),
        total(best),
        pairs,
        _height_of_slopes(places, surface, float(best[0])),
        (float(ends[0]), float(ends[1])),
        trace,
    )


def _telling_places(means: FloatArray, surface: Surface, start_mm: float) -> FloatArray:
    """Mean points (n, 3) of the cells around which heights change along x; of all cells where those are too few."""
    heights = means[..., 2]
    found: BoolArray = np.isfinite(heights)
    size = 2 * int(np.ceil(_REACH_MM / surface.cell_mm)) + 1
    highest = maximum_filter1d(np.where(found, heights, -np.inf), size, axis=0, mode="nearest")
    lowest = minimum_filter1d(np.where(found, heights, np.inf), size, axis=0, mode="nearest")
    with np.errstate(invalid="ignore"):
        telling = means[found & (highest - lowest > _FLAT_MM)]
    pairs = np.isfinite(surface.at(telling[:, 0] + start_mm, telling[:, 1])).sum()
    return np.asarray(telling if pairs >= _FEWEST_TELLING else means[found])


def _height_of_slopes(places: FloatArray, surface: Surface, shift_mm: float) -> float:
    x, y = places[:, 0] + shift_mm, places[:, 1]
    ahead, behind = surface.at(x + surface.cell_mm, y), surface.at(x - surface.cell_mm, y)
    rise = np.abs(ahead - behind)
    known = np.isfinite(rise)
    total = float(rise[known].sum())
    # Where a step ends is seen at its upper edge.
    return float(rise[known] @ np.maximum(ahead, behind)[known]) / total if total > 0 else 0.0


def align_tof(
    tof_mm: FloatArray, laser_mm: FloatArray, *, cell_mm: float = 1.0, with_yaw: bool = False
) -> TofAlignment:
    """Alignment of the ToF cloud to the lasers' merged cloud by Nelder-Mead (4.4).

    Minimised is the mean of ``|Z_ToF - Z_laser(x, y)|`` over shifts along x, y and z, and with ``with_yaw`` over a turn
    about the vertical. Of a very long raster an even choice of points is compared.

    Parameters
    ----------
    tof_mm, laser_mm : (n, 3) and (m, 3) arrays
        Clouds in the bed frame; NaN rows are ignored.

    Raises
    ------
    CalibrationError
        ``no-points``, ``no-overlap`` or ``not-converged``.
    """
    points = finite_points(tof_mm, "The ToF raster")
    points = points[:: max(1, len(points) // _MOST_POINTS)]
    surface = Surface.of_points(finite_points(laser_mm, "The lasers' cloud"), cell_mm)
    pivot = 0.5 * (points[:, :2].min(axis=0) + points[:, :2].max(axis=0))

    def differences(parameters: FloatArray) -> FloatArray:
        yaw = float(np.radians(parameters[3])) if with_yaw else 0.0
        moved = _moved(points, parameters[:3], yaw, pivot)
        return np.asarray(moved[:, 2] - surface.at(moved[:, 0], moved[:, 1]))

    names: tuple[str, ...] = ("x_mm", "y_mm", "z_mm")
    steps, reach = [1.0, 1.0, 0.5], [_REACH_MM] * 3
    if with_yaw:
        names, steps, reach = (*names, "yaw_deg"), [*steps, 0.5], [*reach, _REACH_DEG]
    origin = np.zeros(len(names))
    pairs = _require_pairs(differences(origin), "the ToF raster and the laser pass")
    total = _sum_over_pairs(differences, pairs)

    def mean(parameters: FloatArray) -> float:
        return total(parameters) / pairs

    trace = nelder_mead(mean, origin, np.array(steps), names, tolerance=_TOLERANCE)
    best = trace.parameters[-1]
    return TofAlignment(
        best[:3].copy(),
        float(np.radians(best[3])) if with_yaw else 0.0,
        pivot,
        mean(origin),
        mean(best),
        pairs,
        indifference(mean, best, np.array(reach)),
        trace,
    )


def _moved(points: FloatArray, shift_mm: FloatArray, yaw_rad: float, pivot_mm: FloatArray) -> FloatArray:
    cos, sin = float(np.cos(yaw_rad)), float(np.sin(yaw_rad))
    x, y = points[:, 0] - pivot_mm[0], points[:, 1] - pivot_mm[1]
    turned = np.column_stack([pivot_mm[0] + cos * x - sin * y, pivot_mm[1] + sin * x + cos * y, points[:, 2]])
    return np.asarray(turned + shift_mm)


def _require_pairs(differences: FloatArray, what: str) -> int:
    pairs = int(np.isfinite(differences).sum())
    if pairs < _FEWEST_PAIRS:
        raise CalibrationError(
            f"Only {pairs} places are in both {what}, and {_FEWEST_PAIRS} are needed: scan the same objects in both "
            "with one cart origin, or calibrate the sheets first.",
            code="no-overlap",
        )
    return pairs


def _sum_over_pairs(
    differences: Callable[[FloatArray], FloatArray], pairs: int, least_share: float = _LEAST_SHARE
) -> Objective:
    def total(parameters: FloatArray) -> float:
        values = differences(parameters)
        values = values[np.isfinite(values)]
        if len(values) < least_share * pairs:
            return float("inf")
        return float(np.abs(values).mean()) * pairs if len(values) else 0.0

    return total
