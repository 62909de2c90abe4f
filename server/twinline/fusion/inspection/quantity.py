"""A measured number with its uncertainty, and what counts as a measured point."""

from dataclasses import dataclass

import numpy as np

from twinline.arrays import FloatArray, IntArray
from twinline.errors import InputError


@dataclass(frozen=True)
class Quantity:
    """A number with its standard uncertainty.

    Attributes
    ----------
    value
        In `unit`.
    sigma
        One standard deviation (k = 1), in `unit`.
    unit
        ``mm``, ``mm2``, ``mm3`` or ``deg``.
    """

    value: float
    sigma: float
    unit: str = "mm"

    def __str__(self) -> str:
        signs = {"mm2": "mm²", "mm3": "mm³", "deg": "°"}
        return f"{self.value:.4g} ± {self.sigma:.2g} {signs.get(self.unit, self.unit)}"


def measured_rows(points_mm: FloatArray, *, least: int, what: str) -> IntArray:
    """Rows of the points that were measured: NaN and infinity mean "no measurement".

    Parameters
    ----------
    points_mm : (n, 3) array
    least
        How many are needed.
    what
        What they are needed for, as the error says it.

    Raises
    ------
    InputError
        If too few points were measured.
    """
    if points_mm.ndim != 2 or points_mm.shape[1] != 3:
        raise ValueError(f"points_mm has shape {points_mm.shape}, expected (n, 3)")
    rows = np.flatnonzero(np.isfinite(points_mm).all(axis=1))
    if len(rows) < least:
        unmeasured = len(points_mm) - len(rows)
        without = f" ({unmeasured} more have no measurement)" if unmeasured else ""
        raise InputError(
            f"{what} needs at least {least} points and there are {len(rows)}{without}; choose a larger region.",
            code="too-few-points",
        )
    return rows


def trimmed_range(deviation_mm: FloatArray, sigma_mm: FloatArray | None = None) -> Quantity:
    """Distance between the lowest and the highest deviation without the outermost 0.3 % of the points.

    This is the form error of VDI/VDE 2634-2, which allows three of a thousand points to be left out. The uncertainty
    is that of the two order statistics, ``sqrt(p (1 - p) / n) / f`` with the density f from neighbouring quantiles
    (A. Stuart and K. Ord, "Kendall's Advanced Theory of Statistics" 1, section 10.10).

    Parameters
    ----------
    deviation_mm : (n,) array
    sigma_mm : (n,) array, optional
        Known noise of the points; the uncertainty is at least its median.
    """
    n = len(deviation_mm)
    if n < 2:
        raise ValueError("a range needs at least two deviations")
    share = 0.0015
    # A quantile's neighbours have to be apart by some points for their distance to tell a density.
    step = max(share / 2, 3.0 / n)
    ordered = np.sort(np.asarray(deviation_mm, dtype=np.float64))

    def quantile(p: float) -> float:
        return float(np.interp(np.clip(p, 0.0, 1.0) * (n - 1), np.arange(n), ordered))

    low, high = quantile(share), quantile(1.0 - share)
    at = max(share, 1.0 / n)
    spread = float(np.sqrt(at * (1.0 - at) / n))
    variance = 0.0
    for p in (share, 1.0 - share):
        lower, upper = max(p - step, 0.0), min(p + step, 1.0)
        variance += ((quantile(upper) - quantile(lower)) / (upper - lower) * spread) ** 2
    floor = 0.0 if sigma_mm is None else float(np.median(sigma_mm)) / np.sqrt(n)
    return Quantity(high - low, max(float(np.sqrt(variance)), floor))
