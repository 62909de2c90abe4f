"""Finding where a scan lies on a reference whose coordinates are its own."""

import numpy as np
from scipy.spatial.transform import Rotation

from twinline.arrays import FloatArray
from twinline.errors import InputError
from twinline.fusion.inspection.alignment import Alignment, align_to_mesh
from twinline.fusion.inspection.nearest import MeshSurface
from twinline.fusion.inspection.rigid import RigidMotion

_COARSE = 400
_FINE = 20_000
_CANDIDATES = 6
_YAW_DEG = 30


def place_on_mesh(points_mm: FloatArray, surface: MeshSurface, *, search: bool = True) -> Alignment:
    """Lay a scan on a mesh, from wherever both lie.

    The start is chosen among: as they are; box middle on box middle, turned about z in steps of 30 degrees; and main
    axes on main axes in all 24 ways. Each is tried with few points; the best are refined. An object with symmetries
    fits in several ways, of which any may be taken.

    Parameters
    ----------
    points_mm : (n, 3) array
        All finite.
    surface
        The reference.
    search
        False takes them as they lie.

    Raises
    ------
    InputError
        ``cannot-align`` if too few points come to lie near the mesh.
    """
    points = np.asarray(points_mm, dtype=np.float64)
    rng = np.random.default_rng(0)
    fine = points if len(points) <= _FINE else points[np.sort(rng.choice(len(points), _FINE, replace=False))]
    best = RigidMotion.none()
    if search:
        coarse = fine[np.sort(rng.choice(len(fine), min(_COARSE, len(fine)), replace=False))]
        best = _best_start(coarse, fine, surface)
    aligned = align_to_mesh(fine, surface, start=best)
    if fine is points:
        return aligned
    # The rest of the points share the few fine ones' motion; they are asked once whether they fit it.
    return align_to_mesh(points, surface, start=aligned.motion)


def _best_start(coarse: FloatArray, fine: FloatArray, surface: MeshSurface) -> RigidMotion:
    starts = [RigidMotion.none(), *_yaw_starts(fine, surface), *_axis_starts(fine, surface)]
    ranked = sorted(starts, key=lambda start: _misfit(coarse, surface, start))
    refined: list[tuple[float, RigidMotion]] = []
    for start in ranked[: 2 * _CANDIDATES]:
        try:
            motion = align_to_mesh(coarse, surface, start=start).motion
        except InputError:
            continue
        refined.append((_misfit(coarse, surface, motion), motion))
    if not refined:
        raise InputError(
            "The scan cannot be laid on the reference from any side; check that both show the same object.",
            code="cannot-align",
        )
    return min(refined, key=lambda one: one[0])[1]


def _misfit(points: FloatArray, surface: MeshSurface, motion: RigidMotion) -> float:
    """Mean distance of the nearest four fifths of the points."""
    distance = np.sort(np.abs(surface.nearest(motion.apply(points)).signed_mm))
    return float(distance[: max(int(0.8 * len(distance)), 1)].mean())


def _box_middle(points: FloatArray) -> FloatArray:
    return np.asarray((np.percentile(points, 1.0, axis=0) + np.percentile(points, 99.0, axis=0)) / 2)


def _yaw_starts(points: FloatArray, surface: MeshSurface) -> list[RigidMotion]:
    low, high = surface.mesh.vertices_mm.min(axis=0), surface.mesh.vertices_mm.max(axis=0)
    middle = _box_middle(points)
    starts = []
    for yaw in range(0, 360, _YAW_DEG):
        rotation = np.asarray(Rotation.from_euler("z", yaw, degrees=True).as_matrix())
        turned = points @ rotation.T
        shift = (low + high) / 2 - rotation @ middle
        # From above a scan shows the top: it is the top that has to meet.
        shift[2] = high[2] - float(np.percentile(turned[:, 2], 99.5))
        starts.append(RigidMotion(rotation, shift))
    return starts


def _axis_starts(points: FloatArray, surface: MeshSurface) -> list[RigidMotion]:
    corners = surface.mesh.corners_mm()
    area = np.linalg.norm(surface.mesh.face_vectors_mm2(), axis=1)
    middle = np.average(corners.mean(axis=1), axis=0, weights=area)
    from_middle = corners.mean(axis=1) - middle
    own = np.linalg.eigh(np.einsum("n,ni,nj->ij", area, from_middle, from_middle))[1]
    centre = points.mean(axis=0)
    scan = np.linalg.eigh((points - centre).T @ (points - centre))[1]
    own[:, 0] *= np.sign(np.linalg.det(own))
    scan[:, 0] *= np.sign(np.linalg.det(scan))
    starts = []
    for quarter in Rotation.create_group("O").as_matrix():
        rotation = own @ quarter @ scan.T
        starts.append(RigidMotion(rotation, middle - rotation @ centre))
        # The middle of a box does not depend on how much of which side was seen.
        turned = _box_middle(points @ rotation.T)
        box = (surface.mesh.vertices_mm.min(axis=0) + surface.mesh.vertices_mm.max(axis=0)) / 2
        starts.append(RigidMotion(rotation, box - turned))
    return starts
