"""GLB: the mesh for viewers, for the web and for other programs.

The format is Khronos Group, "glTF 2.0 Specification", chapters 3 and 4: metres, +Y up, little endian.
"""

import json
import struct
from pathlib import Path

import numpy as np

from twinline.arrays import FloatArray
from twinline.errors import OutputError
from twinline.fusion.mesh import TriangleMesh
from twinline.operations.exports.atomic import atomic_path
from twinline.operations.exports.provenance import Provenance
from twinline.operations.exports.stl import require_mesh

_FLOAT, _UNSIGNED_BYTE, _UNSIGNED_INT = 5126, 5121, 5125
_ARRAY_BUFFER, _ELEMENT_BUFFER, _TRIANGLES = 34962, 34963, 4
# Turns the bed frame's z up into glTF's y up: x, y, z becomes x, z, -y. Quaternion x, y, z, w.
_Z_UP_TO_Y_UP = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]
_MAX_BYTES = 2**32 - 1


def write_mesh_glb(path: Path, mesh: TriangleMesh, provenance: Provenance) -> None:
    """Write a mesh as GLB.

    Vertices are metres in the bed frame, with normals and, where the mesh has them, colours in ``COLOR_0``; the node
    turns them to glTF's y up. The provenance is in ``asset.extras``.

    Raises
    ------
    OutputError
        If the file cannot be written, the mesh has no triangle or corners that are not finite, or it exceeds the 4 GB
        that the format can hold; nothing is left behind then.
    """
    require_mesh(path, mesh)
    positions = np.ascontiguousarray(np.asarray(mesh.vertices_mm, dtype=np.float64) / 1000.0, dtype="<f4")
    parts = {"POSITION": positions.tobytes(), "NORMAL": _normals(mesh).tobytes()}
    if mesh.colour is not None:
        # Four bytes a colour, since glTF wants every vertex aligned to four.
        colours = np.full((len(positions), 4), 255, dtype=np.uint8)
        colours[:, :3] = mesh.colour
        parts["COLOR_0"] = colours.tobytes()
    indices = np.ascontiguousarray(mesh.faces, dtype="<u4").tobytes()
    document = _document(positions, parts, len(mesh.faces) * 3, provenance)
    text = json.dumps(document, ensure_ascii=False, allow_nan=False).encode("utf-8")
    text += b" " * (-len(text) % 4)
    body = sum(len(data) for data in parts.values()) + len(indices)
    total = 12 + 8 + len(text) + 8 + body
    if total > _MAX_BYTES:
        raise OutputError(f"{path} cannot be written: {len(mesh.faces)} triangles exceed the 4 GB of a GLB; simplify.")
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        stream.write(struct.pack("<4sII", b"glTF", 2, total))
        stream.write(struct.pack("<I4s", len(text), b"JSON") + text)
        stream.write(struct.pack("<I4s", body, b"BIN\0"))
        for data in (*parts.values(), indices):
            stream.write(data)


def _normals(mesh: TriangleMesh) -> FloatArray:
    normals = mesh.vertex_normals()
    # glTF demands unit length also of corners without a triangle, or whose triangles cancel.
    normals[np.linalg.norm(normals, axis=1) < 0.5] = (0.0, 0.0, 1.0)
    return np.ascontiguousarray(normals, dtype="<f4")


def _document(
    positions: FloatArray, parts: dict[str, bytes], index_count: int, provenance: Provenance
) -> dict[str, object]:
    accessors: list[dict[str, object]] = []
    views: list[dict[str, object]] = []
    offset = 0
    for name, data in parts.items():
        accessor: dict[str, object] = {"bufferView": len(views), "count": len(positions)}
        if name == "COLOR_0":
            accessor |= {"componentType": _UNSIGNED_BYTE, "normalized": True, "type": "VEC4"}
        else:
            accessor |= {"componentType": _FLOAT, "type": "VEC3"}
        if name == "POSITION":
            accessor |= {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
        accessors.append(accessor)
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": len(data), "target": _ARRAY_BUFFER})
        offset += len(data)
    accessors.append({"bufferView": len(views), "count": index_count, "componentType": _UNSIGNED_INT, "type": "SCALAR"})
    views.append({"buffer": 0, "byteOffset": offset, "byteLength": 4 * index_count, "target": _ELEMENT_BUFFER})
    fields = dict(provenance.lines())
    extras = {"units": "m", "frame": "bed: x along the travel, y across, z up; turned to y up by the node"} | fields
    primitive = {
        "attributes": {name: i for i, name in enumerate(parts)},
        "indices": len(parts),
        "mode": _TRIANGLES,
        "material": 0,
    }
    return {
        "asset": {"version": "2.0", "generator": f"Twinline {fields['software_version']}", "extras": extras},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "bed", "mesh": 0, "rotation": _Z_UP_TO_Y_UP}],
        "meshes": [{"name": "surface", "primitives": [primitive]}],
        # Without one, viewers take the surface for polished metal; an open one is looked at from below too.
        "materials": [
            {
                "name": "measured",
                "doubleSided": True,
                "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 0.9},
            }
        ],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": offset + 4 * index_count}],
    }
