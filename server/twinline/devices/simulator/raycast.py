"""Compiled ray casting: the nearest triangle on a ray, and whether anything stands between two points."""

import numpy as np

from twinline.arrays import FloatArray, IntArray
from twinline.devices.simulator.bvh import Bvh, ray_stack
from twinline.devices.simulator.compiled import loop, loop_without_nan

_EDGE = 1e-9
"""Barycentric slack, so that a ray along the edge of two triangles cannot slip between them."""


@loop_without_nan
def _box_entry(
    nodes: FloatArray, node: int, ox: float, oy: float, oz: float, ix: float, iy: float, iz: float, limit: float
) -> float:  # pragma: no cover - compiled
    """Where a ray enters a box, in units of its direction; infinity where it misses or comes too late."""
    ax, bx = (nodes[node, 0] - ox) * ix, (nodes[node, 3] - ox) * ix
    ay, by = (nodes[node, 1] - oy) * iy, (nodes[node, 4] - oy) * iy
    az, bz = (nodes[node, 2] - oz) * iz, (nodes[node, 5] - oz) * iz
    near = max(max(min(ax, bx), min(ay, by)), max(min(az, bz), 0.0))
    far = min(min(max(ax, bx), max(ay, by)), min(max(az, bz), limit))
    return near if near <= far * (1.0 + 1e-12) else np.inf


@loop
def _triangle_hit(
    corners: FloatArray, k: int, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float
) -> float:  # pragma: no cover - compiled
    """Where a ray meets a triangle, from either side; infinity where it misses.

    T. Moller and B. Trumbore, "Fast, minimum storage ray-triangle intersection", J. Graphics Tools 2 (1997).
    """
    e1x, e1y, e1z = corners[k, 3], corners[k, 4], corners[k, 5]
    e2x, e2y, e2z = corners[k, 6], corners[k, 7], corners[k, 8]
    px, py, pz = dy * e2z - dz * e2y, dz * e2x - dx * e2z, dx * e2y - dy * e2x
    determinant = e1x * px + e1y * py + e1z * pz
    if determinant == 0.0:
        return np.inf
    inverse = 1.0 / determinant
    tx, ty, tz = ox - corners[k, 0], oy - corners[k, 1], oz - corners[k, 2]
    a = (tx * px + ty * py + tz * pz) * inverse
    if a < -_EDGE or a > 1.0 + _EDGE:
        return np.inf
    qx, qy, qz = ty * e1z - tz * e1y, tz * e1x - tx * e1z, tx * e1y - ty * e1x
    b = (dx * qx + dy * qy + dz * qz) * inverse
    if b < -_EDGE or a + b > 1.0 + _EDGE:
        return np.inf
    place: float = (e2x * qx + e2y * qy + e2z * qz) * inverse
    return place


@loop
def _reciprocal(x: float) -> float:  # pragma: no cover - compiled
    # A huge number in place of infinity keeps 0 * inf, which is NaN, out of the box test.
    return 1.0 / x if abs(x) > 1e-300 else 1e300


@loop
def cast(
    ox: float,
    oy: float,
    oz: float,
    dx: float,
    dy: float,
    dz: float,
    first: float,
    last: float,
    any_hit: bool,
    corners: FloatArray,
    nodes: FloatArray,
    stack: FloatArray,
) -> tuple[float, int]:  # pragma: no cover - compiled
    """Meet a ray with the triangles of a tree.

    Parameters
    ----------
    ox, oy, oz, dx, dy, dz
        Origin and direction; the direction's length is the unit of ``first``, ``last`` and the answer.
    first, last
        Only hits strictly between these count.
    any_hit
        Stop at the first triangle found, whichever it is.
    corners, nodes
        The tree, see `twinline.devices.simulator.bvh.Bvh`.
    stack : (STACK_DEPTH, 2) array
        Scratch memory, so that no ray allocates.

    Returns
    -------
    (float, int)
        The place of the hit and the triangle in tree order; ``last`` and -1 where there is none.
    """
    best, found = last, -1
    if nodes.shape[0] == 0:
        return best, found
    ix, iy, iz = _reciprocal(dx), _reciprocal(dy), _reciprocal(dz)
    stack[0, 0], stack[0, 1] = 0.0, _box_entry(nodes, 0, ox, oy, oz, ix, iy, iz, best)
    height = 1
    while height > 0:
        height -= 1
        if not stack[height, 1] < best:
            continue
        node = int(stack[height, 0])
        while True:
            start, count = int(nodes[node, 6]), int(nodes[node, 7])
            if count > 0:
                for k in range(start, start + count):
                    t = _triangle_hit(corners, k, ox, oy, oz, dx, dy, dz)
                    if first < t < best:
                        best, found = t, k
                        if any_hit:
                            return best, found
                break
            near_a = _box_entry(nodes, start, ox, oy, oz, ix, iy, iz, best)
            near_b = _box_entry(nodes, start + 1, ox, oy, oz, ix, iy, iz, best)
            node = start
            if near_b < near_a:
                node, near_a, near_b = start + 1, near_b, near_a
            if near_a == np.inf:
                break
            if near_b != np.inf:
                stack[height, 0], stack[height, 1] = 2 * start + 1 - node, near_b
                height += 1
    return best, found


@loop
def _cast_many(
    origins: FloatArray,
    directions: FloatArray,
    corners: FloatArray,
    nodes: FloatArray,
    stack: FloatArray,
    places: FloatArray,
    found: IntArray,
) -> None:  # pragma: no cover - compiled
    for i in range(len(origins)):
        o, d = origins[i], directions[i]
        places[i], found[i] = cast(o[0], o[1], o[2], d[0], d[1], d[2], 0.0, np.inf, False, corners, nodes, stack)


def first_hits(bvh: Bvh, origins: FloatArray, directions: FloatArray) -> tuple[FloatArray, IntArray]:
    """Nearest triangle on each of many rays.

    Parameters
    ----------
    origins, directions : (n, 3) arrays
        Millimetres.

    Returns
    -------
    (n,) array and (n,) array of int
        Distance in units of the direction's length (infinity where nothing is met), and the index of the triangle in
        the mesh the tree was built from (-1 where nothing is met).
    """
    places, found = np.empty(len(origins)), np.empty(len(origins), dtype=np.int64)
    _cast_many(
        np.ascontiguousarray(origins, dtype=np.float64),
        np.ascontiguousarray(directions, dtype=np.float64),
        bvh.corners,
        bvh.nodes,
        ray_stack(),
        places,
        found,
    )
    hit = found >= 0
    indices = np.full(len(found), -1, dtype=np.int64)
    indices[hit] = bvh.order[found[hit]]
    return places, indices
