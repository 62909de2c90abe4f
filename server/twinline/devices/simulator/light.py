"""Where light falls and how much of it the camera's pixels receive: compiled loops over rays.

Nothing here computes a point from a pixel and a sheet. A camera ray is followed to the first surface it meets; the
light there depends on how far that point happens to lie from the sheet, on the surface's slope, and on whether the way
back to the laser is free.
"""

import numba
import numpy as np

from twinline.arrays import FloatArray, IntArray
from twinline.devices.simulator.bvh import STACK_DEPTH
from twinline.devices.simulator.noise_table import next_random, to_normal
from twinline.devices.simulator.raycast import cast
from twinline.devices.simulator.world import TEXTURE_TEXELS

_MASK = TEXTURE_TEXELS - 1
REACH_WIDTHS = 4.5
"""Standard deviations of a sheet's thickness beyond which its light is taken as none."""
REFERENCE_MM = 400.0
"""Distance from the laser at which a sheet's brightness is stated."""


@numba.njit(cache=True, nogil=True)
def _pattern_at(texture: FloatArray, x: float, y: float) -> float:  # pragma: no cover - compiled
    i, j = int(np.floor(x)), int(np.floor(y))
    a, b = x - i, y - j
    i0, j0, i1, j1 = i & _MASK, j & _MASK, (i + 1) & _MASK, (j + 1) & _MASK
    near = texture[i0, j0] * (1.0 - b) + texture[i0, j1] * b
    far = texture[i1, j0] * (1.0 - b) + texture[i1, j1] * b
    value: float = near * (1.0 - a) + far * a
    return value


@numba.njit(cache=True, nogil=True)
def _texture_gain(
    texture: FloatArray, texel_mm: float, grain: float, owner: int, x: float, y: float, z: float
) -> float:  # pragma: no cover - compiled
    """Factor on a surface's albedo; each thing cuts its own oblique slice out of the same pattern."""
    if grain == 0.0:
        return 1.0
    shift = 97.3 * owner
    value = _pattern_at(texture, (x + 0.36 * z) / texel_mm + shift, (y + 0.61 * z) / texel_mm + 1.7 * shift)
    return max(1.0 + grain * value, 0.05)


@numba.njit(cache=True, nogil=True)
def room_light(
    slopes: FloatArray,
    rotation: FloatArray,
    eye: FloatArray,
    corners: FloatArray,
    bounds: FloatArray,
    links: IntArray,
    normals: FloatArray,
    materials: IntArray,
    looks: FloatArray,
    texture: FloatArray,
    texel_mm: float,
    lamp: FloatArray,
    lamp_share: float,
    level_dn: FloatArray,
    picture: FloatArray,
) -> None:  # pragma: no cover - compiled
    """Fill a picture with what the camera sees by the light of the room.

    Parameters
    ----------
    slopes : (rows, columns, 2) array
        x/z and y/z of the camera's rays.
    rotation : (3, 3) array
        From the camera's axes to the bed's.
    eye : (3,) array
        The camera in the bed frame, mm.
    lamp : (3,) array
        Unit vector towards the lamp, bed frame.
    lamp_share
        Share of the light that comes from the lamp; the rest comes from everywhere.
    level_dn : (3,) array
        Grey levels of blue, green and red of a white surface that faces the lamp.
    picture : (rows, columns, 3) array
        The answer, in grey levels.
    """
    stack = np.empty(STACK_DEPTH, dtype=np.int32)
    ox, oy, oz = eye[0], eye[1], eye[2]
    bed_shade = 1.0 - lamp_share + lamp_share * max(lamp[2], 0.0)
    for row in range(slopes.shape[0]):
        for column in range(slopes.shape[1]):
            sx, sy = slopes[row, column, 0], slopes[row, column, 1]
            dx = rotation[0, 0] * sx + rotation[0, 1] * sy + rotation[0, 2]
            dy = rotation[1, 0] * sx + rotation[1, 1] * sy + rotation[1, 2]
            dz = rotation[2, 0] * sx + rotation[2, 1] * sy + rotation[2, 2]
            ground = -oz / dz if dz < 0.0 else np.inf
            t, found = cast(ox, oy, oz, dx, dy, dz, 0.0, ground, False, corners, bounds, links, stack)
            if t == np.inf:
                for channel in range(3):
                    picture[row, column, channel] = 0.0
                continue
            owner, shade = 0, bed_shade
            if found >= 0:
                owner = materials[found]
                facing = normals[found, 0] * lamp[0] + normals[found, 1] * lamp[1] + normals[found, 2] * lamp[2]
                shade = 1.0 - lamp_share + lamp_share * max(facing, 0.0)
            shade *= _texture_gain(texture, texel_mm, looks[owner, 3], owner, ox + t * dx, oy + t * dy, oz + t * dz)
            for channel in range(3):
                picture[row, column, channel] = level_dn[channel] * looks[owner, channel] * shade


@numba.njit(cache=True, nogil=True)
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
    speckle: float,
    seed: int,
    table: FloatArray,
    corners: FloatArray,
    bounds: FloatArray,
    links: IntArray,
    normals: FloatArray,
    materials: IntArray,
    looks: FloatArray,
    texture: FloatArray,
    texel_mm: float,
    ceilings: FloatArray,
    ceiling_x: float,
    ceiling_y: float,
    cell_mm: float,
    slack_mm: float,
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
    speckle
        Sigma of the logarithm of the speckle's factor, whose mean is 1.
    slack_mm
        How far above the ceiling a crossing may be and its pixel still receive light.
    band : (rows, columns) array
        Grey levels; row 0 is row ``first_row`` of the picture.

    Returns
    -------
    int
        Number of camera rays that were cast.
    """
    stack = np.empty(STACK_DEPTH, dtype=np.int32)
    state = np.uint64(seed)
    ox, oy, oz = eye[0], eye[1], eye[2]
    reach = REACH_WIDTHS * width_mm
    steps_x, steps_y = ceilings.shape
    cast_rays = 0
    for i in range(pixels.shape[0]):
        sx, sy, depth = rays[i, 0], rays[i, 1], rays[i, 2]
        dx = rotation[0, 0] * sx + rotation[0, 1] * sy + rotation[0, 2]
        dy = rotation[1, 0] * sx + rotation[1, 1] * sy + rotation[1, 2]
        dz = rotation[2, 0] * sx + rotation[2, 1] * sy + rotation[2, 2]
        cell_x = int(np.floor((ox + depth * dx - ceiling_x) / cell_mm))
        cell_y = int(np.floor((oy + depth * dy - ceiling_y) / cell_mm))
        ceiling = 0.0
        if 0 <= cell_x < steps_x and 0 <= cell_y < steps_y:
            ceiling = ceilings[cell_x, cell_y]
        crossing = oz + depth * dz
        if crossing > ceiling + slack_mm or crossing < -slack_mm:
            continue
        cast_rays += 1
        ground = -oz / dz if dz < 0.0 else np.inf
        t, found = cast(ox, oy, oz, dx, dy, dz, 0.0, ground, False, corners, bounds, links, stack)
        if t == np.inf:
            continue
        x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
        lx, ly, lz = x - source[0], y - source[1], z - source[2]
        off = lx * sheet_normal[0] + ly * sheet_normal[1] + lz * sheet_normal[2]
        if abs(off) > reach:
            continue
        owner, nx, ny, nz = 0, 0.0, 0.0, 1.0
        if found >= 0:
            owner = materials[found]
            nx, ny, nz = normals[found, 0], normals[found, 1], normals[found, 2]
        distance = np.sqrt(lx * lx + ly * ly + lz * lz)
        facing = -(lx * nx + ly * ny + lz * nz) / distance
        if facing <= 0.0:
            continue
        _, blocker = cast(
            source[0], source[1], source[2], lx, ly, lz, 0.0, 1.0 - 1e-6, True, corners, bounds, links, stack
        )
        if blocker >= 0:
            continue
        light = brightness_dn * facing * REFERENCE_MM / distance * np.exp(-0.5 * (off / width_mm) ** 2)
        light *= looks[owner, 2] * _texture_gain(texture, texel_mm, looks[owner, 3], owner, x, y, z)
        if speckle > 0.0:
            state = next_random(state)
            light *= np.exp(speckle * to_normal(table, state >> np.uint64(52)) - 0.5 * speckle * speckle)
        band[pixels[i, 0] - first_row, pixels[i, 1]] += light
    return cast_rays
