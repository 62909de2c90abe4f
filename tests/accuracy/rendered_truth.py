"""The true machine and the true surfaces of the rendered sample, as its ``truth.json`` states them.

Nothing here is taken from the package's own geometry but the containers that a rig is handed over in: distances come
from the analytic solids, and the surface seen from above from the height of each solid over a grid.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from twinline.arrays import FloatArray
from twinline.geometry.camera import Camera
from twinline.geometry.rig import Rig, Transform
from twinline.geometry.sheet import LaserSheet

Floats = NDArray[np.float64]

HALF_WIDTH_MM = (55.0, 90.0)
"""Points and surface within so many millimetres of the world's origin are judged."""

CLIP_MM = 5.0
OBJECT_MM = 2.0
GROSS_MM = 1.0
GRID_MM = 0.5
COVER_MM = 0.5


@dataclass(frozen=True)
class Solid:
    """One solid of the scene.

    Attributes
    ----------
    kind
        "box", "sphere" or "cylinder" (about z).
    centre : (3,) array
        In world millimetres.
    half : (3,) array
        Half sizes of a box; radius, radius and half height of a cylinder; a sphere's radius first.
    yaw_rad
        Turn of a box about z.
    """

    kind: str
    centre: Floats
    half: Floats
    yaw_rad: float

    def local(self, points: Floats) -> Floats:
        """World points (n, 3) in the solid's own axes."""
        q = points - self.centre
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        return np.column_stack([c * q[:, 0] + s * q[:, 1], c * q[:, 1] - s * q[:, 0], q[:, 2]])

    def distance(self, points: Floats) -> Floats:
        """Distance (n,) from world points to the solid's surface, inside or outside, in millimetres."""
        q = self.local(points)
        if self.kind == "sphere":
            return np.asarray(np.abs(np.linalg.norm(q, axis=1) - self.half[0]))
        if self.kind == "cylinder":
            beyond = np.column_stack([np.hypot(q[:, 0], q[:, 1]) - self.half[0], np.abs(q[:, 2]) - self.half[2]])
        else:
            beyond = np.abs(q) - self.half
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
        return np.asarray(np.abs(outside + np.minimum(beyond.max(axis=1), 0.0)))

    def top(self, x: Floats, y: Floats) -> Floats:
        """Height of the solid's upper surface over places (n,), 0 where it is not."""
        q = self.local(np.column_stack([x, y, np.full_like(x, self.centre[2])]))
        radius2 = q[:, 0] ** 2 + q[:, 1] ** 2
        if self.kind == "sphere":
            under = self.half[0] ** 2 - radius2
            return np.where(under >= 0, self.centre[2] + np.sqrt(np.maximum(under, 0.0)), 0.0)
        if self.kind == "cylinder":
            inside = radius2 <= self.half[0] ** 2
        else:
            inside = (np.abs(q[:, 0]) <= self.half[0]) & (np.abs(q[:, 1]) <= self.half[1])
        return np.where(inside, self.centre[2] + self.half[2], 0.0)


@dataclass(frozen=True)
class Score:
    """How a cloud compares with the truth.

    Attributes
    ----------
    points
        Number of points that were judged.
    rms_mm, objects_mm, median_mm
        Distance to the true surface: root mean square over all points and over those above 2 mm, and the median.
    gross
        Share of points further than 1 mm from it.
    covered
        Share of the surface seen from above within 0.5 mm of a point.
    """

    points: int
    rms_mm: float
    objects_mm: float
    median_mm: float
    gross: float
    covered: float


@dataclass(frozen=True)
class RenderedTruth:
    """What ``truth.json`` says."""

    rig: Rig
    solids: tuple[Solid, ...]

    def distance(self, points: Floats) -> Floats:
        """Distance (n,) from world points (n, 3) to the nearest true surface, in millimetres."""
        nearest = np.abs(points[:, 2])
        for solid in self.solids:
            nearest = np.minimum(nearest, solid.distance(points))
        return nearest

    def seen_from_above(self) -> Floats:
        """The surface over a grid of 0.5 mm, (n, 3): what a scan from above could cover."""
        axes = (np.arange(-half + GRID_MM / 2, half, GRID_MM) for half in HALF_WIDTH_MM)
        x, y = (a.ravel() for a in np.meshgrid(*axes))
        z = np.max([np.zeros_like(x), *(solid.top(x, y) for solid in self.solids)], axis=0)
        return np.column_stack([x, y, z])

    def score(self, points: FloatArray) -> Score:
        """Judge a cloud (n, 3) in world millimetres."""
        all_points = np.asarray(points, dtype=np.float64)
        near = (np.abs(all_points[:, 0]) < HALF_WIDTH_MM[0]) & (np.abs(all_points[:, 1]) < HALF_WIDTH_MM[1])
        kept = all_points[near]
        distance = self.distance(kept)
        clipped = np.minimum(distance, CLIP_MM)
        objects = clipped[kept[:, 2] > OBJECT_MM]
        gap, _ = cKDTree(kept).query(self.seen_from_above(), distance_upper_bound=COVER_MM)
        return Score(
            points=len(kept),
            rms_mm=float(np.sqrt(np.mean(clipped**2))),
            objects_mm=float(np.sqrt(np.mean(objects**2))),
            median_mm=float(np.median(clipped)),
            gross=float(np.mean(distance > GROSS_MM)),
            covered=float(np.mean(np.isfinite(gap))),
        )


def read_truth(folder: Path) -> RenderedTruth:
    """The truth beside a rendered capture."""
    truth: dict[str, Any] = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    size = json.loads((folder / "capture.json").read_text(encoding="utf-8"))["image_size"]
    travel = np.array(truth["travel_in_world_per_commanded_mm"])
    # The truth gives the camera where the world's cart is at 0, which is another place than the pass's own 0.
    centre = np.array(truth["camera_centre_in_world_mm_at_cart_0_of_the_world"])
    start = centre - travel * truth["cart_mm_of_world_origin"]
    first, second = truth["sheets"]
    rig = Rig(
        name="truth",
        camera=Camera(np.array(truth["camera_matrix"]), (size[0], size[1]), np.array(truth["distortion_k1k2p1p2k3"])),
        stripe_runs="along-u",
        sheets=(
            LaserSheet(np.array(first["normal_in_camera"]), first["offset_mm"], "+v"),
            LaserSheet(np.array(second["normal_in_camera"]), second["offset_mm"], "-v"),
        ),
        bed_from_camera=Transform(np.array(truth["world_from_camera_rotation"]), start),
        travel=travel,
    )
    solids = tuple(
        Solid(s["kind"], np.array(s["centre"]), np.array(s["half_size_or_radius"]), s["yaw_rad"])
        for s in truth["scene_in_world_mm"]
        if s["kind"] != "bed"
    )
    return RenderedTruth(rig, solids)
