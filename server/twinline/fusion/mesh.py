"""Triangle meshes: what they are, and whether they are whole."""

from dataclasses import dataclass

import numpy as np

from twinline.arrays import ByteArray, FloatArray, IntArray
from twinline.errors import InputError


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """Triangles that share their corners.

    Attributes
    ----------
    vertices_mm : (n, 3) float array
        Corners in the bed frame.
    faces : (m, 3) int array
        Rows of the corners, counter-clockwise seen from outside.
    colour : (n, 3) uint8 array or None
        Red, green, blue of the corners.
    """

    vertices_mm: FloatArray
    faces: IntArray
    colour: ByteArray | None = None

    def __post_init__(self) -> None:
        if self.vertices_mm.ndim != 2 or self.vertices_mm.shape[1] != 3:
            raise ValueError(f"vertices_mm has shape {self.vertices_mm.shape}, expected (n, 3)")
        if self.faces.ndim != 2 or self.faces.shape[1] != 3:
            raise ValueError(f"faces has shape {self.faces.shape}, expected (m, 3)")
        if self.colour is not None and self.colour.shape != self.vertices_mm.shape:
            raise ValueError(f"colour has shape {self.colour.shape}, expected {self.vertices_mm.shape}")
        if len(self.faces) and (self.faces.min() < 0 or self.faces.max() >= len(self.vertices_mm)):
            raise ValueError(f"faces name corners {self.faces.min()} to {self.faces.max()} of {len(self.vertices_mm)}")

    def corners_mm(self) -> FloatArray:
        """Corners of each triangle, (m, 3, 3)."""
        return np.asarray(self.vertices_mm, dtype=np.float64)[self.faces]

    def face_vectors_mm2(self) -> FloatArray:
        """Outward normal of each triangle times twice its area, (m, 3)."""
        a, b, c = np.moveaxis(self.corners_mm(), 1, 0)
        return np.cross(b - a, c - a)

    def area_mm2(self) -> float:
        """Area of all triangles."""
        return float(np.linalg.norm(self.face_vectors_mm2(), axis=1).sum() / 2)

    def volume_mm3(self) -> float:
        """Enclosed volume, positive if the normals point outwards; means something only for a closed mesh."""
        corners = self.corners_mm()
        if not len(corners):
            return 0.0
        # Far from the origin the products would lose digits.
        corners = corners - self.vertices_mm.mean(axis=0, dtype=np.float64)
        return float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)

    def vertex_normals(self) -> FloatArray:
        """Unit normals of the corners, (n, 3): the faces' own, weighted by area; zero for a corner without faces."""
        vectors = self.face_vectors_mm2()
        sums = np.stack(
            [
                np.bincount(self.faces.ravel(), weights=np.repeat(vectors[:, axis], 3), minlength=len(self.vertices_mm))
                for axis in range(3)
            ],
            axis=1,
        )
        length = np.linalg.norm(sums, axis=1, keepdims=True)
        return np.asarray(np.divide(sums, length, out=np.zeros_like(sums), where=length > 0.0))


@dataclass(frozen=True)
class Wholeness:
    """How the edges of a mesh hang together.

    Attributes
    ----------
    open_edges
        Edges of one triangle only.
    crowded_edges
        Edges of more than two triangles.
    twisted_edges
        Edges whose two triangles disagree about what is outside.
    """

    open_edges: int
    crowded_edges: int
    twisted_edges: int

    @property
    def watertight(self) -> bool:
        """Closed, and everywhere of one outside."""
        return self.open_edges == self.crowded_edges == self.twisted_edges == 0

    @property
    def manifold(self) -> bool:
        """A surface, with or without a border, everywhere of one outside."""
        return self.crowded_edges == self.twisted_edges == 0


def wholeness(mesh: TriangleMesh) -> Wholeness:
    """Count the edges that are open, shared by too many triangles, or run the same way in both."""
    faces = mesh.faces.astype(np.int64)
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    n = np.int64(max(len(mesh.vertices_mm), 1))
    undirected = np.minimum(start, end) * n + np.maximum(start, end)
    _, place, counts = np.unique(undirected, return_inverse=True, return_counts=True)
    ways = np.bincount(place, weights=np.where(start < end, 1.0, -1.0))
    return Wholeness(int((counts == 1).sum()), int((counts > 2).sum()), int(((counts == 2) & (ways != 0.0)).sum()))


def merged(mesh: TriangleMesh) -> TriangleMesh:
    """The mesh with corners equal to two millionths of its size made one, without triangles that vanish by it."""
    size = float(np.ptp(mesh.vertices_mm, axis=0).max()) if len(mesh.vertices_mm) else 0.0
    # Float32 files write one corner in several ways, some 1e-7 of the size apart.
    raster = np.round(mesh.vertices_mm / (2e-6 * size)) if np.isfinite(size) and size > 0.0 else mesh.vertices_mm
    _, first, place = np.unique(raster, axis=0, return_index=True, return_inverse=True)
    faces = place.reshape(-1)[mesh.faces]
    distinct = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return TriangleMesh(mesh.vertices_mm[first], faces[distinct], None if mesh.colour is None else mesh.colour[first])


def without_unused(mesh: TriangleMesh) -> TriangleMesh:
    """The mesh without corners that no triangle has."""
    used = np.zeros(len(mesh.vertices_mm), dtype=bool)
    used[mesh.faces] = True
    row = np.cumsum(used) - 1
    return TriangleMesh(mesh.vertices_mm[used], row[mesh.faces], None if mesh.colour is None else mesh.colour[used])


def require_triangles(mesh: TriangleMesh, what: str) -> None:
    """Refuse a mesh without triangles, or with corners that are not finite.

    Raises
    ------
    InputError
        ``bad-mesh``.
    """
    if not len(mesh.faces):
        raise InputError(f"{what} has no triangles; give a mesh, not a cloud of points.", code="bad-mesh")
    broken = int((~np.isfinite(mesh.vertices_mm[mesh.faces]).all(axis=(1, 2))).sum())
    if broken:
        raise InputError(
            f"{what} has {broken} of {len(mesh.faces)} triangles with corners that are not finite; export it again.",
            code="bad-mesh",
        )
