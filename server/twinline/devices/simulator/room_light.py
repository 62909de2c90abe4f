"""What the camera sees by the light of the room: compiled loops over cells of a few pixels.

Even cells are filled by interpolation between their corners, and their pattern is looked up for each pixel. Where
corners disagree a ray is cast for every pixel's corner, and where those disagree too, several within the pixel. Only
there the blur of the lens is worth its time, since everything else changes slowly.
"""

import numpy as np

from twinline.arrays import FloatArray, IntArray
from twinline.devices.simulator.compiled import loop
from twinline.devices.simulator.room_cells import EVEN, RAYS, between, follow
from twinline.devices.simulator.solids import OWNER, Solids, grain_at, light_at, plain_albedo_at, print_at

_EDGE_SHARE = 0.2
_SAMPLES, _STRIDE = 5, 2


@loop
def fill_patches(
    solids: Solids,
    slopes: FloatArray,
    rotation: FloatArray,
    eye: FloatArray,
    level_dn: FloatArray,
    found: IntArray,
    places: FloatArray,
    colours: FloatArray,
    kinds: IntArray,
    patch_of: IntArray,
    patches: FloatArray,
    grid: FloatArray,
    stack: FloatArray,
) -> None:  # pragma: no cover - compiled
    """Fill the cells that have patches, (n, step, step, 3) grey levels, without blur.

    ``grid`` is scratch memory, (step + 1, step + 1, 4).
    """
    _, _, faces, looks, texture, _, _, print_share, numbers = solids
    step = patches.shape[1]
    for i in range(kinds.shape[0]):
        for j in range(kinds.shape[1]):
            if patch_of[i, j] < 0:
                continue
            patch = patches[patch_of[i, j]]
            if kinds[i, j] == RAYS:
                _fill_with_rays(solids, slopes, rotation, eye, level_dn, i, j, grid, patch, stack)
                continue
            k = found[i, j] if kinds[i, j] == EVEN else -1
            for row in range(step):
                for column in range(step):
                    p, q = (row + 0.5) / step, (column + 0.5) / step
                    x, y = between(places, i, j, p, q, 0), between(places, i, j, p, q, 1)
                    gain = print_at(faces, print_share, numbers, k, x, y)
                    if gain < 0.0:
                        owner = int(faces[k, OWNER]) if k >= 0 else 0
                        z = between(places, i, j, p, q, 2)
                        gain = grain_at(looks, texture, numbers, owner, x, y, z)
                    for channel in range(3):
                        patch[row, column, channel] = gain * between(colours, i, j, p, q, channel)


@loop
def _look(
    solids: Solids,
    rotation: FloatArray,
    eye: FloatArray,
    level_dn: FloatArray,
    sx: float,
    sy: float,
    stack: FloatArray,
) -> tuple[float, float, float, float]:  # pragma: no cover - compiled
    """Grey levels of blue, green and red that a ray finds without pattern and print, and the factor of those."""
    corners, nodes, faces, looks, texture, _, bed_light, print_share, numbers = solids
    k, x, y, z = follow(corners, nodes, rotation, eye, sx, sy, stack)
    if k == -2:
        return 0.0, 0.0, 0.0, 1.0
    light = light_at(corners, faces, bed_light, numbers, k, x, y, z)
    blue, green, red = light * level_dn[0], light * level_dn[1], light * level_dn[2]
    printed = print_at(faces, print_share, numbers, k, x, y)
    if printed >= 0.0:
        return blue, green, red, printed
    if k < 0:
        grain = grain_at(looks, texture, numbers, 0, x, y, z)
        return blue * looks[0, 0], green * looks[0, 1], red * looks[0, 2], grain
    grain = grain_at(looks, texture, numbers, int(faces[k, OWNER]), x, y, z)
    return (
        blue * plain_albedo_at(corners, faces, k, x, y, z, 0),
        green * plain_albedo_at(corners, faces, k, x, y, z, 1),
        red * plain_albedo_at(corners, faces, k, x, y, z, 2),
        grain,
    )


@loop
def _look_at_corner(
    solids: Solids,
    slopes: FloatArray,
    rotation: FloatArray,
    eye: FloatArray,
    level_dn: FloatArray,
    i: int,
    j: int,
    row: int,
    column: int,
    grid: FloatArray,
    stack: FloatArray,
) -> None:  # pragma: no cover - compiled
    """Fill in what is seen through the corner of a pixel, unless it is known; unknown is a negative factor."""
    if grid[row, column, 3] >= 0.0:
        return
    p, q = row / (grid.shape[0] - 1), column / (grid.shape[1] - 1)
    sx, sy = between(slopes, i, j, p, q, 0), between(slopes, i, j, p, q, 1)
    grid[row, column, 0], grid[row, column, 1], grid[row, column, 2], grid[row, column, 3] = _look(
        solids, rotation, eye, level_dn, sx, sy, stack
    )


@loop
def _contrast(grid: FloatArray, row: int, column: int, size: int) -> float:  # pragma: no cover - compiled
    """Difference between the corners of a square of pixels, as a share of the brightest."""
    low, high = np.inf, 1e-9
    for r in (row, row + size):
        for c in (column, column + size):
            total = grid[r, c, 0] + grid[r, c, 1] + grid[r, c, 2]
            low, high = min(low, total), max(high, total)
    return (high - low) / high


@loop
def _fill_with_rays(
    solids: Solids,
    slopes: FloatArray,
    rotation: FloatArray,
    eye: FloatArray,
    level_dn: FloatArray,
    i: int,
    j: int,
    grid: FloatArray,
    patch: FloatArray,
    stack: FloatArray,
) -> None:  # pragma: no cover - compiled
    """Cast rays through every other corner of a cell's pixels, where those disagree through all, and so on."""
    step = patch.shape[0]
    for row in range(step + 1):
        for column in range(step + 1):
            grid[row, column, 3] = -1.0
    for top in range(0, step, 2):
        for left in range(0, step, 2):
            # The last row and column of an odd number of pixels have no neighbours.
            size = 2 if max(top, left) + 2 <= step else 1
            for r in (top, top + size):
                for c in (left, left + size):
                    _look_at_corner(solids, slopes, rotation, eye, level_dn, i, j, r, c, grid, stack)
            even = _contrast(grid, top, left, size) <= _EDGE_SHARE
            for row in range(top, min(top + 2, step)):
                for column in range(left, min(left + 2, step)):
                    if even and size == 2:
                        _blend(grid, top, left, (row - top + 0.5) / 2, (column - left + 0.5) / 2, 2, patch[row, column])
                        continue
                    for r in (row, row + 1):
                        for c in (column, column + 1):
                            _look_at_corner(solids, slopes, rotation, eye, level_dn, i, j, r, c, grid, stack)
                    _blend(grid, row, column, 0.5, 0.5, 1, patch[row, column])
                    if _contrast(grid, row, column, 1) > _EDGE_SHARE:
                        _add_samples(solids, slopes, rotation, eye, level_dn, i, j, row, column, patch, stack)


@loop
def _blend(
    grid: FloatArray, row: int, column: int, p: float, q: float, size: int, pixel: FloatArray
) -> None:  # pragma: no cover - compiled
    """Interpolate between the corners of a square of pixels, pattern included."""
    a, b = (1.0 - p) * (1.0 - q), (1.0 - p) * q
    c, d = p * (1.0 - q), p * q
    gain = a * grid[row, column, 3] + b * grid[row, column + size, 3]
    gain += c * grid[row + size, column, 3] + d * grid[row + size, column + size, 3]
    for channel in range(3):
        level = a * grid[row, column, channel] + b * grid[row, column + size, channel]
        level += c * grid[row + size, column, channel] + d * grid[row + size, column + size, channel]
        pixel[channel] = gain * level


@loop
def _add_samples(
    solids: Solids,
    slopes: FloatArray,
    rotation: FloatArray,
    eye: FloatArray,
    level_dn: FloatArray,
    i: int,
    j: int,
    row: int,
    column: int,
    patch: FloatArray,
    stack: FloatArray,
) -> None:  # pragma: no cover - compiled
    """Average a pixel that an edge crosses over rays within it and over its corners, which count as one ray."""
    step = patch.shape[0]
    share = 1.0 / (_SAMPLES + 1)
    for channel in range(3):
        patch[row, column, channel] *= share
    for n in range(_SAMPLES):
        # No two in the same row or column, so that an edge along either is placed as well as their number allows.
        p = (row + (n + 0.5) / _SAMPLES) / step
        q = (column + (n * _STRIDE % _SAMPLES + 0.5) / _SAMPLES) / step
        sx, sy = between(slopes, i, j, p, q, 0), between(slopes, i, j, p, q, 1)
        blue, green, red, gain = _look(solids, rotation, eye, level_dn, sx, sy, stack)
        patch[row, column, 0] += share * gain * blue
        patch[row, column, 1] += share * gain * green
        patch[row, column, 2] += share * gain * red


@loop
def soften_edges(
    kinds: IntArray, patch_of: IntArray, patches: FloatArray, kernel: FloatArray, softened: FloatArray
) -> None:  # pragma: no cover - compiled
    """Blur the patches at and beside edges as the lens does; ``softened`` comes as a copy of them."""
    rows, columns = kinds.shape
    step = patches.shape[1]
    half = kernel.size // 2
    for i in range(rows):
        for j in range(columns):
            if patch_of[i, j] < 0 or not _beside_edge(kinds, i, j):
                continue
            answer = softened[patch_of[i, j]]
            answer[:] = 0.0
            for p in range(-half, step + half):
                ii = min(max(i + (p + step) // step - 1, 0), rows - 1)
                for q in range(-half, step + half):
                    jj = min(max(j + (q + step) // step - 1, 0), columns - 1)
                    source = patches[patch_of[ii, jj], p % step, q % step]
                    for row in range(max(p - half, 0), min(p + half + 1, step)):
                        for column in range(max(q - half, 0), min(q + half + 1, step)):
                            weight = kernel[p - row + half] * kernel[q - column + half]
                            for channel in range(3):
                                answer[row, column, channel] += weight * source[channel]


@loop
def _beside_edge(kinds: IntArray, i: int, j: int) -> bool:  # pragma: no cover - compiled
    for ii in range(max(i - 1, 0), min(i + 2, kinds.shape[0])):
        for jj in range(max(j - 1, 0), min(j + 2, kinds.shape[1])):
            if kinds[ii, jj] == RAYS:
                return True
    return False
