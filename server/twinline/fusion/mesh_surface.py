"""From a height map to a mesh: an open surface, or a solid that stands on the bed."""

import numpy as np
from scipy import ndimage

from twinline.arrays import BoolArray, ByteArray, FloatArray, IntArray
from twinline.errors import InputError
from twinline.fusion.mesh import TriangleMesh, without_unused

STEEPEST_DEG = 80.0


def surface_mesh(
    z_mm: FloatArray,
    x0_mm: float,
    y0_mm: float,
    pitch_mm: float,
    *,
    colour: ByteArray | None = None,
    steepest_deg: float | None = STEEPEST_DEG,
) -> TriangleMesh:
    """Triangles between neighbouring cells of a height map.

    Four measured neighbours make two triangles, split along the diagonal with the smaller difference in height; three
    make one. The normals point up. Corners at which the surface would touch itself in a single point are doubled, so
    that the result is manifold.

    Parameters
    ----------
    z_mm : (ny, nx) array
        Heights at the cells' middles; NaN means "no measurement".
    x0_mm, y0_mm
        Place of the cell [0, 0].
    pitch_mm
        Distance of neighbouring cells.
    colour : (ny, nx, 3) uint8 array, optional
    steepest_deg
        A triangle steeper than this would bridge a step in depth and is left out; None bridges every step.

    Raises
    ------
    InputError
        ``bad-mesh`` if no triangle remains.
    """
    ny, nx = z_mm.shape
    z = np.asarray(z_mm, dtype=np.float64)
    x, y = np.meshgrid(x0_mm + pitch_mm * np.arange(nx), y0_mm + pitch_mm * np.arange(ny))
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    faces = _grid_faces(z)
    if steepest_deg is not None and len(faces):
        faces = faces[_slopes(z, faces, pitch_mm) <= np.tan(np.radians(steepest_deg))]
    if not len(faces):
        raise InputError(
            "The height map has no three neighbouring cells with a measurement, so it makes no mesh; "
            "use a coarser pitch or a larger region.",
            code="bad-mesh",
        )
    mesh = TriangleMesh(vertices, faces, None if colour is None else colour.reshape(-1, 3))
    return without_unused(_parted(mesh))


def solid_mesh(
    z_mm: FloatArray,
    x0_mm: float,
    y0_mm: float,
    pitch_mm: float,
    *,
    colour: ByteArray | None = None,
    floor_mm: float = 0.0,
) -> TriangleMesh:
    """A closed body for printing: the measured surface, walls down from its border, and a flat base.

    Steps in depth become walls, since a solid has no gaps. Every cell's height lies at least a hundredth of the pitch
    above the floor.

    Parameters
    ----------
    z_mm : (ny, nx) array
        Heights at the cells' middles; NaN means that nothing stands there.
    x0_mm, y0_mm, pitch_mm, colour
        As for `surface_mesh`.
    floor_mm
        Height of the base.

    Raises
    ------
    InputError
        ``bad-mesh`` if no triangle remains, or nothing rises above the floor.
    """
    if not (z_mm > floor_mm).any():
        raise InputError(
            f"Nothing rises above the base at {floor_mm:g} mm, so there is no body; choose a lower base.",
            code="bad-mesh",
        )
    # Where top and base met, the body would be pinched to nothing.
    z = np.where(np.isnan(z_mm), np.nan, np.maximum(z_mm, floor_mm + 0.01 * pitch_mm))
    top = surface_mesh(z, x0_mm, y0_mm, pitch_mm, colour=colour, steepest_deg=None)
    return closed_to(top, floor_mm)


def closed_to(top: TriangleMesh, floor_mm: float) -> TriangleMesh:
    """Close a surface that covers each place once with its copy on the floor and walls between the two borders."""
    n = len(top.vertices_mm)
    base = np.column_stack([top.vertices_mm[:, :2], np.full(n, floor_mm)])
    border = border_edges(top)
    a, b = border[:, 0], border[:, 1]
    # The top's border runs counter-clockwise seen from above; walls run it the other way, to agree with it.
    walls = np.concatenate([np.stack([b, a, a + n], axis=1), np.stack([b, a + n, b + n], axis=1)])
    return TriangleMesh(
        np.concatenate([top.vertices_mm, base]),
        np.concatenate([top.faces, top.faces[:, ::-1] + n, walls]),
        None if top.colour is None else np.concatenate([top.colour, top.colour]),
    )


def border_edges(mesh: TriangleMesh) -> IntArray:
    """Edges of one triangle only, (k, 2), in the direction in which it has them."""
    start, end = mesh.faces.ravel().astype(np.int64), np.roll(mesh.faces, -1, axis=1).ravel().astype(np.int64)
    n = np.int64(len(mesh.vertices_mm))
    undirected = np.minimum(start, end) * n + np.maximum(start, end)
    _, place, counts = np.unique(undirected, return_inverse=True, return_counts=True)
    single = counts[place] == 1
    return np.stack([start[single], end[single]], axis=1)


def small_gaps_filled(
    z_mm: FloatArray, most_cells: int, narrow_cells: int = 0, *, step_mm: float = np.inf
) -> FloatArray:
    """Fill unmeasured areas that the map encloses and that are small or narrow, by the mean of their neighbours.

    Parameters
    ----------
    z_mm : (ny, nx) array
    most_cells
        Larger areas, and those at the map's border, stay unmeasured.
    narrow_cells
        Places at most so far from measured ones on both sides are filled too, however long the gap between them is, as
        those between the stripes of neighbouring frames.
    step_mm
        Where the measured heights around a place differ by more than this there is a step, and it stays unmeasured.
    """
    missing = np.isnan(z_mm)
    label, count = ndimage.label(missing)
    if not count:
        return z_mm
    size = np.bincount(label.ravel(), minlength=count + 1)
    at_border = np.unique(np.concatenate([label[0], label[-1], label[:, 0], label[:, -1]]))
    wanted = size <= most_cells
    wanted[0] = False
    wanted[at_border] = False
    fill = wanted[label]
    if narrow_cells > 0:
        around = np.pad(~missing, narrow_cells)
        closed = ndimage.binary_closing(around, np.ones((3, 3), dtype=bool), iterations=narrow_cells)
        fill |= missing & closed[narrow_cells:-narrow_cells, narrow_cells:-narrow_cells]
    if np.isfinite(step_mm):
        window = 2 * narrow_cells + 3
        highest = ndimage.maximum_filter(np.where(missing, -np.inf, z_mm), window, mode="nearest")
        lowest = ndimage.minimum_filter(np.where(missing, np.inf, z_mm), window, mode="nearest")
        fill &= highest - lowest <= step_mm
    nearest = ndimage.distance_transform_edt(missing, return_distances=False, return_indices=True)
    filled = np.where(fill, z_mm[tuple(nearest)], z_mm)
    known = np.where(np.isnan(filled), 0.0, filled)
    weight = (~np.isnan(filled)).astype(np.float64)
    # Jacobi steps towards the soap film over the border of each gap.
    for _ in range(4 * int(np.sqrt(max(most_cells, 1)))):
        sums = ndimage.uniform_filter(known, 3, mode="nearest") / np.maximum(
            ndimage.uniform_filter(weight, 3, mode="nearest"), 1e-12
        )
        known = np.where(fill, sums, known)
    return np.where(fill, known, filled)


def _grid_faces(z: FloatArray) -> IntArray:
    """Triangles of all cells with three or four measured corners, counter-clockwise seen from above."""
    ny, nx = z.shape
    index = np.arange(ny * nx).reshape(ny, nx)
    corner = [index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]]
    height = [z.ravel()[c] for c in corner]
    known = [~np.isnan(h) for h in height]
    count = sum(k.astype(np.int8) for k in known)
    whole = count == 4
    with np.errstate(invalid="ignore"):
        rising = np.abs(height[0] - height[2]) <= np.abs(height[1] - height[3])
    parts = [
        _triangles(corner, (0, 1, 2), whole & rising),
        _triangles(corner, (0, 2, 3), whole & rising),
        _triangles(corner, (0, 1, 3), whole & ~rising),
        _triangles(corner, (1, 2, 3), whole & ~rising),
    ]
    for lacking in range(4):
        three = (count == 3) & ~known[lacking]
        around = tuple((lacking + i) % 4 for i in (1, 2, 3))
        parts.append(_triangles(corner, around, three))
    return np.concatenate(parts)


def _triangles(corner: list[IntArray], places: tuple[int, ...], where: BoolArray) -> IntArray:
    return np.stack([corner[i][where] for i in places], axis=1)


def _slopes(z: FloatArray, faces: IntArray, pitch_mm: float) -> FloatArray:
    """Tangent of each triangle's steepest angle against the bed."""
    nx = z.shape[1]
    row, column = np.divmod(faces, nx)
    height = z.ravel()[faces]
    a = np.stack([column[:, 1] - column[:, 0], row[:, 1] - row[:, 0]], axis=1) * pitch_mm
    b = np.stack([column[:, 2] - column[:, 0], row[:, 2] - row[:, 0]], axis=1) * pitch_mm
    da, db = height[:, 1] - height[:, 0], height[:, 2] - height[:, 0]
    area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    gx = (da * b[:, 1] - db * a[:, 1]) / area
    gy = (db * a[:, 0] - da * b[:, 0]) / area
    return np.asarray(np.hypot(gx, gy))


def _parted(mesh: TriangleMesh) -> TriangleMesh:
    """The mesh with a corner of its own for each fan of triangles that meets others in that corner only."""
    faces = mesh.faces.astype(np.int64)
    border = border_edges(mesh)
    # Where more than one border edge leaves a corner, more than one fan meets there.
    leaving = np.bincount(border[:, 0], minlength=len(mesh.vertices_mm))
    shared = np.flatnonzero(leaving > 1)
    if not len(shared):
        return mesh
    at_shared = np.isin(faces, shared)
    touching = np.flatnonzero(at_shared.any(axis=1))
    owners: dict[int, list[tuple[int, int]]] = {}
    for face in touching.tolist():
        for side in np.flatnonzero(at_shared[face]).tolist():
            owners.setdefault(int(faces[face, side]), []).append((face, side))
    extra: list[int] = []
    for corner, places in owners.items():
        for fan in _fans(faces, corner, places)[1:]:
            for face, side in fan:
                faces[face, side] = len(mesh.vertices_mm) + len(extra)
            extra.append(corner)
    rows = np.concatenate([np.arange(len(mesh.vertices_mm)), np.asarray(extra, dtype=np.int64)])
    return TriangleMesh(mesh.vertices_mm[rows], faces, None if mesh.colour is None else mesh.colour[rows])


def _fans(faces: IntArray, corner: int, places: list[tuple[int, int]]) -> list[list[tuple[int, int]]]:
    """The triangles around a corner, in groups that hang together by edges."""
    fans: list[tuple[set[int], list[tuple[int, int]]]] = []
    for face, side in places:
        others = {int(v) for v in faces[face] if v != corner}
        joined = [fan for fan in fans if fan[0] & others]
        fans = [fan for fan in fans if not fan[0] & others]
        members = [(face, side), *(place for fan in joined for place in fan[1])]
        fans.append((others.union(*(fan[0] for fan in joined)), members))
    return [members for _, members in fans]
