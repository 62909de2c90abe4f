"""What a GLB of points and one of triangles have in common.

The format is Khronos Group, "glTF 2.0 Specification", chapters 3 and 4: metres, +Y up, little endian.
"""

import json
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np

from twinline.arrays import ByteArray, FloatArray
from twinline.errors import OutputError
from twinline.operations.exports.atomic import atomic_path
from twinline.operations.exports.provenance import Provenance

FLOAT, UNSIGNED_BYTE, UNSIGNED_INT = 5126, 5121, 5125
ARRAY_BUFFER, ELEMENT_BUFFER = 34962, 34963
POINTS, TRIANGLES = 0, 4
# Turns the bed frame's z up into glTF's y up: x, y, z becomes x, z, -y. Quaternion x, y, z, w.
_Z_UP_TO_Y_UP = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]
_MAX_BYTES = 2**32 - 1

Fields: TypeAlias = dict[str, object]


def colour_bytes(colour: ByteArray) -> bytes:
    """Colours (n, 3) with a fourth byte each, since glTF wants every vertex aligned to four."""
    colours = np.full((len(colour), 4), 255, dtype=np.uint8)
    colours[:, :3] = colour
    return colours.tobytes()


def vertex_accessors(positions: FloatArray, parts: Mapping[str, bytes]) -> tuple[list[Fields], list[Fields], int]:
    """Accessors and buffer views of vertex attributes that follow one another, and the byte after the last one.

    Parameters
    ----------
    positions : (n, 3) array
        Metres.
    parts
        Bytes by attribute name: "POSITION", "NORMAL" and, four bytes a vertex, "COLOR_0".
    """
    accessors: list[Fields] = []
    views: list[Fields] = []
    offset = 0
    for name, data in parts.items():
        accessor: Fields = {"bufferView": len(views), "count": len(positions)}
        if name == "COLOR_0":
            accessor |= {"componentType": UNSIGNED_BYTE, "normalized": True, "type": "VEC4"}
        else:
            accessor |= {"componentType": FLOAT, "type": "VEC3"}
        if name == "POSITION":
            accessor |= {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
        accessors.append(accessor)
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": len(data), "target": ARRAY_BUFFER})
        offset += len(data)
    return accessors, views, offset


def scene_of(name: str, primitive: Fields, provenance: Provenance) -> Fields:
    """Asset, scene, node and mesh around one primitive in the bed frame."""
    fields = dict(provenance.lines())
    extras = {"units": "m", "frame": "bed: x along the travel, y across, z up; turned to y up by the node"} | fields
    return {
        "asset": {"version": "2.0", "generator": f"Twinline {fields['software_version']}", "extras": extras},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "bed", "mesh": 0, "rotation": _Z_UP_TO_Y_UP}],
        "meshes": [{"name": name, "primitives": [primitive]}],
    }


def write_container(path: Path, document: Fields, parts: Sequence[bytes], too_large: str) -> None:
    """Write document and binary parts as one GLB, whole or not at all.

    Parameters
    ----------
    too_large
        What exceeds the format's 4 GB, and the next step, if it does.

    Raises
    ------
    OutputError
        The file cannot be written, or is too large.
    """
    text = json.dumps(document, ensure_ascii=False, allow_nan=False).encode("utf-8")
    text += b" " * (-len(text) % 4)
    body = sum(len(data) for data in parts)
    total = 12 + 8 + len(text) + 8 + body
    if total > _MAX_BYTES:
        raise OutputError(f"{path} cannot be written: {too_large}")
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        stream.write(struct.pack("<4sII", b"glTF", 2, total))
        stream.write(struct.pack("<I4s", len(text), b"JSON") + text)
        stream.write(struct.pack("<I4s", body, b"BIN\0"))
        for data in parts:
            stream.write(data)
