"""GLB: the point cloud for viewers and for the web."""

from pathlib import Path

import numpy as np

from twinline.errors import OutputError
from twinline.fusion.cloud import PointCloud
from twinline.operations.exports.gltf import POINTS, Fields, colour_bytes, scene_of, vertex_accessors, write_container
from twinline.operations.exports.provenance import Provenance


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
    parts = {"POSITION": positions.tobytes(), "COLOR_0": colour_bytes(cloud.colour)}
    if cloud.normals is not None:
        parts["NORMAL"] = np.ascontiguousarray(cloud.normals, dtype="<f4").tobytes()
    accessors, views, size = vertex_accessors(positions, parts)
    primitive: Fields = {"attributes": {name: i for i, name in enumerate(parts)}, "mode": POINTS}
    document = scene_of("cloud", primitive, provenance)
    document |= {"accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": size}]}
    write_container(path, document, list(parts.values()), f"{len(cloud)} points exceed the 4 GB of a GLB; export PLY.")
