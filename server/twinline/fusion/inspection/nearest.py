"""The nearest point of a mesh, and on which side of it one stands."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit

from twinline.arrays import BoolArray, FloatArray, IntArray
from twinline.fusion.mesh import TriangleMesh, require_triangles

_LEAF = 6
_DEPTH = 64


@dataclass(frozen=True, eq=False)
class Nearest:
    """Nearest points of a mesh.

    Attributes
    ----------
    points_mm : (n, 3) array
        On the mesh; NaN for a point that is not finite.
    faces : (n,) int array
        Rows of the triangles; -1 for a point that is not finite.
    normals : (n, 3) array
        Outward unit normals of those triangles.
    signed_mm : (n,) array
        Distance, negative inside.
    on_border : (n,) bool array
        The nearest point lies on an open edge of the mesh, so the point asked for may lie beside what the mesh shows.
    """

    points_mm: FloatArray
    faces: IntArray
    normals: FloatArray
    signed_mm: FloatArray
    on_border: BoolArray


class MeshSurface:
    """A mesh prepared for many questions of what is nearest.

    A tree of boxes over the triangles (C. Ericson, "Real-Time Collision Detection", sections 6.2 and 5.1.5), and the
    angle-weighted normals of corners and edges that tell inside from outside also where the nearest point lies on a
    corner (J. Baerentzen and H. Aanaes, "Signed distance computation using the angle weighted pseudonormal", IEEE
    TVCG 11 (2005)).

    Parameters
    ----------
    mesh
        Its equal corners must be one (`twinline.fusion.mesh.merged`), or each edge counts as open.

    Raises
    ------
    InputError
        ``bad-mesh`` if it has no triangle, none with an area, or corners that are not finite.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        require_triangles(mesh, "The reference mesh")
        vectors = mesh.face_vectors_mm2()
        size = np.linalg.norm(vectors, axis=1)
        whole = size > 0.0
        if not whole.all():
            mesh = TriangleMesh(mesh.vertices_mm, mesh.faces[whole])
            require_triangles(mesh, "The reference mesh, without triangles of no area,")
        self.mesh = mesh
        self.normals = vectors[whole] / size[whole, None]
        self._corners = np.ascontiguousarray(mesh.corners_mm())
        self._boxes, self._links, self._order = _tree(self._corners)

    @cached_property
    def _pseudo(self) -> tuple[FloatArray, BoolArray]:
        """Normals of the face, its edges ab, bc, ca and its corners, (m, 7, 3), and which of them are open, (m, 7)."""
        return _pseudo_normals(self.mesh, self.normals)

    def nearest(self, points_mm: FloatArray) -> Nearest:
        """The nearest point of the mesh to each point.

        Parameters
        ----------
        points_mm : (n, 3) array
        """
        points = np.ascontiguousarray(points_mm, dtype=np.float64)
        found, faces, features = _search(points, self._corners, self._boxes, self._links, self._order)
        known = faces >= 0
        pseudo, is_open = self._pseudo
        row = np.maximum(faces, 0)
        away = points - found
        distance = np.linalg.norm(away, axis=1)
        side = np.einsum("ij,ij->i", away, pseudo[row, features])
        signed = np.where(side < 0.0, -distance, distance)
        return Nearest(
            found,
            faces,
            np.where(known[:, None], self.normals[row], np.nan),
            np.where(known, signed, np.nan),
            known & is_open[row, features],
        )


def _tree(corners: FloatArray) -> tuple[FloatArray, IntArray, IntArray]:
    """Boxes (k, 6), links (k, 2) and the order of the triangles.

    A node with links (i, 0) has children i and i + 1; one with (first, count) holds that run of the order.
    """
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    middle = (lower + upper) / 2
    order = np.arange(len(corners))
    boxes: list[FloatArray] = [np.concatenate([lower.min(axis=0), upper.max(axis=0)])]
    links: list[tuple[int, int]] = [(0, 0)]
    pending = [(0, 0, len(order))]
    while pending:
        node, first, last = pending.pop()
        if last - first <= _LEAF:
            links[node] = (first, last - first)
            continue
        rows = order[first:last]
        axis = int(np.argmax(np.ptp(middle[rows], axis=0)))
        half = (last - first) // 2
        order[first:last] = rows[np.argpartition(middle[rows, axis], half)]
        links[node] = (len(boxes), 0)
        for start, end in ((first, first + half), (first + half, last)):
            part = order[start:end]
            pending.append((len(boxes), start, end))
            boxes.append(np.concatenate([lower[part].min(axis=0), upper[part].max(axis=0)]))
            links.append((0, 0))
    return np.array(boxes), np.array(links, dtype=np.int64), order


def _pseudo_normals(mesh: TriangleMesh, normals: FloatArray) -> tuple[FloatArray, BoolArray]:
    faces = mesh.faces.astype(np.int64)
    corners = mesh.corners_mm()
    sides = np.roll(corners, -1, axis=1) - corners
    unit = sides / np.maximum(np.linalg.norm(sides, axis=2, keepdims=True), 1e-300)
    angle = np.arccos(np.clip(np.einsum("mkj,mkj->mk", unit, -np.roll(unit, 1, axis=1)), -1.0, 1.0))
    weighted = angle[..., None] * normals[:, None, :]
    n = len(mesh.vertices_mm)
    at_corner = np.stack(
        [np.bincount(faces.ravel(), weights=weighted[..., j].ravel(), minlength=n) for j in range(3)], axis=1
    )
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    key = np.minimum(start, end) * np.int64(n) + np.maximum(start, end)
    _, place, counts = np.unique(key, return_inverse=True, return_counts=True)
    repeated = np.repeat(normals, 3, axis=0)
    at_edge = np.stack([np.bincount(place, weights=repeated[:, j]) for j in range(3)], axis=1)[place].reshape(-1, 3, 3)
    open_edge = (counts == 1)[place].reshape(-1, 3)
    open_corner = np.zeros(n, dtype=bool)
    open_corner[start[open_edge.ravel()]] = True
    open_corner[end[open_edge.ravel()]] = True
    pseudo = np.concatenate([normals[:, None, :], at_edge, at_corner[faces]], axis=1)
    is_open = np.concatenate([np.zeros((len(faces), 1), dtype=bool), open_edge, open_corner[faces]], axis=1)
    return pseudo, is_open


@njit(cache=True, nogil=True)
def _search(
    points: FloatArray, corners: FloatArray, boxes: FloatArray, links: IntArray, order: IntArray
) -> tuple[FloatArray, IntArray, IntArray]:  # pragma: no cover - compiled
    found = np.full(points.shape, np.nan)
    faces = np.full(len(points), -1, dtype=np.int64)
    features = np.zeros(len(points), dtype=np.int64)
    stack = np.empty(_DEPTH * 2, dtype=np.int64)
    here = np.empty(3)
    for i in range(len(points)):
        p = points[i]
        if not (np.isfinite(p[0]) and np.isfinite(p[1]) and np.isfinite(p[2])):
            continue
        best = np.inf
        stack[0] = 0
        height = 1
        while height > 0:
            height -= 1
            node = stack[height]
            if _box_distance(p, boxes[node]) >= best:
                continue
            first, count = links[node, 0], links[node, 1]
            if count > 0:
                for k in range(first, first + count):
                    feature = _closest(p, corners[order[k]], here)
                    d = (p[0] - here[0]) ** 2 + (p[1] - here[1]) ** 2 + (p[2] - here[2]) ** 2
                    if d < best:
                        best = d
                        found[i, 0], found[i, 1], found[i, 2] = here[0], here[1], here[2]
                        faces[i], features[i] = order[k], feature
                continue
            near, far = first, first + 1
            if _box_distance(p, boxes[far]) < _box_distance(p, boxes[near]):
                near, far = far, near
            stack[height], stack[height + 1] = far, near
            height += 2
    return found, faces, features


@njit(cache=True, nogil=True)
def _box_distance(p: FloatArray, box: FloatArray) -> float:  # pragma: no cover - compiled
    total = 0.0
    for axis in range(3):
        d = max(box[axis] - p[axis], p[axis] - box[3 + axis], 0.0)
        total += d * d
    return total


@njit(cache=True, nogil=True)
def _closest(p: FloatArray, t: FloatArray, out: FloatArray) -> int:  # pragma: no cover - compiled
    """Write the nearest point of a triangle; 0 on the face, 1 to 3 on edge ab, bc, ca, 4 to 6 at corner a, b, c."""
    ab0, ab1, ab2 = t[1, 0] - t[0, 0], t[1, 1] - t[0, 1], t[1, 2] - t[0, 2]
    ac0, ac1, ac2 = t[2, 0] - t[0, 0], t[2, 1] - t[0, 1], t[2, 2] - t[0, 2]
    ap0, ap1, ap2 = p[0] - t[0, 0], p[1] - t[0, 1], p[2] - t[0, 2]
    d1 = ab0 * ap0 + ab1 * ap1 + ab2 * ap2
    d2 = ac0 * ap0 + ac1 * ap1 + ac2 * ap2
    if d1 <= 0.0 and d2 <= 0.0:
        out[:] = t[0]
        return 4
    bp0, bp1, bp2 = p[0] - t[1, 0], p[1] - t[1, 1], p[2] - t[1, 2]
    d3 = ab0 * bp0 + ab1 * bp1 + ab2 * bp2
    d4 = ac0 * bp0 + ac1 * bp1 + ac2 * bp2
    if d3 >= 0.0 and d4 <= d3:
        out[:] = t[1]
        return 5
    cp0, cp1, cp2 = p[0] - t[2, 0], p[1] - t[2, 1], p[2] - t[2, 2]
    d5 = ab0 * cp0 + ab1 * cp1 + ab2 * cp2
    d6 = ac0 * cp0 + ac1 * cp1 + ac2 * cp2
    if d6 >= 0.0 and d5 <= d6:
        out[:] = t[2]
        return 6
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
        out[0], out[1], out[2] = t[0, 0] + v * ab0, t[0, 1] + v * ab1, t[0, 2] + v * ab2
        return 1
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        v = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        for axis in range(3):
            out[axis] = t[1, axis] + v * (t[2, axis] - t[1, axis])
        return 2
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        v = d2 / (d2 - d6)
        out[0], out[1], out[2] = t[0, 0] + v * ac0, t[0, 1] + v * ac1, t[0, 2] + v * ac2
        return 3
    denominator = 1.0 / (va + vb + vc)
    v, w = vb * denominator, vc * denominator
    out[0] = t[0, 0] + ab0 * v + ac0 * w
    out[1] = t[0, 1] + ab1 * v + ac1 * w
    out[2] = t[0, 2] + ab2 * v + ac2 * w
    return 0
