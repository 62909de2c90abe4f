"""Points of a written cloud, read by a library that is not the package's own."""

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray


def read_points(path: Path) -> NDArray[np.float64]:
    """Vertices (n, 3) of a PLY without faces."""
    cloud = trimesh.load(path)
    assert isinstance(cloud, trimesh.PointCloud)
    return np.asarray(cloud.vertices, dtype=np.float64)
