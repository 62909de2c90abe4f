"""Reading back the cloud.ply of a scan."""

from pathlib import Path
from typing import BinaryIO

import numpy as np

from twinline.errors import InputError
from twinline.fusion.cloud import PointCloud

_TYPES = {"float": "<f4", "uchar": "u1"}
_HEADER_LIMIT = 200
_NEEDED = ("x", "y", "z", "red", "green", "blue", "source", "sigma", "intensity")


def read_cloud(path: Path) -> PointCloud:
    """Read a binary PLY as `twinline.operations.exports.ply.write_ply` writes it, without its normals.

    Raises
    ------
    InputError
        If it cannot be read or is another kind of PLY.
    """
    try:
        with path.open("rb") as stream:
            count, row = _read_header(path, stream)
            rows = np.fromfile(stream, row, count)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}.") from error
    if len(rows) != count:
        raise InputError(f"{path} ends after {len(rows)} of {count} points; make the scan again.")
    return PointCloud(
        np.stack([rows["x"], rows["y"], rows["z"]], axis=1),
        np.ascontiguousarray(rows["sigma"]),
        np.ascontiguousarray(rows["intensity"]),
        np.stack([rows["red"], rows["green"], rows["blue"]], axis=1),
        np.ascontiguousarray(rows["source"]),
    )


def _read_header(path: Path, stream: BinaryIO) -> tuple[int, np.dtype[np.void]]:
    count, fields, binary = -1, [], False
    for _ in range(_HEADER_LIMIT):
        words = stream.readline(4096).decode("utf-8", "replace").split()
        if words == ["end_header"]:
            break
        if words[:1] == ["format"]:
            binary = words[1:2] == ["binary_little_endian"]
        elif words[:2] == ["element", "vertex"] and len(words) == 3 and words[2].isdigit():
            count = int(words[2])
        elif words[:1] == ["property"] and len(words) == 3 and words[1] in _TYPES:
            fields.append((words[2], _TYPES[words[1]]))
    if not binary or count < 0 or not set(_NEEDED) <= {name for name, _ in fields}:
        raise InputError(f"{path} is not a cloud that this version wrote; make the scan again.")
    return count, np.dtype(fields)
