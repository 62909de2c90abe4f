"""The reference pass: the empty bed at the same positions, from which heights count."""

from dataclasses import dataclass

import numpy as np

from twinline.arrays import FloatArray

EDGE_SHARE = 0.2
"""The outermost fifth of the columns on either side is taken to show bare bed."""

MOST_DISAGREEMENT_PX = 1.5
MOST_DRIFT_PX = 8.0
FEWEST_COLUMNS = 12


@dataclass(frozen=True, eq=False)
class BedDrift:
    """How far the bed beside the object lies from where the reference pass saw it.

    Parts bend and settle when an object is put down, and positions repeat only so well; both shift every height alike.

    Attributes
    ----------
    cart_mm : (k,) array
        Ascending positions at which the drift was seen.
    shift_px : (lasers, k) array
        Stripe in the laser pass less stripe in the reference pass.
    """

    cart_mm: FloatArray
    shift_px: FloatArray

    def at(self, laser: int, cart_mm: float) -> float:
        """Drift of one laser's stripe, interpolated between the positions."""
        if not len(self.cart_mm):
            return 0.0
        return float(np.interp(cart_mm, self.cart_mm, self.shift_px[laser]))


def drift_of(centre: FloatArray, bed: FloatArray) -> FloatArray:
    """Shift of each stripe against the reference at both ends of it, (lasers,).

    NaN unless both ends of the stripe agree: then neither can be an object.

    Parameters
    ----------
    centre, bed : (lasers, columns) arrays
        Stripes in the laser pass and in the reference pass, pixels; NaN where there is none.
    """
    reach = max(int(EDGE_SHARE * centre.shape[1]), 1)
    shift = centre - bed
    drift = np.full(len(centre), np.nan)
    for k, line in enumerate(shift):
        found = np.flatnonzero(np.isfinite(line))
        if not len(found):
            continue
        first, last = found[0], found[-1]
        ends = [line[found[found < first + reach]], line[found[found > last - reach]]]
        if min(len(end) for end in ends) < FEWEST_COLUMNS or last - first < 2 * reach:
            continue
        left, right = (float(np.median(end)) for end in ends)
        if abs(left - right) <= MOST_DISAGREEMENT_PX and abs(left + right) <= 2.0 * MOST_DRIFT_PX:
            drift[k] = 0.5 * (left + right)
    return drift


def smooth_line(centres: FloatArray, reach: int = 4) -> FloatArray:
    """Running median along each stripe, (lasers, columns): the bed is smooth, a single column's reading is not.

    Gaps are bridged by straight lines between their ends; NaN stays only where a laser shows nothing at all.
    """
    smooth = np.full_like(centres, np.nan)
    columns = np.arange(centres.shape[1])
    for k, line in enumerate(centres):
        found = np.isfinite(line)
        if not found.any():
            continue
        padded = np.pad(line, reach, constant_values=np.nan)
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1)
        smooth[k] = np.interp(columns, columns[found], np.nanmedian(windows[found], axis=1))
    return smooth
