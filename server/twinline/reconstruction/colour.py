"""The surface's own colour: taken from frames in which the stripes are elsewhere.

A point lit in one frame lies some pixels further along the travel in its neighbours, unlit. The shift follows from
its depth: ``d(pixel) = f * travel * d(cart) / Z``. Lens distortion changes that by a pixel at most, which a colour
does not notice.
"""

import numpy as np
from numba import njit

from twinline.arrays import BoolArray, ByteArray, FloatArray, IntArray
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
    pixels: FloatArray, shift_px: FloatArray, image: ByteArray, offset_mm: float, stripes: FloatArray, along_u: bool,
    places: IntArray, colours: ByteArray,
) -> BoolArray:  # fmt: skip
    """Take the colours of pixels from another frame, where they are clear of every stripe.

    Parameters
    ----------
    pixels : (n, 2) array
        Lit pixels u, v.
    shift_px : (n, 2) array
        Movement of each per commanded millimetre.
    image : (h, w, 3) uint8 array
        The other frame, blue green red.
    offset_mm
        Commanded millimetres from the lit frame to the other.
    stripes : (lasers, columns) array
        Stripe centres in the other frame; NaN where there is none.
    places : (n,) int array
        Rows of ``colours`` to fill, red green blue.

    Returns
    -------
    (n,) bool array
        Which pixels got their colour.
    """
    done = np.zeros(pixels.shape[0], np.bool_)
    height, width = image.shape[0], image.shape[1]
    for i in range(pixels.shape[0]):
        u = round(pixels[i, 0] + shift_px[i, 0] * offset_mm)
        v = round(pixels[i, 1] + shift_px[i, 1] * offset_mm)
        if u < 0 or v < 0 or u >= width or v >= height:
            continue
        column, place = (u, v) if along_u else (v, u)
        clear = True
        for laser in range(stripes.shape[0]):
            # NaN compares false: no stripe is in the way there.
            if abs(stripes[laser, column] - place) < CLEARANCE_PX:
                clear = False
        if clear:
            colours[places[i], 0] = image[v, u, 2]
            colours[places[i], 1] = image[v, u, 1]
            colours[places[i], 2] = image[v, u, 0]
            done[i] = True
    return done
