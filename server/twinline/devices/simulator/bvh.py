"""Bounding volume hierarchy over triangles: built once a scene, walked for every ray."""

from dataclasses import dataclass

import numba
import numpy as np

from twinline.arrays import FloatArray, IntArray

_LEAF_TRIANGLES = 4
_BINS = 16
STACK_DEPTH = 128
"""Nodes that may wait to be visited; the builder never makes a deeper tree."""


@dataclass(frozen=True, eq=False)
class Bvh:
    """Triangles in the order of the tree, and the tree.

    Attributes
    ----------
    corners : (triangles, 9) array
        First corner and the two edges that leave it, mm.
    order : (triangles,) array
        Index of each triangle in the mesh that the tree was built from.
    nodes : (nodes, 8) array
        Lower and upper corner of each node's box, mm; then for a leaf its first triangle and their number, for an inner
        node its first child (the second follows) and 0. Together, so that a ray finds them in one line of the cache.
    """

    corners: FloatArray
    order: IntArray
    nodes: FloatArray

    @property
    def bounds(self) -> FloatArray:
        """(nodes, 6) lower and upper corners of the boxes, mm."""
        return self.nodes[:, :6]

    @property
    def links(self) -> IntArray:
        """(nodes, 2) first triangle and their number, or first child and 0."""
        return self.nodes[:, 6:].astype(np.int64)


def ray_stack() -> FloatArray:
    """(STACK_DEPTH, 2) scratch memory of a ray: nodes still to visit, and where it enters them."""
    return np.empty((STACK_DEPTH, 2))


def build_bvh(triangles: FloatArray) -> Bvh:
    """Arrange triangles in a tree, split where the surface area heuristic says.

    Parameters
    ----------
    triangles : (n, 3, 3) array
        Corners of n triangles, mm; n may be 0.

    References
    ----------
    I. Wald, "On fast construction of SAH-based bounding volume hierarchies", IEEE Symposium on Interactive Ray
    Tracing (2007).
    """
    triangles = np.ascontiguousarray(triangles, dtype=np.float64).reshape(-1, 3, 3)
    order = np.arange(len(triangles))
    bounds = np.empty((2 * len(triangles), 6))
    links = np.empty((2 * len(triangles), 2), dtype=np.int32)
    count = _build(triangles.min(axis=1), triangles.max(axis=1), order, bounds, links) if len(triangles) else 0
    ordered = triangles[order]
    corners = np.concatenate([ordered[:, 0], ordered[:, 1] - ordered[:, 0], ordered[:, 2] - ordered[:, 0]], axis=1)
    return Bvh(np.ascontiguousarray(corners), order, np.concatenate([bounds[:count], links[:count]], axis=1))


@numba.njit(cache=True, nogil=True)
def _build(
    lower: FloatArray, upper: FloatArray, order: IntArray, bounds: FloatArray, links: IntArray
) -> int:  # pragma: no cover - compiled
    """Fill ``bounds`` and ``links``, reorder ``order``; the number of nodes."""
    pending = np.empty((STACK_DEPTH + 2, 4), dtype=np.int64)
    spare = np.empty_like(order)
    middle = (lower + upper) / 2
    _add_node(lower, upper, order, bounds, links, 0, 0, order.size)
    nodes, height = 1, 1
    pending[0, 0], pending[0, 1], pending[0, 2], pending[0, 3] = 0, 0, order.size, 0
    while height > 0:
        height -= 1
        node, first, last, depth = pending[height]
        if last - first <= _LEAF_TRIANGLES or depth >= STACK_DEPTH - 2:
            continue
        cut = _split(lower, upper, middle, order, spare, first, last)
        links[node, 0], links[node, 1] = nodes, 0
        for start, end in ((first, cut), (cut, last)):
            _add_node(lower, upper, order, bounds, links, nodes, start, end)
            pending[height, 0], pending[height, 1], pending[height, 2], pending[height, 3] = (
                nodes, start, end, depth + 1,
            )  # fmt: skip
            nodes += 1
            height += 1
    return nodes


@numba.njit(cache=True, nogil=True)
def _add_node(
    lower: FloatArray, upper: FloatArray, order: IntArray, bounds: FloatArray, links: IntArray,
    node: int, first: int, last: int,
) -> None:  # fmt: skip  # pragma: no cover - compiled
    for axis in range(3):
        low, high = np.inf, -np.inf
        for i in range(first, last):
            low = min(low, lower[order[i], axis])
            high = max(high, upper[order[i], axis])
        bounds[node, axis], bounds[node, 3 + axis] = low, high
    links[node, 0], links[node, 1] = first, last - first


@numba.njit(cache=True, nogil=True)
def _split(
    lower: FloatArray, upper: FloatArray, middle: FloatArray, order: IntArray, spare: IntArray, first: int, last: int
) -> int:  # pragma: no cover - compiled
    """Reorder the triangles of a node so that its first child's come first; where the second child begins."""
    axis, start, spread = 0, 0.0, -1.0
    for candidate in range(3):
        low, high = np.inf, -np.inf
        for i in range(first, last):
            low = min(low, middle[order[i], candidate])
            high = max(high, middle[order[i], candidate])
        if high - low > spread:
            axis, start, spread = candidate, low, high - low
    if not spread > 0.0:
        return first + (last - first) // 2
    # Both outermost bins are occupied, so every cut leaves something on either side.
    best = _cheapest_cut(lower, upper, middle, order, first, last, axis, start, spread)
    left, right = first, 0
    for i in range(first, last):
        k = order[i]
        if min(int((middle[k, axis] - start) / spread * _BINS), _BINS - 1) <= best:
            order[left] = k
            left += 1
        else:
            spare[right] = k
            right += 1
    for i in range(right):
        order[left + i] = spare[i]
    return left


@numba.njit(cache=True, nogil=True)
def _cheapest_cut(
    lower: FloatArray, upper: FloatArray, middle: FloatArray, order: IntArray,
    first: int, last: int, axis: int, start: float, spread: float,
) -> int:  # fmt: skip  # pragma: no cover - compiled
    """Last bin of the first child, by surface area times triangles of both children."""
    boxes = np.empty((_BINS, 6))
    boxes[:, :3], boxes[:, 3:] = np.inf, -np.inf
    number = np.zeros(_BINS, dtype=np.int64)
    for i in range(first, last):
        k = order[i]
        place = min(int((middle[k, axis] - start) / spread * _BINS), _BINS - 1)
        number[place] += 1
        _grow(boxes[place], lower[k], upper[k])
    above = np.empty(_BINS)
    box = np.array([np.inf, np.inf, np.inf, -np.inf, -np.inf, -np.inf])
    behind = 0
    for place in range(_BINS - 1, 0, -1):
        _grow(box, boxes[place, :3], boxes[place, 3:])
        behind += number[place]
        above[place - 1] = _half_area(box) * behind
    box[:3], box[3:] = np.inf, -np.inf
    best, cost, before = 0, np.inf, 0
    for place in range(_BINS - 1):
        _grow(box, boxes[place, :3], boxes[place, 3:])
        before += number[place]
        now = _half_area(box) * before + above[place]
        if now < cost:
            best, cost = place, now
    return best


@numba.njit(cache=True, nogil=True)
def _grow(box: FloatArray, low: FloatArray, high: FloatArray) -> None:  # pragma: no cover - compiled
    for axis in range(3):
        box[axis] = min(box[axis], low[axis])
        box[3 + axis] = max(box[3 + axis], high[axis])


@numba.njit(cache=True, nogil=True)
def _half_area(box: FloatArray) -> float:  # pragma: no cover - compiled
    x, y, z = max(box[3] - box[0], 0.0), max(box[4] - box[1], 0.0), max(box[5] - box[2], 0.0)
    area: float = x * y + y * z + z * x
    return area
