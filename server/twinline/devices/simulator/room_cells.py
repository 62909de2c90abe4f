"""The picture in cells of a few pixels, sorted by what the rays through their corners meet.

A cell whose corners see the same even surface can be filled by interpolation: OPEN cells show the bed in full light,
BED cells the bed in half-shade, EVEN cells a thing. Where corners disagree (RAYS) there is an edge.
"""

import numpy as np

from twinline.arrays import FloatArray, IntArray
from twinline.devices.simulator.compiled import loop
from twinline.devices.simulator.raycast import cast
from twinline.devices.simulator.solids import (
    HIGHEST_MM,
    NORMAL,
    OPEN_BED,
    OWNER,
    Solids,
    ceiling_at,
    light_at,
    plain_albedo_at,
    print_at,
)

OPEN, BED, EVEN, RAYS = 0, 1, 2, 3
_STEP_MM = 6.0
_EVEN_COSINE = 0.92
_EVEN_MM = 0.3
_EVEN_LIGHT = 0.04


@loop
def _may_meet(
    ceilings: FloatArray, numbers: FloatArray, gx: float, gy: float, ox: float, oy: float, oz: float
) -> bool:  # pragma: no cover - compiled
    """Whether a ray to the bed at gx, gy may meet a thing before: the ceiling is looked up along its way."""
    across_x, across_y = (ox - gx) / oz, (oy - gy) / oz
    steps = int(numbers[HIGHEST_MM] * max(abs(across_x), abs(across_y)) / _STEP_MM) + 1
    rise = numbers[HIGHEST_MM] / steps
    for i in range(steps):
        z = i * rise
        if ceiling_at(ceilings, numbers, gx + z * across_x, gy + z * across_y) > z:
            return True
    return False


@loop
def follow(
    corners: FloatArray,
    nodes: FloatArray,
    rotation: FloatArray,
    eye: FloatArray,
    sx: float,
    sy: float,
    stack: FloatArray,
) -> tuple[int, float, float, float]:  # pragma: no cover - compiled
    """Triangle that a camera ray meets (-1 the bed, -2 nothing) and the place."""
    dx = rotation[0, 0] * sx + rotation[0, 1] * sy + rotation[0, 2]
    dy = rotation[1, 0] * sx + rotation[1, 1] * sy + rotation[1, 2]
    dz = rotation[2, 0] * sx + rotation[2, 1] * sy + rotation[2, 2]
    ground = -eye[2] / dz if dz < 0.0 else np.inf
    t, found = cast(eye[0], eye[1], eye[2], dx, dy, dz, 0.0, ground, False, corners, nodes, stack)
    if t == np.inf:
        return -2, 0.0, 0.0, 0.0
    return found, eye[0] + t * dx, eye[1] + t * dy, eye[2] + t * dz


@loop
def meet_nodes(
    solids: Solids,
    slopes: FloatArray,
    ground: FloatArray,
    rotation: FloatArray,
    eye: FloatArray,
    level_dn: FloatArray,
    found: IntArray,
    places: FloatArray,
    colours: FloatArray,
    light: FloatArray,
    stack: FloatArray,
) -> None:  # pragma: no cover - compiled
    """See what stands at the corners of the cells.

    Parameters
    ----------
    slopes : (n, m, 2) array
        x/z and y/z of the camera's rays through the corners.
    ground : (n, m, 2) array
        Where they meet the bed, against the eye's foot point; NaN where they do not.
    found : (n, m) array of int
        Answer: triangle; -1 the bed, -2 nothing, -3 the bed, seen past things that are near.
    places : (n, m, 3) array
        Answer: the place, bed frame, mm.
    colours : (n, m, 3) array
        Answer: grey levels of blue, green and red without pattern and print.
    light : (n, m) array
        Answer: the room's light.
    """
    corners, nodes, faces, looks, _, ceilings, bed_light, print_share, numbers = solids
    for i in range(slopes.shape[0]):
        for j in range(slopes.shape[1]):
            gx, gy = ground[i, j, 0] + eye[0], ground[i, j, 1] + eye[1]
            known = gx == gx
            k, x, y, z = -1, gx, gy, 0.0
            near = not known or _may_meet(ceilings, numbers, gx, gy, eye[0], eye[1], eye[2])
            if near:
                k, x, y, z = follow(corners, nodes, rotation, eye, slopes[i, j, 0], slopes[i, j, 1], stack)
            found[i, j] = -3 if near and k == -1 else k
            places[i, j, 0], places[i, j, 1], places[i, j, 2] = x, y, z
            light[i, j] = 0.0 if k == -2 else light_at(corners, faces, bed_light, numbers, k, x, y, z)
            printed = print_at(faces, print_share, numbers, k, x, y) >= 0.0
            for channel in range(3):
                albedo = looks[0, channel] if k < 0 else 1.0
                if k >= 0 and not printed:
                    albedo = plain_albedo_at(corners, faces, k, x, y, z, channel)
                colours[i, j, channel] = light[i, j] * level_dn[channel] * albedo


@loop
def sort_cells(
    solids: Solids,
    slopes: FloatArray,
    rotation: FloatArray,
    eye: FloatArray,
    found: IntArray,
    places: FloatArray,
    light: FloatArray,
    kinds: IntArray,
    patch_of: IntArray,
    stack: FloatArray,
) -> int:  # pragma: no cover - compiled
    """Decide how each cell is filled, and number those that are filled beforehand.

    Parameters
    ----------
    kinds : (rows, columns) array of int
        Answer: OPEN, BED, EVEN or RAYS.
    patch_of : (rows, columns) array of int
        Answer: number of the cell's patch; -1 for cells with nothing but bed, far from any edge.

    Returns
    -------
    int
        Number of patches.
    """
    corners, nodes, faces = solids.corners, solids.nodes, solids.faces
    open_light = solids.numbers[OPEN_BED]
    rows, columns = kinds.shape
    patch_of[:] = -1
    for i in range(rows):
        for j in range(columns):
            kinds[i, j] = _kind(
                corners, nodes, faces, slopes, rotation, eye, found, places, light, i, j, open_light, stack
            )
    count = 0
    for i in range(rows):
        for j in range(columns):
            if kinds[i, j] <= BED:
                continue
            # The blur of an edge reaches into its neighbours, and reads from theirs.
            reach = 2 if kinds[i, j] == RAYS else 0
            for ii in range(max(i - reach, 0), min(i + reach + 1, rows)):
                for jj in range(max(j - reach, 0), min(j + reach + 1, columns)):
                    if patch_of[ii, jj] < 0:
                        patch_of[ii, jj] = count
                        count += 1
    return count


@loop
def _kind(
    corners: FloatArray,
    nodes: FloatArray,
    faces: FloatArray,
    slopes: FloatArray,
    rotation: FloatArray,
    eye: FloatArray,
    found: IntArray,
    places: FloatArray,
    light: FloatArray,
    i: int,
    j: int,
    open_light: float,
    stack: FloatArray,
) -> int:  # pragma: no cover - compiled
    a, b, c, d = found[i, j], found[i, j + 1], found[i + 1, j], found[i + 1, j + 1]
    bare = BED
    if light[i, j] == light[i, j + 1] == light[i + 1, j] == light[i + 1, j + 1] == open_light:
        bare = OPEN
    if a == -1 and b == -1 and c == -1 and d == -1:
        return bare
    if max(max(a, b), max(c, d)) < 0:
        if min(min(a, b), min(c, d)) == -2:
            return RAYS
        # Something smaller than a cell may stand between its corners.
        for k in range(5):
            p, q = (0.0, 0.5, 0.5, 0.5, 1.0)[k], (0.5, 0.0, 0.5, 1.0, 0.5)[k]
            sx, sy = between(slopes, i, j, p, q, 0), between(slopes, i, j, p, q, 1)
            if follow(corners, nodes, rotation, eye, sx, sy, stack)[0] != -1:
                return RAYS
        return bare
    if min(min(a, b), min(c, d)) < 0:
        return RAYS
    owner = faces[a, OWNER]
    if faces[b, OWNER] != owner or faces[c, OWNER] != owner or faces[d, OWNER] != owner:
        return RAYS
    for k in (b, c, d):
        cosine = 0.0
        for axis in range(3):
            cosine += faces[a, NORMAL + axis] * faces[k, NORMAL + axis]
        if cosine < _EVEN_COSINE:
            return RAYS
    bend = places[i, j, 2] + places[i + 1, j + 1, 2] - places[i, j + 1, 2] - places[i + 1, j, 2]
    change = light[i, j] + light[i + 1, j + 1] - light[i, j + 1] - light[i + 1, j]
    return EVEN if abs(bend) < _EVEN_MM and abs(change) < _EVEN_LIGHT else RAYS


@loop
def between(values: FloatArray, i: int, j: int, p: float, q: float, axis: int) -> float:  # pragma: no cover - compiled
    """Interpolate within cell i, j: p along the rows, q along the columns."""
    upper = values[i, j, axis] * (1.0 - q) + values[i, j + 1, axis] * q
    lower = values[i + 1, j, axis] * (1.0 - q) + values[i + 1, j + 1, axis] * q
    value: float = upper * (1.0 - p) + lower * p
    return value
