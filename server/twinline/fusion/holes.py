"""Why there is no point: the cause of every hole, worked out from where lasers and camera stood.

For each cell without a point, and each laser, the position of the cart at which the laser's sheet meets the cell is
known in closed form. There the light's way from the laser and the camera's view are followed over the height map: the
first surface in the way is the cause. What is lit and seen and gave nothing was too bright or too dark, or the spot
straddled an edge.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numba import njit
from scipy.ndimage import maximum_filter, minimum_filter

from twinline.arrays import BoolArray, ByteArray, FloatArray
from twinline.fusion.cloud import PointCloud
from twinline.fusion.height_map import HeightMap, grown, height_map
from twinline.geometry.rig import Rig

SATURATED_DN = 250.0
_CLEAR_MM = 0.3
_NEAR_EDGE_MM = 1.5
_EDGE_MM = 1.0
_AROUND_CELLS = 5


class Cause(IntEnum):
    """Why a cell has no point."""

    MEASURED = 0
    LASER_1_SHADOW = 1
    LASER_2_SHADOW = 2
    CAMERA_SHADOW = 3
    SATURATED = 4
    TOO_DARK = 5
    OUT_OF_RANGE = 6
    """The camera sees this height only outside its picture."""
    NOT_SWEPT = 7
    """The cart did not go so far."""
    EDGE = 8
    """Lit and seen, but every spot there straddles an edge and was left out."""


_WORDS = {
    Cause.LASER_1_SHADOW: ("in the shadow of laser 1", "turn the object, or scan again from its other side"),
    Cause.LASER_2_SHADOW: ("in the shadow of laser 2", "turn the object, or scan again from its other side"),
    Cause.CAMERA_SHADOW: ("hidden from the camera", "move tall objects to the middle of the bed"),
    Cause.SATURATED: ("too bright", "shorten the exposure, or dull the surface with spray"),
    Cause.TOO_DARK: ("too dark", "lengthen the exposure"),
    Cause.OUT_OF_RANGE: ("outside the camera's picture", "move the object to the middle, or lower it"),
    Cause.NOT_SWEPT: ("not swept", "scan a longer way"),
    Cause.EDGE: ("at edges", "scan with a smaller pitch"),
}
# The cause that came nearest to a measurement is the one that a person can do something about.
_FIRST = (
    Cause.SATURATED, Cause.TOO_DARK, Cause.EDGE, Cause.CAMERA_SHADOW, Cause.LASER_1_SHADOW, Cause.LASER_2_SHADOW,
    Cause.OUT_OF_RANGE, Cause.NOT_SWEPT,
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Holes:
    """The swept area in cells, and why some hold no point.

    Attributes
    ----------
    surface
        Heights that were measured.
    cause : (rows, columns) uint8 array
        One of `Cause`: of the lasers' causes the one that came nearest to a measurement.
    by_laser : (lasers, rows, columns) uint8 array
        The cause of each laser; `Cause.MEASURED` in every cell that holds a point.
    """

    surface: HeightMap
    cause: ByteArray
    by_laser: ByteArray

    @property
    def share(self) -> float:
        """Share of the cells without a point."""
        return float(np.mean(self.cause != Cause.MEASURED))

    def areas_mm2(self) -> dict[Cause, float]:
        """Area without points by cause, largest first."""
        cell = self.surface.cell_mm**2
        found, number = np.unique(self.cause[self.cause != Cause.MEASURED], return_counts=True)
        order = np.argsort(-number, kind="stable")
        return {Cause(int(found[i])): float(number[i]) * cell for i in order}

    def hint(self) -> str | None:
        """What to do about the most common cause, in a sentence; None where there are no holes."""
        areas = self.areas_mm2()
        if not areas:
            return None
        cause, area = next(iter(areas.items()))
        what, remedy = _WORDS[cause]
        return f"{area:.0f} mm2 of {sum(areas.values()):.0f} mm2 without points are {what}: {remedy}."


def holes(cloud: PointCloud, rig: Rig, cart_mm: FloatArray, *, cell_mm: float = 1.5) -> Holes:
    """Find the cells without a point in the area of a cloud, and why.

    Parameters
    ----------
    cloud
        The lasers' points, or a fused cloud; the latter's points from other sources make the surface better known.
    cart_mm : (frames,) array
        Commanded positions of the laser pass.
    cell_mm
        Size of the cells; not below the distance of the points.

    Raises
    ------
    InputError
        The cloud is empty or too large for these cells.
    """
    surface = height_map(cloud, cell_mm)
    missing = surface.count == 0
    ground = grown(surface.height_mm)
    ceiling = np.where(missing, ground, surface.height_mm)
    places = np.column_stack([surface.places()[missing], ground[missing]])
    bright = _brightness(cloud, surface) >= SATURATED_DN
    around = int(np.ceil(_NEAR_EDGE_MM / cell_mm)) * 2 + 1
    jump = maximum_filter(ceiling, around) - minimum_filter(ceiling, around) > _EDGE_MM
    by_laser = np.zeros((len(rig.sheets), *surface.shape), np.uint8)
    for laser in range(len(rig.sheets)):
        by_laser[laser][missing] = _causes(
            rig, laser, places, cart_mm, ceiling, surface, bright[missing], jump[missing]
        )
    cause = np.zeros(surface.shape, np.uint8)
    for candidate in reversed(_FIRST):
        cause[(by_laser == candidate).any(axis=0)] = candidate
    return Holes(surface, cause, by_laser)


def _causes(
    rig: Rig, laser: int, places: FloatArray, cart_mm: FloatArray, ceiling: FloatArray, surface: HeightMap,
    bright: BoolArray, jump: BoolArray,
) -> ByteArray:  # fmt: skip
    """Cause (n,) for one laser at places (n, 3) in the bed frame."""
    sheet, pose = rig.sheets[laser], rig.bed_from_camera
    normal = pose.rotation @ sheet.normal
    # The sheet moves with the cart: normal . (place - travel cart - camera) = offset.
    at = ((places - pose.translation_mm) @ normal - sheet.offset_mm) / float(normal @ rig.travel)
    camera = pose.translation_mm + at[:, None] * rig.travel
    axis = np.array([0.0, 1.0, 0.0]) if sheet.side[1] == "v" else np.array([1.0, 0.0, 0.0])
    # Where the sheet meets the baseline stands the laser.
    along = sheet.baseline_mm * (1.0 if sheet.side[0] == "+" else -1.0)
    source = camera + pose.rotation @ (axis * along)
    pixels = rig.camera.project((places - camera) @ pose.rotation)
    width, height = rig.camera.size
    with np.errstate(invalid="ignore"):
        pictured = (pixels >= 0).all(axis=1) & (pixels[:, 0] <= width - 1) & (pixels[:, 1] <= height - 1)
    step = float(np.median(np.abs(np.diff(cart_mm)))) if len(cart_mm) > 1 else 0.0
    swept = (at >= np.min(cart_mm) - step) & (at <= np.max(cart_mm) + step)
    dark = blocked(places, source, ceiling, surface.low_mm, surface.cell_mm, _CLEAR_MM)
    hidden = blocked(places, camera, ceiling, surface.low_mm, surface.cell_mm, _CLEAR_MM)
    cause = np.where(bright, Cause.SATURATED, np.where(jump, Cause.EDGE, Cause.TOO_DARK)).astype(np.uint8)
    cause[hidden] = Cause.CAMERA_SHADOW
    cause[dark] = Cause.LASER_1_SHADOW + laser
    cause[~swept] = Cause.NOT_SWEPT
    cause[~pictured] = Cause.OUT_OF_RANGE
    return cause


def _brightness(cloud: PointCloud, surface: HeightMap) -> FloatArray:
    """Largest stripe amplitude around each cell, (rows, columns)."""
    cell = np.floor((cloud.points_mm[:, :2] - surface.low_mm) / surface.cell_mm)
    inside = np.isfinite(cell).all(axis=1) & np.isfinite(cloud.intensity)
    rows, columns = cell[inside].astype(np.int64).T
    keep = (rows >= 0) & (columns >= 0) & (rows < surface.shape[0]) & (columns < surface.shape[1])
    largest = np.zeros(surface.shape)
    np.maximum.at(largest, (rows[keep], columns[keep]), cloud.intensity[inside][keep])
    return np.asarray(maximum_filter(largest, _AROUND_CELLS))


@njit(cache=True, error_model="numpy")
def blocked(
    places: FloatArray, towards: FloatArray, ceiling: FloatArray, low: FloatArray, cell_mm: float, clear_mm: float
) -> BoolArray:  # pragma: no cover - compiled
    """Whether a surface stands between places (n, 3) and the points (n, 3) that look at them.

    Parameters
    ----------
    ceiling : (rows, columns) array
        Heights; NaN is free.
    clear_mm
        A surface that rises less above the line is none in the way.
    """
    rows, columns = ceiling.shape
    top = -np.inf
    for a in range(rows):
        for b in range(columns):
            if ceiling[a, b] > top:
                top = ceiling[a, b]
    out = np.zeros(places.shape[0], np.bool_)
    for i in range(places.shape[0]):
        dx, dy, dz = towards[i, 0] - places[i, 0], towards[i, 1] - places[i, 1], towards[i, 2] - places[i, 2]
        flat = np.sqrt(dx * dx + dy * dy)
        if not (dz > 0.0 and flat > 0.0):
            continue
        stride = 0.25 * cell_mm / flat
        own_a = int(np.floor((places[i, 0] - low[0]) / cell_mm))
        own_b = int(np.floor((places[i, 1] - low[1]) / cell_mm))
        t = stride
        while t < 1.0:
            z = places[i, 2] + t * dz
            if z > top:
                break
            a = int(np.floor((places[i, 0] + t * dx - low[0]) / cell_mm))
            b = int(np.floor((places[i, 1] + t * dy - low[1]) / cell_mm))
            if a < 0 or b < 0 or a >= rows or b >= columns:
                break
            if ceiling[a, b] > z + clear_mm and (a != own_a or b != own_b):
                out[i] = True
                break
            t += stride
    return out
