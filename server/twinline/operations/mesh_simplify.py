"""Fewer triangles within a tolerance, by the manifold library, which keeps a mesh whole.

It works on closed meshes; an open surface is closed downwards first and opened again afterwards.
"""

import manifold3d
import numpy as np

from twinline.arrays import BoolArray, IntArray
from twinline.errors import InputError
from twinline.fusion.mesh import TriangleMesh, wholeness, without_unused
from twinline.fusion.mesh_surface import closed_to

_STEPS = 12
_SURFACE, _CLOSURE = 0, 1


def simplify_to_tolerance(mesh: TriangleMesh, tolerance_mm: float) -> TriangleMesh:
    """Remove triangles as long as the surface stays within a tolerance.

    Parameters
    ----------
    mesh
        Closed, or a surface that covers each place of the bed at most once.
    tolerance_mm
        Furthest that the surface may move; above zero.

    Raises
    ------
    InputError
        ``bad-mesh`` if the mesh is not manifold; ``bad-input`` if the tolerance is not above zero.
    """
    if not (np.isfinite(tolerance_mm) and tolerance_mm > 0.0):
        raise InputError(f"The tolerance of {tolerance_mm:g} mm is not above zero; give it in millimetres.")
    return _from_solid(_solid(mesh).simplify(tolerance_mm), mesh)


def simplify_to_count(mesh: TriangleMesh, most_faces: int) -> TriangleMesh:
    """Remove triangles until no more than a number remain, with the smallest tolerance that does it.

    Parameters
    ----------
    mesh
        As for `simplify_to_tolerance`.
    most_faces
        At least 4.

    Raises
    ------
    InputError
        ``bad-mesh`` if the mesh is not manifold, or cannot be made of so few triangles.
    """
    if most_faces < 4:
        raise InputError(f"A mesh cannot have {most_faces} triangles only; ask for 4 or more.")
    if len(mesh.faces) <= most_faces:
        return mesh
    solid = _solid(mesh)
    size = float(np.linalg.norm(np.ptp(mesh.vertices_mm, axis=0)))
    low, high = np.log(1e-6 * size), np.log(0.2 * size)
    best: TriangleMesh | None = None
    for _ in range(_STEPS):
        middle = (low + high) / 2
        found = _from_solid(solid.simplify(float(np.exp(middle))), mesh)
        if 0 < len(found.faces) <= most_faces:
            best, high = found, middle
        else:
            low = middle
    if best is None:
        raise InputError(
            f"The mesh of {len(mesh.faces)} triangles cannot be made of {most_faces}; ask for more.", code="bad-mesh"
        )
    return best


def _solid(mesh: TriangleMesh) -> manifold3d.Manifold:
    whole = wholeness(mesh)
    if not whole.manifold or not len(mesh.faces):
        raise InputError(
            f"The mesh cannot be simplified: {whole.crowded_edges} edges have more than two triangles and "
            f"{whole.twisted_edges} have triangles that face opposite ways; repair it first.",
            code="bad-mesh",
        )
    closed = mesh
    if not whole.watertight:
        # Deep enough that the closure does not come into the tolerance's reach.
        depth = float(np.linalg.norm(np.ptp(mesh.vertices_mm, axis=0)))
        closed = closed_to(mesh, float(mesh.vertices_mm[:, 2].min()) - depth)
    properties = closed.vertices_mm.astype(np.float64)
    if closed.colour is not None:
        properties = np.column_stack([properties, closed.colour])
    count = len(mesh.faces)
    several = len(closed.faces) > count
    own = manifold3d.Mesh64(
        vert_properties=np.ascontiguousarray(properties),
        tri_verts=np.ascontiguousarray(closed.faces, dtype=np.uint64),
        # Two runs: where surface and closure meet, the border is kept as an edge.
        run_index=np.array([0, 3 * count, 3 * len(closed.faces)] if several else [0, 3 * count], dtype=np.uint64),
        run_original_id=np.array([_SURFACE, _CLOSURE] if several else [_SURFACE], dtype=np.uint32),
    )
    solid = manifold3d.Manifold(own)
    if solid.status() != manifold3d.Error.NoError:
        raise InputError(f"The mesh cannot be simplified: it is no solid ({solid.status().name}).", code="bad-mesh")
    return solid


def _from_solid(solid: manifold3d.Manifold, mesh: TriangleMesh) -> TriangleMesh:
    found = solid.to_mesh64()
    properties = np.asarray(found.vert_properties)
    # Corners are kept apart for each face's own colour; the surface is one all the same.
    same = np.arange(len(properties))
    same[np.asarray(found.merge_from_vert, dtype=np.int64)] = np.asarray(found.merge_to_vert, dtype=np.int64)
    faces = same[np.asarray(found.tri_verts).astype(np.int64)[_of_surface(found)]]
    colour = None
    if mesh.colour is not None:
        colour = np.clip(np.round(properties[:, 3:6]), 0, 255).astype(np.uint8)
    return without_unused(TriangleMesh(properties[:, :3], faces, colour))


def _of_surface(found: manifold3d.Mesh64) -> BoolArray:
    ends: IntArray = np.asarray(found.run_index).astype(np.int64) // 3
    kept = np.zeros(len(found.tri_verts), dtype=bool)
    for run, name in enumerate(found.run_original_id):
        kept[ends[run] : ends[run + 1]] = name == _SURFACE
    return kept
