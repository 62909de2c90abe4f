"""GLB: the mesh for viewers, for the web and for other programs."""

from pathlib import Path

import numpy as np

from twinline.arrays import FloatArray
from twinline.fusion.mesh import TriangleMesh
from twinline.operations.exports.gltf import (
    ELEMENT_BUFFER,
    TRIANGLES,
    UNSIGNED_INT,
    Fields,
    colour_bytes,
    scene_of,
    vertex_accessors,
    write_container,
)
from twinline.operations.exports.provenance import Provenance
from twinline.operations.exports.stl import require_mesh

# Without one, viewers take the surface for polished metal; an open one is looked at from below too.
_MATERIAL: Fields = {
    "name": "measured",
    "doubleSided": True,
    "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 0.9},
}


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
        parts["COLOR_0"] = colour_bytes(mesh.colour)
    indices = np.ascontiguousarray(mesh.faces, dtype="<u4").tobytes()
    accessors, views, offset = vertex_accessors(positions, parts)
    accessors.append({
        "bufferView": len(views), "count": mesh.faces.size, "componentType": UNSIGNED_INT, "type": "SCALAR"
    })  # fmt: skip
    views.append({"buffer": 0, "byteOffset": offset, "byteLength": len(indices), "target": ELEMENT_BUFFER})
    primitive: Fields = {
        "attributes": {name: i for i, name in enumerate(parts)},
        "indices": len(parts),
        "mode": TRIANGLES,
        "material": 0,
    }
    document = scene_of("surface", primitive, provenance)
    document |= {
        "materials": [_MATERIAL],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": offset + len(indices)}],
    }
    too_large = f"{len(mesh.faces)} triangles exceed the 4 GB of a GLB; simplify."
    write_container(path, document, [*parts.values(), indices], too_large)


def _normals(mesh: TriangleMesh) -> FloatArray:
    normals = mesh.vertex_normals()
    # glTF demands unit length also of corners without a triangle, or whose triangles cancel.
    normals[np.linalg.norm(normals, axis=1) < 0.5] = (0.0, 0.0, 1.0)
    return np.ascontiguousarray(normals, dtype="<f4")
