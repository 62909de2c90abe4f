"""The stripe on the bare bed: found in the pictures themselves, before anything is known of the laser.

The cart carries camera and lasers along the bed, so each stripe lies on the bare bed in the same place of every
picture, up to a drift where the travel is not quite parallel to the bed. A rising surface moves it to its laser's own
side: of the places where a stripe stays for many frames the lowest is the bed.
"""

from dataclasses import dataclass

import numpy as np

from twinline.arrays import BoolArray, FloatArray
from twinline.calibration.observations import StripePoints
from twinline.geometry.sheet import Side

_BIN_PX = 0.5
_LEAST_SHARE = 0.06
_NEAR_PX = 1.2
_ROUNDS = 8
_DEGREE = 4
_LANE_GROUPS = 24
_CART_GROUPS = 3
_FEWEST_LANES = 40
_BEGIN_PX = 6.0


@dataclass(frozen=True, eq=False)
class BedLine:
    """One laser's stripe on the bed.

    Attributes
    ----------
    on_bed : (frames, lanes) bool array
        Where the stripe lies on it.
    share
        Share of all stripes that do.
    """

    on_bed: BoolArray
    share: float


def find_bed_line(centre_px: FloatArray, cart_mm: FloatArray, side: Side) -> BedLine | None:
    """Find where one laser's stripe lies on the bare bed.

    Parameters
    ----------
    centre_px : (frames, lanes) array
        NaN where there is no stripe.
    cart_mm : (frames,) array
    side
        Side of the image to which a rising surface moves this stripe.

    Returns
    -------
    BedLine or None
        None if no surface stays below all others in enough of the lanes.
    """
    up = 1.0 if side[0] == "+" else -1.0
    heights = up * np.asarray(centre_px, dtype=np.float64)
    lowest = _lowest_places(heights)
    lanes = np.flatnonzero(np.isfinite(lowest))
    if len(lanes) < _FEWEST_LANES:
        return None
    x = 2.0 * np.arange(heights.shape[1]) / max(heights.shape[1] - 1, 1) - 1.0
    curve = _fit_curve(x[lanes], lowest[lanes])
    t = (np.asarray(cart_mm) - np.mean(cart_mm)) / max(float(np.ptp(cart_mm)), 1e-9)
    drift = 0.0
    near = np.zeros(heights.shape, bool)
    for round_ in range(_ROUNDS):
        expected = np.polynomial.polynomial.polyval(x, curve)[None, :] + drift * t[:, None]
        reach = max(_NEAR_PX, _BEGIN_PX / 2**round_)
        with np.errstate(invalid="ignore"):
            near = np.abs(heights - expected) < reach
        if near.sum() < _FEWEST_LANES:
            return None
        frame, lane = np.nonzero(near)
        pick = slice(None, None, max(1, len(frame) // 40_000))
        design = np.column_stack([x[lane[pick]][:, None] ** np.arange(_DEGREE + 1), t[frame[pick]]])
        solution = np.linalg.lstsq(design, heights[frame[pick], lane[pick]], rcond=None)[0]
        curve, drift = solution[:-1], float(solution[-1])
    share = float(near.sum() / max(np.isfinite(heights).sum(), 1))
    return BedLine(near, share)


def _lowest_places(heights: FloatArray) -> FloatArray:
    """Per lane the lowest place at which the stripe stays in many frames; NaN where there is none."""
    lanes = heights.shape[1]
    found = np.isfinite(heights)
    if not found.any():
        return np.full(lanes, np.nan)
    least = float(np.nanmin(heights))
    bins = np.where(found, (np.nan_to_num(heights, nan=least) - least) / _BIN_PX, 0).astype(np.int64)
    count = int(bins.max()) + 1
    lane = np.broadcast_to(np.arange(lanes), heights.shape)
    table = np.bincount((lane * count + bins)[found], minlength=lanes * count).reshape(lanes, count).astype(np.float64)
    padded = np.pad(table, ((0, 0), (1, 1)))
    wide = padded[:, :-2] + padded[:, 1:-1] + padded[:, 2:]
    needed = np.maximum(_LEAST_SHARE * found.sum(axis=0), 3)[:, None]
    enough = wide >= needed
    # The first local maximum above the limit, counted from below.
    peak = enough & (wide >= np.pad(wide, ((0, 0), (0, 1)))[:, 1:]) & (wide >= np.pad(wide, ((0, 0), (1, 0)))[:, :-1])
    first = np.argmax(peak, axis=1)
    return np.where(peak.any(axis=1), least + (first + 0.5) * _BIN_PX, np.nan)


def _fit_curve(x: FloatArray, lowest: FloatArray) -> FloatArray:
    """Polynomial through the lowest places; lanes in which an object hides the bed lie above and lose their weight."""
    design = x[:, None] ** np.arange(_DEGREE + 1)
    weights = np.ones(len(x))
    fit = np.zeros(_DEGREE + 1)
    for degree in (1, 1, 1, 1, 2, 2, 2, _DEGREE, _DEGREE, _DEGREE):
        used = design[:, : degree + 1] * weights[:, None]
        fit = np.zeros(_DEGREE + 1)
        fit[: degree + 1] = np.linalg.lstsq(used, lowest * weights, rcond=None)[0]
        error = lowest - design @ fit
        scale = max(1.4826 * float(np.median(np.abs(error))), 0.3)
        # Harsher above the curve than below it.
        weights = 1.0 / (1.0 + (np.where(error > 0, 2.0, 1.0) * error / (2.0 * scale)) ** 2)
    return fit


def bed_groups(points: StripePoints, lanes: FloatArray, lane_count: int) -> StripePoints:
    """Bed stripes averaged over groups of lanes and of cart positions.

    The bed is seen at the same pixels in every frame, so what lens and estimator do wrong there repeats itself: a group
    is one observation, however many stripes it has.

    Parameters
    ----------
    lanes : (n,) array
        Lane of each point.
    """
    if not len(points):
        return points
    lane_group = np.minimum((lanes * _LANE_GROUPS / lane_count).astype(np.int64), _LANE_GROUPS - 1)
    span = max(float(np.ptp(points.cart_mm)), 1e-9)
    cart_group = np.minimum(
        ((points.cart_mm - points.cart_mm.min()) / span * _CART_GROUPS).astype(np.int64), _CART_GROUPS - 1
    )
    _, group, counts = np.unique(lane_group * _CART_GROUPS + cart_group, return_inverse=True, return_counts=True)
    number = len(counts)

    def mean(values: FloatArray) -> FloatArray:
        return np.bincount(group, weights=values, minlength=number) / counts

    pixels = np.column_stack([mean(points.pixels[:, 0]), mean(points.pixels[:, 1])])
    sd = np.sqrt(mean(points.sd_px**2) / counts)
    kept = counts >= 5
    return StripePoints(pixels[kept], sd[kept], mean(points.cart_mm)[kept])
