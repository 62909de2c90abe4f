"""The world as compiled loops see it, and what a surface does to light there.

The small functions take arrays one by one: handed over together in a tuple, each call would count references to all of
them, which costs more than following a ray.
"""

from typing import NamedTuple

import numpy as np

from twinline.arrays import FloatArray
from twinline.devices.simulator.compiled import loop

TEXTURE_TEXELS = 512
_MASK = TEXTURE_TEXELS - 1
_LEVEL_COSINE = 0.98

NORMAL, ALBEDO, LIGHT, OWNER, FACE_NUMBERS = 0, 3, 12, 15, 16
"""Columns of ``Solids.faces``."""
TEXEL_MM, HIGHEST_MM, CEILING_X, CEILING_Y, CEILING_CELL_MM = 0, 1, 2, 3, 4
BED_LIGHT_X, BED_LIGHT_Y, BED_LIGHT_CELL_MM, OPEN_BED = 5, 6, 7, 8
PRINT_OWNER, PRINT_COLUMN, PRINT_ROW, NUMBERS = 9, 10, 13, 16
"""Places in ``Solids.numbers``."""


class Solids(NamedTuple):
    """All that compiled loops need to know of a world.

    Attributes
    ----------
    corners, nodes
        The tree of triangles, see `twinline.devices.simulator.bvh.Bvh`.
    faces : (triangles, FACE_NUMBERS) array
        In tree order: normal; blue, green, red albedo of the three corners; the room's light there; number of the
        thing, from 1.
    looks : (things + 1, 4) array
        Blue, green, red albedo and grain; row 0 is the bed.
    texture : (TEXTURE_TEXELS, TEXTURE_TEXELS) array
        Pattern that repeats.
    ceilings : (n, m) array
        See `twinline.devices.simulator.ceiling.Ceiling`.
    bed_light : (n, m) array
        Light of the room on the bed around the things.
    print_share : (rows, columns) array
        The print.
    numbers : (NUMBERS,) array
        Everything else; ``PRINT_COLUMN`` and ``PRINT_ROW`` are three numbers each that turn x, y, 1 into a texel.
    """

    corners: FloatArray
    nodes: FloatArray
    faces: FloatArray
    looks: FloatArray
    texture: FloatArray
    ceilings: FloatArray
    bed_light: FloatArray
    print_share: FloatArray
    numbers: FloatArray


@loop
def ceiling_at(ceilings: FloatArray, numbers: FloatArray, x: float, y: float) -> float:  # pragma: no cover - compiled
    """Height above which there is only air near x, y."""
    i = int(np.floor((x - numbers[CEILING_X]) / numbers[CEILING_CELL_MM]))
    j = int(np.floor((y - numbers[CEILING_Y]) / numbers[CEILING_CELL_MM]))
    height = 0.0
    if 0 <= i < ceilings.shape[0] and 0 <= j < ceilings.shape[1]:
        height = ceilings[i, j]
    return height


@loop
def pattern_at(texture: FloatArray, x: float, y: float) -> float:  # pragma: no cover - compiled
    """The repeating pattern between its texels."""
    i, j = int(np.floor(x)), int(np.floor(y))
    a, b = x - i, y - j
    i0, j0, i1, j1 = i & _MASK, j & _MASK, (i + 1) & _MASK, (j + 1) & _MASK
    near = texture[i0, j0] * (1.0 - b) + texture[i0, j1] * b
    far = texture[i1, j0] * (1.0 - b) + texture[i1, j1] * b
    value: float = near * (1.0 - a) + far * a
    return value


@loop
def _grid_at(grid: FloatArray, row: float, column: float) -> float:  # pragma: no cover - compiled
    """A grid between its points; the caller keeps within."""
    i, j = int(row), int(column)
    a, b = row - i, column - j
    near = grid[i, j] * (1.0 - b) + grid[i, j + 1] * b
    far = grid[i + 1, j] * (1.0 - b) + grid[i + 1, j + 1] * b
    value: float = near * (1.0 - a) + far * a
    return value


@loop
def grain_at(
    looks: FloatArray, texture: FloatArray, numbers: FloatArray, owner: int, x: float, y: float, z: float
) -> float:  # pragma: no cover - compiled
    """Factor on a surface's albedo; each thing cuts its own oblique slice out of the same pattern."""
    grain = looks[owner, 3]
    if grain == 0.0:
        return 1.0
    shift = 97.3 * owner
    texel = numbers[TEXEL_MM]
    value = pattern_at(texture, (x + 0.36 * z) / texel + shift, (y + 0.61 * z) / texel + 1.7 * shift)
    factor: float = max(1.0 + grain * value, 0.05)
    return factor


@loop
def bed_light_at(
    bed_light: FloatArray, numbers: FloatArray, x: float, y: float
) -> float:  # pragma: no cover - compiled
    """Light of the room on the bed."""
    row = (x - numbers[BED_LIGHT_X]) / numbers[BED_LIGHT_CELL_MM]
    column = (y - numbers[BED_LIGHT_Y]) / numbers[BED_LIGHT_CELL_MM]
    if not (0.0 <= row < bed_light.shape[0] - 1 and 0.0 <= column < bed_light.shape[1] - 1):
        open_bed: float = numbers[OPEN_BED]
        return open_bed
    return _grid_at(bed_light, row, column)


@loop
def _weights(
    corners: FloatArray, k: int, x: float, y: float, z: float
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Shares of a triangle's second and third corner in a point on it."""
    e1x, e1y, e1z = corners[k, 3], corners[k, 4], corners[k, 5]
    e2x, e2y, e2z = corners[k, 6], corners[k, 7], corners[k, 8]
    px, py, pz = x - corners[k, 0], y - corners[k, 1], z - corners[k, 2]
    aa, ab = e1x * e1x + e1y * e1y + e1z * e1z, e1x * e2x + e1y * e2y + e1z * e2z
    bb = e2x * e2x + e2y * e2y + e2z * e2z
    pa, pb = px * e1x + py * e1y + pz * e1z, px * e2x + py * e2y + pz * e2z
    area = aa * bb - ab * ab
    if area <= 0.0:
        return 0.0, 0.0
    return (bb * pa - ab * pb) / area, (aa * pb - ab * pa) / area


@loop
def print_at(
    faces: FloatArray, print_share: FloatArray, numbers: FloatArray, k: int, x: float, y: float
) -> float:  # pragma: no cover - compiled
    """Share of light that the print gives back at a point of triangle k; negative where it has none."""
    if k < 0 or faces[k, OWNER] != numbers[PRINT_OWNER] or faces[k, NORMAL + 2] < _LEVEL_COSINE:
        return -1.0
    column = numbers[PRINT_COLUMN] * x + numbers[PRINT_COLUMN + 1] * y + numbers[PRINT_COLUMN + 2]
    row = numbers[PRINT_ROW] * x + numbers[PRINT_ROW + 1] * y + numbers[PRINT_ROW + 2]
    if not (0.0 <= row < print_share.shape[0] - 1 and 0.0 <= column < print_share.shape[1] - 1):
        return -1.0
    return _grid_at(print_share, row, column)


@loop
def plain_albedo_at(
    corners: FloatArray, faces: FloatArray, k: int, x: float, y: float, z: float, channel: int
) -> float:  # pragma: no cover - compiled
    """Share of one colour's light that comes back from a point of triangle k, without grain and print."""
    b, c = _weights(corners, k, x, y, z)
    at = ALBEDO + channel
    share: float = (1.0 - b - c) * faces[k, at] + b * faces[k, at + 3] + c * faces[k, at + 6]
    return share


@loop
def albedo_at(
    corners: FloatArray,
    faces: FloatArray,
    looks: FloatArray,
    texture: FloatArray,
    print_share: FloatArray,
    numbers: FloatArray,
    k: int,
    x: float,
    y: float,
    z: float,
    channel: int,
) -> float:  # pragma: no cover - compiled
    """Share of one colour's light that comes back from a point of triangle k, or of the bed where k is negative."""
    if k < 0:
        bed: float = looks[0, channel] * grain_at(looks, texture, numbers, 0, x, y, z)
        return bed
    printed = print_at(faces, print_share, numbers, k, x, y)
    if printed >= 0.0:
        return printed
    grain = grain_at(looks, texture, numbers, int(faces[k, OWNER]), x, y, z)
    return plain_albedo_at(corners, faces, k, x, y, z, channel) * grain


@loop
def light_at(
    corners: FloatArray,
    faces: FloatArray,
    bed_light: FloatArray,
    numbers: FloatArray,
    k: int,
    x: float,
    y: float,
    z: float,
) -> float:  # pragma: no cover - compiled
    """Light of the room at a point of triangle k, or of the bed where k is negative."""
    if k < 0:
        return bed_light_at(bed_light, numbers, x, y)
    b, c = _weights(corners, k, x, y, z)
    light: float = (1.0 - b - c) * faces[k, LIGHT] + b * faces[k, LIGHT + 1] + c * faces[k, LIGHT + 2]
    return light
