"""The surface's own colour: taken from frames in which the stripes are elsewhere.

A point lit in one frame lies some pixels further along the travel in its neighbours, unlit. The shift follows from
its depth: ``d(pixel) = f * travel * d(cart) / Z``. Lens distortion changes that by a pixel at most, which a colour
does not notice.
"""

import numpy as np
from numba import njit

from twinline.arrays import BoolArray, ByteArray, FloatArray
from twinline.geometry.rig import Rig

CLEARANCE_PX = 20.0
"""A stripe's halo reaches so far."""

UNKNOWN_GREY = 128


def shift_per_mm(rig: Rig) -> FloatArray:
    """Pixels times depth that a still point moves per commanded millimetre, (2,): divide by Z in mm."""
    in_camera = rig.bed_from_camera.rotation.T @ rig.travel
    return np.array([-rig.camera.fx * in_camera[0], -rig.camera.fy * in_camera[1]])


@njit(cache=True, error_model="numpy")
def sample_colours(
    pixels: FloatArray, depth_mm: FloatArray, move: FloatArray, image: ByteArray, stripes: FloatArray, along_u: bool,
    missing: BoolArray, colours: ByteArray,
) -> int:  # fmt: skip
    """Take the colours of lit pixels from another frame, where they are clear of every stripe.

    Parameters
    ----------
    pixels : (n, 2) array
        Lit pixels u, v.
    depth_mm : (n,) array
        Their distances from the camera.
    move : (2,) array
        Pixels times depth that each moves from the lit frame to the other.
    image : (h, w, 3) uint8 array
        The other frame, blue green red.
    stripes : (lasers, columns) array
        Stripe centres in the other frame; NaN where there is none.
    missing : (n,) bool array
        Which pixels want a colour; cleared where it was found.
    colours : (n, 3) uint8 array
        Red, green, blue, to be filled in.

    Returns
    -------
    int
        How many are still missing.
    """
    height, width = image.shape[0], image.shape[1]
    left = 0
    for i in range(missing.size):
        if not missing[i]:
            continue
        left += 1
        u = round(pixels[i, 0] + move[0] / depth_mm[i])
        v = round(pixels[i, 1] + move[1] / depth_mm[i])
        if u < 0 or v < 0 or u >= width or v >= height:
            continue
        column, place = (u, v) if along_u else (v, u)
        clear = True
        for laser in range(stripes.shape[0]):
            # NaN compares false: no stripe is in the way there.
            if abs(stripes[laser, column] - place) < CLEARANCE_PX:
                clear = False
        if clear:
            colours[i, 0], colours[i, 1], colours[i, 2] = image[v, u, 2], image[v, u, 1], image[v, u, 0]
            missing[i] = False
            left -= 1
    return left
