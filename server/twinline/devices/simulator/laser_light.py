"""Where the light of a laser falls and how much of it the camera's pixels receive: a compiled loop over rays.

Nothing here computes a point from a pixel and a sheet. A camera ray is followed to the first surface it meets; the
light there depends on how far that point happens to lie from the sheet, on the surface's slope, and on whether the way
back to the laser is free.
"""

import numpy as np

from twinline.arrays import FloatArray, IntArray
from twinline.devices.simulator.compiled import loop
from twinline.devices.simulator.noise_table import next_random, to_normal
from twinline.devices.simulator.raycast import cast
from twinline.devices.simulator.solids import NORMAL, Solids, albedo_at, ceiling_at

REACH_WIDTHS = 4.5
"""Standard deviations of a sheet's thickness beyond which its light is taken as none."""
REFERENCE_MM = 400.0
"""Distance from the laser at which a sheet's brightness is stated."""


@loop
def laser_light(
    pixels: IntArray,
    rays: FloatArray,
    first_row: int,
    rotation: FloatArray,
    eye: FloatArray,
    source: FloatArray,
    sheet_normal: FloatArray,
    width_mm: float,
    brightness_dn: float,
    channel: int,
    speckle: float,
    seed: int,
    table: FloatArray,
    solids: Solids,
    slack_mm: float,
    stack: FloatArray,
    band: FloatArray,
) -> int:  # pragma: no cover - compiled
    """Add the light of one laser to the rows of the picture in which it can be seen.

    Parameters
    ----------
    pixels : (n, 2) array of int
        Row and column of the pixels that may see the sheet above the bed.
    rays : (n, 3) array
        Their x/z and y/z, and the depth z at which each would cross the middle of the sheet in empty air; that depth
        only serves to leave out pixels that look through air where they cross the sheet.
    source : (3,) array
        Where the laser's light comes from, bed frame, mm.
    sheet_normal : (3,) array
        Unit normal of the sheet of light through the source, bed frame.
    width_mm
        Standard deviation of the light across the sheet.
    brightness_dn
        Grey levels of a white surface at ``REFERENCE_MM`` that faces the laser.
    channel
        Whose albedo the laser's light meets: 0 blue, 1 green, 2 red.
    speckle
        Sigma of the logarithm of the speckle's factor, whose mean is 1.
    slack_mm
        How far above the ceiling a crossing may be and its pixel still receive light.
    stack : (STACK_DEPTH, 2) array
        Scratch memory.
    band : (rows, columns) array
        Grey levels; row 0 is row ``first_row`` of the picture.

    Returns
    -------
    int
        Number of camera rays that were cast.
    """
    state = np.uint64(seed)
    corners, nodes, faces, looks, texture, ceilings, _, print_share, numbers = solids
    ox, oy, oz = eye[0], eye[1], eye[2]
    reach = REACH_WIDTHS * width_mm
    cast_rays = 0
    for i in range(pixels.shape[0]):
        sx, sy, depth = rays[i, 0], rays[i, 1], rays[i, 2]
        dx = rotation[0, 0] * sx + rotation[0, 1] * sy + rotation[0, 2]
        dy = rotation[1, 0] * sx + rotation[1, 1] * sy + rotation[1, 2]
        dz = rotation[2, 0] * sx + rotation[2, 1] * sy + rotation[2, 2]
        crossing = oz + depth * dz
        ceiling = ceiling_at(ceilings, numbers, ox + depth * dx, oy + depth * dy)
        if crossing > ceiling + slack_mm or crossing < -slack_mm:
            continue
        cast_rays += 1
        ground = -oz / dz if dz < 0.0 else np.inf
        t, found = cast(ox, oy, oz, dx, dy, dz, 0.0, ground, False, corners, nodes, stack)
        if t == np.inf:
            continue
        x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
        lx, ly, lz = x - source[0], y - source[1], z - source[2]
        off = lx * sheet_normal[0] + ly * sheet_normal[1] + lz * sheet_normal[2]
        if abs(off) > reach:
            continue
        nx, ny, nz = 0.0, 0.0, 1.0
        if found >= 0:
            nx, ny, nz = faces[found, NORMAL], faces[found, NORMAL + 1], faces[found, NORMAL + 2]
        distance = np.sqrt(lx * lx + ly * ly + lz * lz)
        facing = -(lx * nx + ly * ny + lz * nz) / distance
        if facing <= 0.0:
            continue
        _, blocker = cast(source[0], source[1], source[2], lx, ly, lz, 0.0, 1.0 - 1e-6, True, corners, nodes, stack)
        if blocker >= 0:
            continue
        light = brightness_dn * facing * REFERENCE_MM / distance * np.exp(-0.5 * (off / width_mm) ** 2)
        light *= albedo_at(corners, faces, looks, texture, print_share, numbers, found, x, y, z, channel)
        if speckle > 0.0:
            state = next_random(state)
            light *= np.exp(speckle * to_normal(table, state >> np.uint64(52)) - 0.5 * speckle * speckle)
        band[pixels[i, 0] - first_row, pixels[i, 1]] += light
    return cast_rays
