"""What a calibration is made from, in the units in which it was measured."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from twinline.arrays import BoolArray, FloatArray, IntArray

_MEDIAN_SIZE = 5
_STRAY_PX = 1.5
_STRAY_SCALES = 6.0
_EDGE_JUMP_PX = 2.5
_FEWEST_REPEATS = 3


@dataclass(frozen=True, eq=False)
class StripePoints:
    """Stripe centres of one laser, one row per point.

    Attributes
    ----------
    pixels : (n, 2) array
        u, v; exact along the stripe, measured across it.
    sd_px, cart_mm : (n,) arrays
        Standard deviation of the measured coordinate, and commanded position of the cart.
    """

    pixels: FloatArray
    sd_px: FloatArray
    cart_mm: FloatArray

    def __len__(self) -> int:
        return len(self.cart_mm)

    def take(self, rows: IntArray | BoolArray) -> "StripePoints":
        """Some of the points."""
        return StripePoints(self.pixels[rows], self.sd_px[rows], self.cart_mm[rows])

    @classmethod
    def join(cls, parts: "list[StripePoints]") -> "StripePoints":
        """All points of all parts."""
        if not parts:
            return cls(np.empty((0, 2)), np.empty(0), np.empty(0))
        return cls(
            np.concatenate([p.pixels for p in parts]),
            np.concatenate([p.sd_px for p in parts]),
            np.concatenate([p.cart_mm for p in parts]),
        )


@dataclass(frozen=True, eq=False)
class TofReadings:
    """Readings of the ToF sensor in the order of time.

    Attributes
    ----------
    time_s, cart_mm, slide_mm, reading : (n,) arrays
        NaN readings are no measurements.
    """

    time_s: FloatArray
    cart_mm: FloatArray
    slide_mm: FloatArray
    reading: FloatArray

    def __len__(self) -> int:
        return len(self.time_s)


def median_of_repeats(readings: TofReadings) -> TofReadings:
    """One reading per stay where the sensor stood still for each: the median of the valid ones.

    Of a raster that stops at its places the first readings of a stay may still be those of the place before, and some
    sensors now and then give a wild one. Readings taken in motion are returned as they are.
    """
    if not len(readings):
        return readings
    moved = (np.diff(readings.cart_mm) != 0) | (np.diff(readings.slide_mm) != 0)
    stay = np.concatenate([[0], np.cumsum(moved)])
    first, length = np.unique(stay, return_index=True, return_counts=True)[1:]
    if np.median(length) < _FEWEST_REPEATS:
        return readings
    ends = zip(first, first + length, strict=True)
    value = np.full(len(first), np.nan)
    for number, (begin, end) in enumerate(ends):
        valid = readings.reading[begin:end]
        valid = valid[np.isfinite(valid)]
        if len(valid):
            value[number] = np.median(valid)
    middle = first + length // 2
    return TofReadings(readings.time_s[middle], readings.cart_mm[first], readings.slide_mm[first], value)


def clean_stripes(centre_px: FloatArray) -> tuple[BoolArray, float]:
    """Stripes of one laser that agree with their surroundings and do not lie beside an edge.

    A centre far from the median of its neighbours, along the stripe and from frame to frame, lies on another surface
    than they do or on none; one next to a jump may straddle it.

    Parameters
    ----------
    centre_px : (frames, lanes) array
        Frames in the order of the cart; NaN where there is no stripe.

    Returns
    -------
    (frames, lanes) bool array
        Those to be used.
    float
        Share of the stripes that disagreed with their surroundings.
    """
    found = np.isfinite(centre_px)
    if not found.any():
        return found, 0.0
    filled = _filled(centre_px)
    middle = median_filter(filled, size=_MEDIAN_SIZE, mode="nearest")
    off = np.abs(filled - middle)
    scale = 1.4826 * float(np.median(off[found]))
    stray = found & (off > max(_STRAY_PX, _STRAY_SCALES * scale))
    steep = np.zeros_like(found)
    for axis in (0, 1):
        jump = np.abs(np.diff(middle, axis=axis)) > _EDGE_JUMP_PX
        jump |= np.diff(found.astype(np.int8), axis=axis) != 0
        before = [slice(None), slice(None)]
        after = [slice(None), slice(None)]
        before[axis], after[axis] = slice(None, -1), slice(1, None)
        steep[tuple(before)] |= jump
        steep[tuple(after)] |= jump
    near = steep.copy()
    near[:, 1:] |= steep[:, :-1]
    near[:, :-1] |= steep[:, 1:]
    return found & ~stray & ~near, float(stray.sum() / found.sum())


def _filled(centre_px: FloatArray) -> FloatArray:
    """The same with gaps filled from the nearest lane of the frame, so that filters need not know of them."""
    frames, lanes = centre_px.shape
    found = np.isfinite(centre_px)
    last = np.maximum.accumulate(np.where(found, np.arange(lanes), -1), axis=1)
    first = np.minimum.accumulate(np.where(found, np.arange(lanes), lanes)[:, ::-1], axis=1)[:, ::-1]
    source = np.where(last >= 0, last, np.minimum(first, lanes - 1))
    filled = centre_px[np.arange(frames)[:, None], source]
    return np.where(np.isfinite(filled), filled, np.float32(np.nanmedian(centre_px)))


def stripe_points(
    centre_px: FloatArray, sd_px: FloatArray, cart_mm: FloatArray, wanted: BoolArray, *, along_u: bool
) -> StripePoints:
    """The wanted stripes of one laser, arrays of (frames, lanes), as rows."""
    frame, lane = np.nonzero(wanted & np.isfinite(centre_px))
    across = centre_px[frame, lane].astype(np.float64)
    along = lane.astype(np.float64)
    pixels = np.column_stack([along, across] if along_u else [across, along])
    return StripePoints(pixels, sd_px[frame, lane].astype(np.float64), np.asarray(cart_mm)[frame])
