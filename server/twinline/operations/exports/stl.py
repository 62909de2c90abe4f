"""STL: the mesh for printing and for CAD, in millimetres.

The format is 3D Systems, "StereoLithography Interface Specification" (1989): an 80-byte header, a count, and 50 bytes a
triangle.
"""

import struct
from pathlib import Path

import numpy as np

from twinline.errors import OutputError
from twinline.fusion.mesh import TriangleMesh
from twinline.operations.exports.atomic import atomic_path
from twinline.operations.exports.provenance import Provenance

_ROW = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_BLOCK = 1 << 17


def write_stl(path: Path, mesh: TriangleMesh, provenance: Provenance) -> None:
    """Write a mesh as binary STL; the header names units, rig, recording and version as far as its 80 bytes reach.

    Raises
    ------
    OutputError
        If the file cannot be written, or the mesh has no triangle or corners that are not finite; nothing is left
        behind then.
    """
    require_mesh(path, mesh)
    fields = dict(provenance.lines())
    # Readers take a file that begins with "solid" for text.
    text = f"Twinline {fields['software_version']} mm rig {fields['rig_id']} recording {fields['recording_id']}"
    header = text.encode("ascii", "replace")[:80].ljust(80)
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        stream.write(header + struct.pack("<I", len(mesh.faces)))
        for start in range(0, len(mesh.faces), _BLOCK):
            part = TriangleMesh(mesh.vertices_mm, mesh.faces[start : start + _BLOCK])
            vectors = part.face_vectors_mm2()
            length = np.linalg.norm(vectors, axis=1, keepdims=True)
            rows = np.zeros(len(part.faces), dtype=_ROW)
            rows["normal"] = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0)
            rows["corners"] = part.corners_mm()
            stream.write(rows.tobytes())


def require_mesh(path: Path, mesh: TriangleMesh) -> None:
    """Refuse to write a mesh that no reader could show.

    Raises
    ------
    OutputError
        If it has no triangle, or corners that are not finite.
    """
    if not len(mesh.faces):
        raise OutputError(f"{path} cannot be written: the mesh has no triangles.")
    if not np.isfinite(mesh.vertices_mm).all():
        raise OutputError(f"{path} cannot be written: the mesh has corners that are not finite.")
