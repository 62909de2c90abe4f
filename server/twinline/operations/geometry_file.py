"""Reading clouds and meshes of any origin: PLY, STL, OBJ, GLB, OFF, and text of x y z."""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from twinline.arrays import FloatArray
from twinline.errors import InputError
from twinline.fusion.mesh import TriangleMesh, merged
from twinline.operations.cloud_file import read_cloud

_TEXT = frozenset({".xyz", ".txt", ".csv", ".asc", ".pts"})
_MESHES = frozenset({".stl", ".obj", ".ply", ".glb", ".gltf", ".off"})
_MM_PER_METRE = 1000.0
_STL_ROW = 50


@dataclass(frozen=True, eq=False)
class Geometry:
    """What a file holds.

    Attributes
    ----------
    points : (n, 3) array
        Points of a cloud, or corners of a mesh; NaN for a point without a measurement.
    sigma_mm : (n,) array or None
        Standard deviation of each point, from clouds of this program.
    mesh : TriangleMesh or None
        The mesh, its equal corners made one, in the file's own unit.
    unit : str or None
        ``mm`` where the format says its unit; the numbers are millimetres then.
    """

    points: FloatArray
    sigma_mm: FloatArray | None
    mesh: TriangleMesh | None
    unit: str | None


def read_geometry(path: Path) -> Geometry:
    """Read a cloud or a mesh.

    GLB is in metres and in this program's bed frame again (z up) afterwards; everything else keeps its numbers.

    Raises
    ------
    InputError
        ``bad-geometry`` if the file is missing, empty, cut off, or of no known kind.
    """
    kind = path.suffix.lower()
    if kind not in _TEXT | _MESHES:
        raise InputError(
            f"{path} is of no known kind; give one of {', '.join(sorted(_TEXT | _MESHES))}.", code="bad-geometry"
        )
    try:
        size = path.stat().st_size
    except OSError as error:
        raise InputError(f"{path} cannot be read: {(error.strerror or str(error)).lower()}.") from error
    if not size:
        raise InputError(f"{path} is empty; export it again.", code="bad-geometry")
    if kind in _TEXT:
        return Geometry(_read_text(path), None, None, None)
    if kind == ".ply" and (cloud := _own_cloud(path)) is not None:
        return cloud
    if kind == ".stl":
        _require_whole_stl(path, size)
    return _read_other(path, kind)


def _own_cloud(path: Path) -> Geometry | None:
    """A cloud that this program wrote, with its sigma; None for any other PLY."""
    with path.open("rb") as stream:
        head = stream.read(4096)
    if b"property float sigma" not in head or b"binary_little_endian" not in head or b"element face" in head:
        return None
    cloud = read_cloud(path)
    return Geometry(np.asarray(cloud.points_mm, dtype=np.float64), cloud.sigma_mm, None, "mm")


def _require_whole_stl(path: Path, size: int) -> None:
    """Refuse a binary STL that ends before, or after, the triangles that it announces."""
    with path.open("rb") as stream:
        head = stream.read(84)
        stream.seek(max(size - 4096, 0))
        tail = stream.read()
    if head[:5].lower() == b"solid" and b"\0" not in head:
        if b"endsolid" not in tail.lower():
            raise InputError(
                f"{path} is cut off: it has no endsolid at its end; copy or export it again.", code="bad-geometry"
            )
        return
    if size < 84:
        raise InputError(f"{path} is cut off: {size} bytes are no STL; copy or export it again.", code="bad-geometry")
    count = struct.unpack_from("<I", head, 80)[0]
    there = (size - 84) // _STL_ROW
    if there < count:
        raise InputError(
            f"{path} is cut off: it announces {count} triangles and holds {there}; copy or export it again.",
            code="bad-geometry",
        )


def _read_text(path: Path) -> FloatArray:
    rows: list[tuple[float, float, float]] = []
    skipped = 0
    try:
        with path.open(encoding="utf-8", errors="replace") as stream:
            for line in stream:
                words = line.replace(",", " ").replace(";", " ").split()
                try:
                    x, y, z = (float(word) for word in words[:3])
                except ValueError:
                    # One line of names is a header; more than a few are another kind of file.
                    skipped += bool(words) and not line.startswith(("#", "//"))
                    continue
                rows.append((x, y, z))
    except OSError as error:
        raise InputError(f"{path} cannot be read: {(error.strerror or str(error)).lower()}.") from error
    if not rows or skipped > max(2, len(rows) // 100):
        raise InputError(
            f"{path} has {len(rows)} lines of x y z and {skipped} others; give a text of three numbers a line.",
            code="bad-geometry",
        )
    return np.array(rows, dtype=np.float64)


def _read_other(path: Path, kind: str) -> Geometry:
    try:
        loaded = trimesh.load(path, process=False)
        parts = loaded.to_geometry() if isinstance(loaded, trimesh.Scene) else loaded
    # trimesh's readers raise whatever a broken file makes them raise.
    except Exception as error:
        cause = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path} cannot be read as {kind[1:].upper()}: {cause}.", code="bad-geometry") from error
    if not isinstance(parts, trimesh.Trimesh | trimesh.PointCloud) or not len(parts.vertices):
        raise InputError(f"{path} holds no points and no triangles; export it again.", code="bad-geometry")
    vertices = np.asarray(parts.vertices, dtype=np.float64)
    unit = None
    if kind in {".glb", ".gltf"}:
        # glTF's y up and metres, to z up and millimetres.
        vertices = np.column_stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]]) * _MM_PER_METRE
        unit = "mm"
    if isinstance(parts, trimesh.PointCloud) or not len(parts.faces):
        return Geometry(vertices, None, None, unit)
    mesh = merged(TriangleMesh(vertices, np.asarray(parts.faces, dtype=np.int64)))
    return Geometry(mesh.vertices_mm, None, mesh, unit)
