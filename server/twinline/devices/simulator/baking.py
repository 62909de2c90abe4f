"""How much of the room's light reaches each place, found once a scene: the things do not move, only the camera does.

The room has one broad lamp and light from everywhere. Where something stands in the way of a part of either there is
a soft shadow, as below the edge of a thing on the bed.
"""

from dataclasses import dataclass

import cv2
import numba
import numpy as np

from twinline.arrays import BoolArray, FloatArray, IntArray
from twinline.devices.simulator.bvh import Bvh, ray_stack
from twinline.devices.simulator.compiled import loop
from twinline.devices.simulator.raycast import cast, first_hits

LAMP = (0.2800, -0.3600, 0.8900)
LAMP_SHARE = 0.5
"""Share of the light on a surface facing the lamp that comes from it; the rest comes from everywhere."""
_LAMP_SPREAD = 0.16
_LAMP_RAYS = 20
_SKY_RAYS = 36
_BED_BACK = 0.35
"""Share of the light from everywhere that the bed gives back to what looks at it."""
_SMOOTH_COSINE = 0.8
_MAX_RAYS = 8_000_000
_MAX_BED_CELLS = 60_000
_BED_CELL_MM = 1.0
_LIFT_MM = 1e-3

_LAMP_UP = LAMP[2] / (LAMP[0] ** 2 + LAMP[1] ** 2 + LAMP[2] ** 2) ** 0.5
OPEN_BED_LIGHT = 1.0 - LAMP_SHARE + LAMP_SHARE * _LAMP_UP
"""Light on the bed with nothing around."""


@dataclass(frozen=True, eq=False)
class BakedLight:
    """Light of the room, 1 on an open surface that faces the lamp.

    Attributes
    ----------
    corners : (triangles, 3) array of float32
        At the corners of the triangles, in tree order.
    bed : (n, m) array of float32
        On the bed along x and y around the things; elsewhere it is `OPEN_BED_LIGHT`.
    bed_corner_mm : (float, float)
        Place x, y of ``bed[0, 0]``.
    bed_cell_mm
        Distance of neighbours in ``bed``.
    """

    corners: FloatArray
    bed: FloatArray
    bed_corner_mm: tuple[float, float]
    bed_cell_mm: float


def bake_light(bvh: Bvh, normals: FloatArray, highest_mm: float) -> BakedLight:
    """Find the light of the room on all triangles of a tree and on the bed around them.

    Parameters
    ----------
    normals : (triangles, 3) array
        Outward unit normals in tree order.
    highest_mm
        Height of the highest thing.
    """
    if not len(normals):
        return BakedLight(np.empty((0, 3), np.float32), np.full((2, 2), OPEN_BED_LIGHT, np.float32), (0.0, 0.0), 1.0)
    first = bvh.corners[:, :3]
    points = np.stack([first, first + bvh.corners[:, 3:6], first + bvh.corners[:, 6:9]], axis=1).reshape(-1, 3)
    same, index = np.unique(np.round(points, 6), axis=0, return_inverse=True)
    smooth = _corner_normals(index.ravel(), len(same), normals)
    # Corners of an unbroken surface share place and normal, and one answer serves them all.
    both, which = np.unique(np.round(np.column_stack([points, smooth]), 4), axis=0, return_inverse=True)
    places, directions = np.ascontiguousarray(both[:, :3]), np.ascontiguousarray(both[:, 3:])
    rays = _LAMP_RAYS + _SKY_RAYS
    # A huge mesh gets fewer rays a corner: its corners lie closer, and the eye averages over them.
    share = min(1.0, _MAX_RAYS / (rays * len(places)))
    corners = _light_at(places, directions, bvh, share)[which.ravel()].reshape(-1, 3)

    margin = 12.0 + 1.2 * highest_mm
    low = bvh.bounds[0, :2] - margin
    size = bvh.bounds[0, 3:5] + margin - low
    cell = max(_BED_CELL_MM, float(np.sqrt(size[0] * size[1] / _MAX_BED_CELLS)))
    steps = np.ceil(size / cell).astype(np.intp) + 1
    x, y = np.meshgrid(low[0] + cell * np.arange(steps[0]), low[1] + cell * np.arange(steps[1]), indexing="ij")
    bed_places = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    up = np.broadcast_to((0.0, 0.0, 1.0), bed_places.shape)
    bed = _light_at(bed_places, np.ascontiguousarray(up), bvh, 1.0).reshape(x.shape)
    above, _ = first_hits(bvh, bed_places, up)
    bed = _spread_below(bed, np.isfinite(above).reshape(x.shape))
    return BakedLight(corners, bed, (float(low[0]), float(low[1])), cell)


def _spread_below(light: FloatArray, covered: BoolArray) -> FloatArray:
    """Carry the bed's light a little way below the things, so that interpolation draws no dark seam around them."""
    for _ in range(3):
        known = (~covered).astype(np.float32)
        total = cv2.boxFilter(light * known, -1, (3, 3), normalize=False, borderType=cv2.BORDER_REPLICATE)
        count = cv2.boxFilter(known, -1, (3, 3), normalize=False, borderType=cv2.BORDER_REPLICATE)
        reached = covered & (count > 0.5)
        light = np.where(reached, total / np.maximum(count, 1.0), light)
        covered = covered & ~reached
    return np.ascontiguousarray(light, dtype=np.float32)


def _light_at(points: FloatArray, normals: FloatArray, bvh: Bvh, share: float) -> FloatArray:
    light = np.empty(len(points), dtype=np.float32)
    lamp = _lamp_directions(max(int(_LAMP_RAYS * share), 4))
    sky = _sky_directions(max(int(_SKY_RAYS * share), 8))
    _gather(points, normals, lamp, sky, bvh.corners, bvh.nodes, ray_stack(), light)
    return light


def _spiral(count: int) -> tuple[FloatArray, FloatArray]:
    """Evenly spread places in the unit disc: radius and angle (H. Vogel's sunflower)."""
    n = np.arange(count)
    return np.sqrt((n + 0.5) / count), n * np.pi * (3.0 - np.sqrt(5.0))


def _lamp_directions(count: int) -> FloatArray:
    radius, angle = _spiral(count)
    lamp = np.array(LAMP) / np.linalg.norm(LAMP)
    across = np.cross(lamp, (0.0, 1.0, 0.0))
    across /= np.linalg.norm(across)
    other = np.cross(lamp, across)
    spread = _LAMP_SPREAD * radius[:, np.newaxis]
    rays = lamp + spread * (np.cos(angle)[:, np.newaxis] * across + np.sin(angle)[:, np.newaxis] * other)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def _sky_directions(count: int) -> FloatArray:
    """About z, as densely as light of the same brightness from everywhere falls on a surface (cosine law)."""
    radius, angle = _spiral(count)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - radius**2)])


@numba.njit(cache=True, nogil=True)
def _corner_normals(index: IntArray, count: int, normals: FloatArray) -> FloatArray:  # pragma: no cover - compiled
    """Normal at each corner: the mean over the triangles that meet there without an edge between, (3 n, 3)."""
    starts = np.zeros(count + 1, dtype=np.int64)
    for i in range(index.size):
        starts[index[i] + 1] += 1
    for i in range(count):
        starts[i + 1] += starts[i]
    filled = starts[:-1].copy()
    members = np.empty(index.size, dtype=np.int64)
    for i in range(index.size):
        members[filled[index[i]]] = i // 3
        filled[index[i]] += 1
    smooth = np.empty((index.size, 3))
    for i in range(index.size):
        own = normals[i // 3]
        x, y, z = 0.0, 0.0, 0.0
        for j in range(starts[index[i]], starts[index[i] + 1]):
            other = normals[members[j]]
            if own[0] * other[0] + own[1] * other[1] + own[2] * other[2] >= _SMOOTH_COSINE:
                x, y, z = x + other[0], y + other[1], z + other[2]
        length = np.sqrt(x * x + y * y + z * z)
        smooth[i, 0], smooth[i, 1], smooth[i, 2] = x / length, y / length, z / length
    return smooth


@loop
def _gather(
    points: FloatArray,
    normals: FloatArray,
    lamp: FloatArray,
    sky: FloatArray,
    corners: FloatArray,
    nodes: FloatArray,
    stack: FloatArray,
    light: FloatArray,
) -> None:  # pragma: no cover - compiled
    for i in range(points.shape[0]):
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        ox = points[i, 0] + _LIFT_MM * nx
        oy = points[i, 1] + _LIFT_MM * ny
        oz = max(points[i, 2] + _LIFT_MM * nz, _LIFT_MM)
        direct = 0.0
        for k in range(lamp.shape[0]):
            facing = lamp[k, 0] * nx + lamp[k, 1] * ny + lamp[k, 2] * nz
            if facing <= 0.0:
                continue
            _, found = cast(ox, oy, oz, lamp[k, 0], lamp[k, 1], lamp[k, 2], 0.0, np.inf, True, corners, nodes, stack)
            if found < 0:
                direct += facing
        # Axes about the normal: T. Duff et al., "Building an orthonormal basis, revisited", JCGT 6 (2017).
        sign = 1.0 if nz >= 0.0 else -1.0
        a = -1.0 / (sign + nz)
        b = nx * ny * a
        around = 0.0
        for k in range(sky.shape[0]):
            u, v, w = sky[k, 0], sky[k, 1], sky[k, 2]
            dx = u * (1.0 + sign * nx * nx * a) + v * b + w * nx
            dy = u * sign * b + v * (sign + ny * ny * a) + w * ny
            dz = -u * sign * nx - v * ny + w * nz
            _, found = cast(ox, oy, oz, dx, dy, dz, 0.0, np.inf, True, corners, nodes, stack)
            if found < 0:
                around += 1.0 if dz > 0.0 else _BED_BACK
        light[i] = LAMP_SHARE * direct / lamp.shape[0] + (1.0 - LAMP_SHARE) * around / sky.shape[0]
