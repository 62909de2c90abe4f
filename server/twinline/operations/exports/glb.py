"""GLB: the point cloud for viewers and for the web.

The format is Khronos Group, "glTF 2.0 Specification", chapters 3 and 4: metres, +Y up, little endian.
"""

import json
import struct
from pathlib import Path

import numpy as np

from twinline.arrays import FloatArray
from twinline.errors import OutputError
from twinline.fusion.cloud import PointCloud
from twinline.operations.exports.atomic import atomic_path
from twinline.operations.exports.provenance import Provenance

_FLOAT, _UNSIGNED_BYTE, _POINTS, _ARRAY_BUFFER = 5126, 5121, 0, 34962
# Turns the bed frame's z up into glTF's y up: x, y, z becomes x, z, -y. Quaternion x, y, z, w.
_Z_UP_TO_Y_UP = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]
_MAX_BYTES = 2**32 - 1


def write_glb(path: Path, cloud: PointCloud, provenance: Provenance) -> None:
    """Write a point cloud as GLB.

    Vertices are metres in the bed frame; the node turns them to glTF's y up. Colours are in ``COLOR_0``, normals in
    ``NORMAL`` where the cloud has them, and the provenance in ``asset.extras``.

    Raises
    ------
    OutputError
        If the file cannot be written, the cloud has no point or one that is not finite, or it exceeds the 4 GB that
        the format can hold; nothing is left behind then.
    """
    if not len(cloud):
        raise OutputError(f"{path} cannot be written: the cloud has no points, and GLB cannot hold an empty one.")
    metres = np.asarray(cloud.points_mm, dtype=np.float64) / 1000.0
    positions = np.ascontiguousarray(metres, dtype="<f4")
    if not np.isfinite(positions).all():
        raise OutputError(f"{path} cannot be written: the cloud has points that are not finite.")
    # Four bytes a colour, since glTF wants every vertex aligned to four.
    colours = np.full((len(cloud), 4), 255, dtype=np.uint8)
    colours[:, :3] = cloud.colour
    parts = {"POSITION": positions.tobytes(), "COLOR_0": colours.tobytes()}
    if cloud.normals is not None:
        parts["NORMAL"] = np.ascontiguousarray(cloud.normals, dtype="<f4").tobytes()
    text = json.dumps(_document(positions, parts, provenance), ensure_ascii=False, allow_nan=False).encode("utf-8")
    text += b" " * (-len(text) % 4)
    body = sum(len(data) for data in parts.values())
    total = 12 + 8 + len(text) + 8 + body
    if total > _MAX_BYTES:
        raise OutputError(f"{path} cannot be written: {len(cloud)} points exceed the 4 GB of a GLB; export PLY.")
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        stream.write(struct.pack("<4sII", b"glTF", 2, total))
        stream.write(struct.pack("<I4s", len(text), b"JSON") + text)
        stream.write(struct.pack("<I4s", body, b"BIN\0"))
        for data in parts.values():
            stream.write(data)


def _document(positions: FloatArray, parts: dict[str, bytes], provenance: Provenance) -> dict[str, object]:
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
    fields = dict(provenance.lines())
    extras = {"units": "m", "frame": "bed: x along the travel, y across, z up; turned to y up by the node"} | fields
    return {
        "asset": {"version": "2.0", "generator": f"Twinline {fields['software_version']}", "extras": extras},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "bed", "mesh": 0, "rotation": _Z_UP_TO_Y_UP}],
        "meshes": [
            {
                "name": "cloud",
                "primitives": [{"attributes": {name: i for i, name in enumerate(parts)}, "mode": _POINTS}],
            }
        ],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": offset}],
    }
