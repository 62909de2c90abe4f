"""Clouds of known points."""

import numpy as np

from twinline.fusion.cloud import PointCloud
from twinline.operations.exports.provenance import Provenance

PROVENANCE = Provenance("3f2a9c", "three objects", "0.1.0")


def random_cloud(count: int, *, normals: bool = False) -> PointCloud:
    rng = np.random.default_rng(20240607)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return PointCloud(
        points_mm=rng.uniform(-200, 200, (count, 3)).astype(np.float32),
        sigma_mm=rng.uniform(0.01, 0.2, count).astype(np.float32),
        intensity=rng.uniform(0, 255, count).astype(np.float32),
        colour=rng.integers(0, 256, (count, 3)).astype(np.uint8),
        source=rng.integers(1, 6, count).astype(np.uint8),
        normals=direction.astype(np.float32) if normals else None,
    )
