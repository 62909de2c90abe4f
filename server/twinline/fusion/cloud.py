"""The point cloud: what every pass ends in."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from twinline.arrays import BoolArray, ByteArray, FloatArray, IntArray


class Source(IntEnum):
    """Which sensor a point came from; the numbers are those of the PLY property ``source``."""

    LASER_1 = 1
    LASER_2 = 2
    BOTH_LASERS = 3
    TOF = 4
    FILLED = 5


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Measured points in the bed frame.

    Attributes
    ----------
    points_mm : (n, 3) float32 array
        x along the travel, y across, z above the bed.
    sigma_mm : (n,) float32 array
        Standard deviation of the point along its line of largest uncertainty, from the stripe's own.
    intensity : (n,) float32 array
        Amplitude of the stripe in grey levels.
    colour : (n, 3) uint8 array
        Red, green, blue of the surface in ambient light.
    source : (n,) uint8 array
        One of `Source`.
    normals : (n, 3) float32 array or None
        Unit normals, outward; None where they have not been estimated.
    """

    points_mm: FloatArray
    sigma_mm: FloatArray
    intensity: FloatArray
    colour: ByteArray
    source: ByteArray
    normals: FloatArray | None = None

    def __post_init__(self) -> None:
        n = len(self.points_mm)
        shapes = {
            "points_mm": (n, 3), "sigma_mm": (n,), "intensity": (n,), "colour": (n, 3), "source": (n,),
        }  # fmt: skip
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} has shape {getattr(self, name).shape}, expected {shape}")
        if self.normals is not None and self.normals.shape != (n, 3):
            raise ValueError(f"normals has shape {self.normals.shape}, expected {(n, 3)}")

    def __len__(self) -> int:
        return len(self.points_mm)

    def select(self, rows: BoolArray | IntArray) -> "PointCloud":
        """The points in the given rows."""
        places = np.flatnonzero(rows) if rows.dtype == bool else rows
        return PointCloud(
            self.points_mm.take(places, axis=0),
            self.sigma_mm.take(places),
            self.intensity.take(places),
            self.colour.take(places, axis=0),
            self.source.take(places),
            None if self.normals is None else self.normals.take(places, axis=0),
        )

    @classmethod
    def empty(cls) -> "PointCloud":
        """A cloud of no points."""
        return cls(
            np.empty((0, 3), np.float32),
            np.empty(0, np.float32),
            np.empty(0, np.float32),
            np.empty((0, 3), np.uint8),
            np.empty(0, np.uint8),
        )

    @classmethod
    def concatenate(cls, clouds: Sequence["PointCloud"]) -> "PointCloud":
        """All points of all clouds, in order; normals are kept only if every cloud has them."""
        if not clouds:
            return cls.empty()
        normals = [c.normals for c in clouds if c.normals is not None]
        return cls(
            np.concatenate([c.points_mm for c in clouds]),
            np.concatenate([c.sigma_mm for c in clouds]),
            np.concatenate([c.intensity for c in clouds]),
            np.concatenate([c.colour for c in clouds]),
            np.concatenate([c.source for c in clouds]),
            np.concatenate(normals) if len(normals) == len(clouds) else None,
        )
