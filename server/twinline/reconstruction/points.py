"""From a frame's stripes to points: one compiled pass over the columns of each laser, since it runs for every frame."""

from typing import NamedTuple

import numpy as np
from numba import njit

from twinline.arrays import ByteArray, FloatArray, IntArray
from twinline.geometry.triangulation import PackedLaser, stripe_points_together
from twinline.stripe.model import Flag

_POOR_FIT, _BROKEN = int(Flag.POOR_FIT), int(Flag.BROKEN)


class StripePoints(NamedTuple):
    """Points of one frame and where they come from; rows beyond the number that was entered hold nothing yet.

    Attributes
    ----------
    points_mm : (n, 3) float32 array
        In the bed frame.
    sigma_mm, intensity, depth_mm : (n,) float32 arrays
        Standard deviation, amplitude of the stripe in grey levels, distance from the camera along its axis.
    pixels : (n, 2) float32 array
        u, v.
    laser, column : (n,) int16 arrays
        Row and column of the profile.
    source : (n,) uint8 array
        One of `twinline.fusion.cloud.Source`.
    """

    points_mm: FloatArray
    sigma_mm: FloatArray
    intensity: FloatArray
    depth_mm: FloatArray
    pixels: FloatArray
    laser: IntArray
    column: IntArray
    source: ByteArray

    @classmethod
    def room_for(cls, number: int) -> "StripePoints":
        """Arrays of so many rows, not filled."""
        return cls(
            np.empty((number, 3), np.float32),
            np.empty(number, np.float32),
            np.empty(number, np.float32),
            np.empty(number, np.float32),
            np.empty((number, 2), np.float32),
            np.empty(number, np.int16),
            np.empty(number, np.int16),
            np.empty(number, np.uint8),
        )

    def first(self, number: int) -> "StripePoints":
        """The rows that were entered."""
        return StripePoints(*(values[:number] for values in self))  # type: ignore[arg-type]


@njit(cache=True, error_model="numpy")
def enter_points(
    packed: PackedLaser, laser: int, source: int, centre: FloatArray, sd: FloatArray, place: FloatArray,
    amplitude: FloatArray, flags: IntArray, cart_mm: float, room: StripePoints, start: int,
) -> tuple[int, int, int, int]:  # fmt: skip  # pragma: no cover - compiled
    """Triangulate the columns of one laser that are fit for it.

    A spot that straddles an edge, or whose shape is not a stripe's, gives no point.

    Parameters
    ----------
    laser, source
        Row of the profile, and number of its source.
    centre, sd : (columns,) arrays
        The stripe in the picture and its standard deviation, pixels; NaN where there is none.
    place : (columns,) array
        Where the stripe is taken to be for triangulation: ``centre`` itself, or that corrected by a reference pass.
    cart_mm
        Commanded position of the cart.
    room
        Filled from row ``start`` on.

    Returns
    -------
    end, poor_fit, broken, off_the_sheet
        The row after the last one filled, and the columns without a point by reason; one column can have two.
    """
    poor, broken, end = 0, 0, start
    for c in range(centre.size):
        if not np.isfinite(centre[c]):
            continue
        flag = flags[c]
        if flag & (_POOR_FIT | _BROKEN):
            poor += (flag & _POOR_FIT) != 0
            broken += (flag & _BROKEN) != 0
        elif np.isfinite(place[c]):
            room.column[end] = c
            end += 1
    count = end - start
    u, v, deviation = np.empty(count), np.empty(count), np.empty(count)
    for i in range(count):
        c = room.column[start + i]
        u[i], v[i] = (float(c), place[c]) if packed.along_u else (place[c], float(c))
        deviation[i] = sd[c]
    found = stripe_points_together(packed, u, v, deviation, cart_mm)
    row = start
    for i in range(count):
        if not np.isfinite(found[3, i]):
            continue
        c = room.column[start + i]
        room.points_mm[row, 0], room.points_mm[row, 1], room.points_mm[row, 2] = found[0, i], found[1, i], found[2, i]
        room.sigma_mm[row], room.depth_mm[row], room.intensity[row] = found[3, i], found[4, i], amplitude[c]
        room.pixels[row, 0], room.pixels[row, 1] = u[i], v[i]
        room.laser[row], room.column[row], room.source[row] = laser, c, source
        row += 1
    return row, poor, broken, end - row
