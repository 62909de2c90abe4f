"""Areas and volumes: of a height map over a base, and of a closed mesh."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from twinline.arrays import BoolArray, FloatArray, IntArray
from twinline.errors import InputError
from twinline.fusion.inspection.quantity import Quantity


@dataclass(frozen=True, eq=False)
class VolumeOverBase:
    """What stands on a base, from a height map.

    Attributes
    ----------
    volume
        Between the surface and the base; only cells above the base count.
    area
        Of the base that the object covers.
    highest_mm
        Above the base, the median of the highest thousandth of the cells.
    unmeasured_mm2
        Area that the object encloses and that has no measurement; it is in neither figure.
    used : (m,) int array
        Flat indices of the cells that count.
    """

    volume: Quantity
    area: Quantity
    highest_mm: float
    unmeasured_mm2: float
    used: IntArray


def volume_over_base(
    z_mm: FloatArray, pitch_mm: float, *, base_mm: float = 0.0, least_mm: float = 0.2, sigma_mm: float = 0.05
) -> VolumeOverBase:
    """Volume and area of what rises above a base.

    The uncertainty has three parts: the noise of the cells; the height of the base, which all cells share and which is
    taken as known to a tenth of `sigma_mm`; and the border, which may lie anywhere within a cell (variance 1/12). The
    cells of a straight run of border err together: an edge along the raster is less certain than a slanting one.

    Parameters
    ----------
    z_mm : (ny, nx) array
        NaN means "no measurement".
    pitch_mm
        Distance of neighbouring cells.
    base_mm
        Height of the base.
    least_mm
        Cells less than this above the base belong to the base.
    sigma_mm
        Standard deviation of a cell's height.

    Raises
    ------
    InputError
        ``too-few-points`` if nothing rises above the base.
    """
    above = np.asarray(z_mm, dtype=np.float64) - base_mm
    with np.errstate(invalid="ignore"):
        inside = above > least_mm
    count = int(inside.sum())
    if not count:
        raise InputError(
            f"Nothing rises more than {least_mm:g} mm above the base at {base_mm:g} mm; choose another base or region.",
            code="too-few-points",
        )
    cell = pitch_mm**2
    heights = above[inside]
    noise = count * (sigma_mm * cell) ** 2
    shared = (0.1 * sigma_mm * cell * count) ** 2
    edge = _border_variance(inside, np.where(inside, above, 0.0)) * cell**2
    enclosed = ndimage.binary_fill_holes(inside) & np.isnan(above)
    top = np.sort(heights)[-max(count // 1000, 1) :]
    return VolumeOverBase(
        Quantity(float(heights.sum()) * cell, float(np.sqrt(noise + shared + edge)), "mm3"),
        Quantity(count * cell, float(np.sqrt(_border_variance(inside, inside.astype(np.float64)))) * cell, "mm2"),
        float(np.median(top)),
        float(enclosed.sum()) * cell,
        np.flatnonzero(inside),
    )


def _border_variance(inside: BoolArray, weight: FloatArray) -> float:
    """Variance of the sum of weights inside, from the border's place within its cells, in cells squared."""
    total = 0.0
    along_row = np.array([[0, 0, 0], [1, 1, 1], [0, 0, 0]])
    for turned, values in ((inside, weight), (inside.T, weight.T)):
        framed = np.pad(turned, ((1, 1), (0, 0)))
        for beyond in (framed[:-2], framed[2:]):
            runs, count = ndimage.label(turned & ~beyond, structure=along_row)
            if count:
                sums = np.bincount(runs.ravel(), weights=values.ravel())[1:]
                total += float((sums**2).sum()) / 12.0
    return total


def surface_area(z_mm: FloatArray, pitch_mm: float, region: BoolArray | None = None) -> float:
    """Area of the measured surface itself, mm², from the slopes between four measured neighbours.

    Noise roughens a surface and makes its area too large; thin or smooth the map first where that matters.

    Parameters
    ----------
    z_mm : (ny, nx) array
    pitch_mm
        Distance of neighbouring cells.
    region : (ny, nx) bool array, optional
        Cells that count.
    """
    z = np.asarray(z_mm, dtype=np.float64)
    if region is not None:
        z = np.where(region, z, np.nan)
    a, b, c, d = z[:-1, :-1], z[:-1, 1:], z[1:, 1:], z[1:, :-1]
    slope_x = ((b - a) + (c - d)) / (2.0 * pitch_mm)
    slope_y = ((d - a) + (c - b)) / (2.0 * pitch_mm)
    return float(np.nansum(np.sqrt(1.0 + slope_x**2 + slope_y**2))) * pitch_mm**2
