"""PLY: the point cloud with everything that is known of each point.

The format is G. Turk, "The PLY Polygon File Format" (1994). Lengths are millimetres in the bed frame.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twinline.fusion.cloud import PointCloud
from twinline.operations.exports.atomic import atomic_path
from twinline.operations.exports.provenance import Provenance

_PLY_TYPES = {"f4": "float", "u1": "uchar"}
# Points converted at a time, so that writing a large cloud does not need its memory once more.
_BLOCK = 1 << 17


def write_ply(path: Path, cloud: PointCloud, provenance: Provenance, *, ascii: bool = False) -> None:
    """Write a point cloud as PLY.

    Properties are ``x y z``, ``nx ny nz`` (only if the cloud has normals), ``red green blue``, ``source``, ``sigma``
    and ``intensity``; comments carry the units, the frame and the provenance.

    Parameters
    ----------
    ascii
        Text instead of binary little endian; values read back exactly.

    Raises
    ------
    OutputError
        If the file cannot be written; nothing is left behind then.
    """
    fields = _fields(cloud)
    row = np.dtype([(name, f"<{kind}" if kind == "f4" else kind) for name, kind in fields])
    line = " ".join("%.9g" if kind == "f4" else "%d" for _, kind in fields) + "\n"
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        stream.write(_header(len(cloud), fields, provenance, ascii=ascii))
        for start in range(0, len(cloud), _BLOCK):
            rows = _rows(cloud, slice(start, start + _BLOCK), row)
            if ascii:
                stream.write("".join(line % values for values in rows.tolist()).encode("ascii"))
            else:
                stream.write(rows.tobytes())


def _fields(cloud: PointCloud) -> tuple[tuple[str, str], ...]:
    normals = ("nx", "ny", "nz") if cloud.normals is not None else ()
    return (
        *((name, "f4") for name in ("x", "y", "z", *normals)),
        *((name, "u1") for name in ("red", "green", "blue", "source")),
        *((name, "f4") for name in ("sigma", "intensity")),
    )


def _header(count: int, fields: tuple[tuple[str, str], ...], provenance: Provenance, *, ascii: bool) -> bytes:
    lines = [
        "ply",
        f"format {'ascii' if ascii else 'binary_little_endian'} 1.0",
        "comment units mm",
        "comment frame bed: x along the travel, y across, z up, z = 0 on the bed",
        "comment source 1 laser 1, 2 laser 2, 3 both lasers, 4 ToF, 5 filled; sigma is one standard deviation in mm",
        *(f"comment {name} {value}" for name, value in provenance.lines()),
        f"element vertex {count}",
        *(f"property {_PLY_TYPES[kind]} {name}" for name, kind in fields),
        "end_header",
    ]
    return ("\n".join(lines) + "\n").encode("utf-8")


def _rows(cloud: PointCloud, part: slice, row: np.dtype[np.void]) -> NDArray[np.void]:
    points, colour = cloud.points_mm[part], cloud.colour[part]
    rows = np.empty(len(points), dtype=row)
    for axis, name in enumerate(("x", "y", "z")):
        rows[name] = points[:, axis]
    if cloud.normals is not None:
        for axis, name in enumerate(("nx", "ny", "nz")):
            rows[name] = cloud.normals[part, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        rows[name] = colour[:, channel]
    rows["source"] = cloud.source[part]
    rows["sigma"] = cloud.sigma_mm[part]
    rows["intensity"] = cloud.intensity[part]
    return rows
