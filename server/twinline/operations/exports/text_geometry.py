"""OBJ and XYZ: geometry as text that every program reads, in millimetres.

OBJ is Wavefront, "Advanced Visualizer, appendix B1" with the usual colours after the coordinates; XYZ is a line of
``x y z r g b`` a point.
"""

from pathlib import Path

import numpy as np

from twinline.errors import OutputError
from twinline.fusion.cloud import PointCloud
from twinline.fusion.mesh import TriangleMesh
from twinline.operations.exports.atomic import atomic_path
from twinline.operations.exports.provenance import Provenance
from twinline.operations.exports.stl import require_mesh

_BLOCK = 1 << 15
# A tenth of a micrometre: well below what is measured, and short.
_PLACE = "%.4f %.4f %.4f"


def write_obj(path: Path, mesh: TriangleMesh, provenance: Provenance) -> None:
    """Write a mesh as OBJ with normals, and colours from 0 to 1 after the coordinates where it has them.

    Raises
    ------
    OutputError
        If the file cannot be written, or the mesh has no triangle or corners that are not finite; nothing is left
        behind then.
    """
    require_mesh(path, mesh)
    vertices = mesh.vertices_mm
    line = f"v {_PLACE}\n"
    if mesh.colour is not None:
        vertices = np.column_stack([vertices, mesh.colour / 255.0])
        line = f"v {_PLACE} %.4f %.4f %.4f\n"
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as stream:
        stream.write("# units mm\n")
        stream.writelines(f"# {name} {value}\n" for name, value in provenance.lines())
        for rows, text in (
            (vertices, line),
            (mesh.vertex_normals(), "vn %.4f %.4f %.4f\n"),
            (np.repeat(mesh.faces + 1, 2, axis=1), "f %d//%d %d//%d %d//%d\n"),
        ):
            for start in range(0, len(rows), _BLOCK):
                stream.write("".join(text % tuple(row) for row in rows[start : start + _BLOCK].tolist()))


def write_xyz(path: Path, cloud: PointCloud) -> None:
    """Write a cloud as lines of ``x y z r g b``, without a header, since not every reader skips one.

    Raises
    ------
    OutputError
        If the file cannot be written, or the cloud has no point or one that is not finite; nothing is left behind then.
    """
    if not len(cloud) or not np.isfinite(cloud.points_mm).all():
        cause = "has points that are not finite" if len(cloud) else "has no points"
        raise OutputError(f"{path} cannot be written: the cloud {cause}.")
    line = f"{_PLACE} %d %d %d\n"
    with atomic_path(path) as temporary, temporary.open("w", encoding="ascii", newline="\n") as stream:
        for start in range(0, len(cloud), _BLOCK):
            part = slice(start, start + _BLOCK)
            rows = zip(cloud.points_mm[part].tolist(), cloud.colour[part].tolist(), strict=True)
            stream.write("".join(line % (*point, *colour) for point, colour in rows))
