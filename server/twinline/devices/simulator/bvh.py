"""Bounding volume hierarchy over triangles: built once a scene, walked for every ray."""

from dataclasses import dataclass

import numpy as np

from twinline.arrays import BoolArray, FloatArray, IntArray

_LEAF_TRIANGLES = 4
_BINS = 16
STACK_DEPTH = 128
"""Room for nodes still to visit; the builder never makes a deeper tree."""


@dataclass(frozen=True, eq=False)
class Bvh:
    """Triangles in the order of the tree, and the tree.

    Attributes
    ----------
    corners : (triangles, 9) array
        First corner and the two edges that leave it, mm.
    order : (triangles,) array
        Index of each triangle in the mesh that the tree was built from.
    bounds : (nodes, 6) array
        Lower and upper corner of each node's box, mm.
    links : (nodes, 2) array
        For a leaf its first triangle and their number, for an inner node its first child (the second follows) and 0.
    """

    corners: FloatArray
    order: IntArray
    bounds: FloatArray
    links: IntArray


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
    triangles = np.asarray(triangles, dtype=np.float64).reshape(-1, 3, 3)
    lower, upper = triangles.min(axis=1), triangles.max(axis=1)
    middle = (lower + upper) / 2
    order = np.arange(len(triangles))
    bounds: list[FloatArray] = []
    links: list[tuple[int, int]] = []
    pending: list[tuple[int, int, int, int]] = []

    def add(first: int, last: int, depth: int) -> None:
        chosen = order[first:last]
        bounds.append(np.concatenate([lower[chosen].min(axis=0), upper[chosen].max(axis=0)]))
        links.append((first, last - first))
        if last - first > _LEAF_TRIANGLES and depth < STACK_DEPTH - 2:
            pending.append((len(links) - 1, first, last, depth))

    if len(triangles):
        add(0, len(triangles), 0)
    while pending:
        node, first, last, depth = pending.pop()
        chosen = order[first:last]
        left = _goes_left(lower[chosen], upper[chosen], middle[chosen])
        cut = first + int(left.sum())
        order[first:last] = np.concatenate([chosen[left], chosen[~left]])
        links[node] = (len(links), 0)
        add(first, cut, depth + 1)
        add(cut, last, depth + 1)

    ordered = triangles[order]
    corners = np.concatenate([ordered[:, 0], ordered[:, 1] - ordered[:, 0], ordered[:, 2] - ordered[:, 0]], axis=1)
    return Bvh(
        corners=np.ascontiguousarray(corners),
        order=order,
        bounds=np.array(bounds, dtype=np.float64).reshape(-1, 6),
        links=np.array(links, dtype=np.int32).reshape(-1, 2),
    )


def _goes_left(lower: FloatArray, upper: FloatArray, middle: FloatArray) -> BoolArray:
    """Which triangles of a node belong to its first child; neither child is left empty."""
    spread = np.ptp(middle, axis=0)
    axis = int(spread.argmax())
    halves = np.zeros(len(middle), dtype=np.bool_)
    halves[: len(middle) // 2] = True
    if not spread[axis] > 0:
        return halves
    place = (middle[:, axis] - middle[:, axis].min()) / spread[axis]
    bin_of = np.minimum((place * _BINS).astype(np.intp), _BINS - 1)
    low = np.full((_BINS, 3), np.inf)
    high = np.full((_BINS, 3), -np.inf)
    np.minimum.at(low, bin_of, lower)
    np.maximum.at(high, bin_of, upper)
    number = np.bincount(bin_of, minlength=_BINS)
    below = _half_area(np.minimum.accumulate(low), np.maximum.accumulate(high))[:-1]
    above = _half_area(np.minimum.accumulate(low[::-1]), np.maximum.accumulate(high[::-1]))[::-1][1:]
    count = np.cumsum(number)[:-1]
    # Both outermost bins are occupied, so every cut leaves something on either side.
    cost = below * count + above * (len(middle) - count)
    return np.asarray(bin_of <= int(cost.argmin()))


def _half_area(low: FloatArray, high: FloatArray) -> FloatArray:
    size = np.maximum(high - low, 0.0)
    return np.asarray(size[:, 0] * size[:, 1] + size[:, 1] * size[:, 2] + size[:, 2] * size[:, 0])
