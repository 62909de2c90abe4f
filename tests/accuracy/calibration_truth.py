"""How far a cloud lies from the surface of a simulated scene, whatever frame its rig chose.

Distances come from the solids' own formulas, or from the triangles of a relief; nothing of the package's geometry but
the rigid transform in which a rig states its frame.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from twinline.arrays import FloatArray
from twinline.devices.simulator.scenes import Scene
from twinline.devices.simulator.world import Thing
from twinline.geometry.rig import Rig

Distance = Callable[[FloatArray], FloatArray]

CLIP_MM = 5.0
"""Distances count up to this much."""

MARGIN_MM = 12.0
OBJECT_MM = 2.0
_SAMPLE = 2500
_BARYCENTRIC = np.array(
    [[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4], [10, 1, 1], [1, 10, 1], [1, 1, 10]], dtype=np.float64
)
_NEAR_MESH_MM = 0.6


@dataclass(frozen=True)
class Score:
    """Root mean square distance in mm over all points and over those on objects, and their number."""

    rms_mm: float
    objects_mm: float
    points: int


class Surface:
    """The bed and the things on it."""

    def __init__(self, scene: Scene) -> None:
        self._things = [_Mesh(thing) if thing.kind == "mesh" else _Solid(thing) for thing in scene.things]
        self._bounds = [thing.mesh.bounds for thing in scene.things]

    def distance(self, points: FloatArray) -> FloatArray:
        """Distance (n,) of points (n, 3) in the bed frame of the truth, mm."""
        nearest = np.abs(points[:, 2])
        for thing in self._things:
            nearest = np.minimum(nearest, thing.distance(points))
        return np.asarray(nearest)

    def around(self, points: FloatArray) -> FloatArray:
        """Points over the things and a margin."""
        low = np.min([b[0][:2] for b in self._bounds], axis=0) - MARGIN_MM
        high = np.max([b[1][:2] for b in self._bounds], axis=0) + MARGIN_MM
        return np.asarray(points[((points[:, :2] > low) & (points[:, :2] < high)).all(axis=1)])


class _Solid:
    def __init__(self, thing: Thing) -> None:
        self._kind, self._size = thing.kind, thing.dimensions_mm

    def distance(self, points: FloatArray) -> FloatArray:
        size = self._size
        if self._kind == "sphere":
            centre = np.array([size["x"], size["y"], size["z"]])
            return np.asarray(np.abs(np.linalg.norm(points - centre, axis=1) - size["radius"]))
        tall = size["size_z"] if self._kind == "box" else size["height"]
        q = points - np.array([size["x"], size["y"], tall / 2])
        if self._kind == "box":
            c, s = np.cos(np.radians(size["yaw_deg"])), np.sin(np.radians(size["yaw_deg"]))
            across = np.column_stack([c * q[:, 0] + s * q[:, 1], c * q[:, 1] - s * q[:, 0]])
            beyond = np.abs(across) - np.array([size["size_x"], size["size_y"]]) / 2
        else:
            beyond = np.hypot(q[:, 0], q[:, 1])[:, None] - size["radius"]
        beyond = np.column_stack([beyond, np.abs(q[:, 2]) - tall / 2])
        return np.asarray(np.abs(np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0)))


class _Mesh:
    """Distance to the plane of the nearest triangle, which near the surface is that to the triangle."""

    def __init__(self, thing: Thing) -> None:
        self._corners = np.asarray(thing.mesh.vertices)[np.asarray(thing.mesh.faces)]

    @cached_property
    def _samples(self) -> tuple[cKDTree, FloatArray, FloatArray]:
        corners = self._corners
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        weights = _BARYCENTRIC / _BARYCENTRIC.sum(axis=1, keepdims=True)
        places = np.einsum("wk,fkd->wfd", weights, corners).reshape(-1, 3)
        return cKDTree(places), places, np.tile(normals, (len(weights), 1))

    def distance(self, points: FloatArray) -> FloatArray:
        tree, places, normals = self._samples
        found = tree.query(points, distance_upper_bound=CLIP_MM)
        gap, index = np.asarray(found[0]), np.asarray(found[1])
        near = np.isfinite(gap)
        out = np.full(len(points), CLIP_MM)
        plane = np.abs(np.einsum("ij,ij->i", points[near] - places[index[near]], normals[index[near]]))
        out[near] = np.where(gap[near] < _NEAR_MESH_MM, plane, gap[near])
        return out


def score(points: FloatArray, rig: Rig, true: Rig, surface: Surface) -> Score:
    """Judge a cloud in the rig's own frame after the rigid motion that suits the true surface best.

    Both rigs are of one machine, so the camera's frame is common to them and gives the start.
    """
    there = true.bed_from_camera.apply(rig.bed_from_camera.inverse().apply(np.asarray(points, dtype=np.float64)))
    there = aligned(surface.around(there), surface.distance)
    distance = np.minimum(surface.distance(there), CLIP_MM)
    objects = distance[there[:, 2] > OBJECT_MM]
    return Score(float(np.sqrt(np.mean(distance**2))), float(np.sqrt(np.mean(objects**2))), len(distance))


def aligned(points: FloatArray, distance: Distance) -> FloatArray:
    """The points after the rigid motion, without scale, that brings them nearest to the surface."""
    rng = np.random.default_rng(0)
    halves = (points[points[:, 2] > OBJECT_MM], points[points[:, 2] <= OBJECT_MM])
    sample = np.concatenate([half[rng.integers(0, len(half), _SAMPLE)] for half in halves if len(half)])
    middle = points.mean(axis=0)

    def moved(motion: FloatArray, cloud: FloatArray) -> FloatArray:
        turn = Rotation.from_rotvec(motion[:3] / 100).as_matrix()
        return np.asarray((cloud - middle) @ turn.T + middle + motion[3:])

    def distances(motion: FloatArray) -> FloatArray:
        return np.minimum(distance(moved(motion, sample)), CLIP_MM)

    best = least_squares(distances, np.zeros(6), loss="soft_l1", f_scale=0.1, diff_step=np.full(6, 1e-3))
    return moved(best.x, points)
