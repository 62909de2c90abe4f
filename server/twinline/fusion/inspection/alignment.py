"""Laying a scan on a reference, in the directions that the scene shows and in no other."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from twinline.arrays import BoolArray, FloatArray
from twinline.errors import InputError
from twinline.fusion.inspection.nearest import MeshSurface
from twinline.fusion.inspection.rigid import RigidMotion, small_motion
from twinline.fusion.inspection.robust import TUKEY

_LEAST = 50
_ITERATIONS = 80
# A direction in which less than this share of the points' normals (mean square) points is not shown: the noise of a
# normal alone feigns about its variance. Reference meshes have clean normals, those of clouds are off by some degrees.
SHOWN_BY_MESH = 1e-3
SHOWN_BY_CLOUD = 5e-3
_NEIGHBOURS = 12

Pairing = Callable[[FloatArray], tuple[FloatArray, FloatArray, BoolArray]]
"""Gives for points (n, 3) their partners, the partners' unit normals, and which of them may be used."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """The motion that lays a scan on its reference.

    Attributes
    ----------
    motion
        From the scan's frame to that of the reference.
    rms_mm
        Of the distances along the normals, of the points used.
    used : (n,) bool array
        Points that had a partner and a weight above zero.
    held : tuple of str
        Directions in which the scene does not tell and the scan was left where it was, in words.
    covariance : (6, 6) array
        Of the turn (rad) about the centre of the scan and its shift (mm); zero along directions that were held.
    sigma_mm
        Standard deviation that the motion gives to a point at the scan's edge.
    iterations
        Until it stood still.
    """

    motion: RigidMotion
    rms_mm: float
    used: BoolArray
    held: tuple[str, ...]
    covariance: FloatArray
    sigma_mm: float
    iterations: int


def align_to_mesh(
    points_mm: FloatArray, surface: MeshSurface, *, start: RigidMotion | None = None, reach_mm: float = np.inf
) -> Alignment:
    """Lay points on a mesh by point-to-plane ICP.

    Parameters
    ----------
    points_mm : (n, 3) array
        All finite.
    surface
        The reference.
    start
        First motion.
    reach_mm
        Points further away than this (after the start) have no partner.

    Raises
    ------
    InputError
        ``cannot-align`` if fewer than 50 points have a partner.
    """

    def pair(points: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        found = surface.nearest(points)
        near = (np.abs(found.signed_mm) <= reach_mm) & ~found.on_border
        return found.points_mm, found.normals, near

    return _align(points_mm, pair, start or RigidMotion.none(), SHOWN_BY_MESH)


def align_to_cloud(
    points_mm: FloatArray, reference_mm: FloatArray, *, start: RigidMotion | None = None, reach_mm: float = np.inf
) -> Alignment:
    """Lay points on a cloud by point-to-plane ICP with normals estimated from the cloud.

    Parameters
    ----------
    points_mm, reference_mm : (n, 3) and (m, 3) arrays
        All finite.
    start, reach_mm
        As for `align_to_mesh`.

    Raises
    ------
    InputError
        ``cannot-align`` if fewer than 50 points have a partner.
    """
    reference = np.asarray(reference_mm, dtype=np.float64)
    tree = cKDTree(reference)
    normals, flat = cloud_normals(reference, tree)

    def pair(points: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        distance, row = tree.query(points)
        return reference[row], normals[row], (distance <= reach_mm) & flat[row]

    return _align(points_mm, pair, start or RigidMotion.none(), SHOWN_BY_CLOUD)


def cloud_normals(points_mm: FloatArray, tree: cKDTree | None = None) -> tuple[FloatArray, BoolArray]:
    """Unit normal of each point from its neighbours, of unknown sign, and whether they lie in a plane at all.

    Parameters
    ----------
    points_mm : (n, 3) array
        All finite.
    """
    tree = tree or cKDTree(points_mm)
    count = min(_NEIGHBOURS, len(points_mm))
    near = np.asarray(points_mm, dtype=np.float64)[tree.query(points_mm, k=count)[1].reshape(len(points_mm), count)]
    near = near - near.mean(axis=1, keepdims=True)
    size, direction = np.linalg.eigh(np.einsum("nki,nkj->nij", near, near))
    # Neighbours along one line leave the normal free to turn about it.
    return np.asarray(direction[:, :, 0]), (size[:, 0] < 0.2 * size[:, 1]) & (size[:, 1] > 0.01 * size[:, 2])


def _align(points_mm: FloatArray, pair: Pairing, start: RigidMotion, shown: float) -> Alignment:
    points = np.asarray(points_mm, dtype=np.float64)
    motion = start
    centre = start.apply(points).mean(axis=0)
    size = max(float(np.sqrt(((start.apply(points) - centre) ** 2).sum(axis=1).mean())), 1e-9)
    iterations = 0
    while iterations < _ITERATIONS:
        iterations += 1
        moved = motion.apply(points)
        weight, residuals, rows, usable = _equations(moved, pair, centre, size)
        normal_matrix = rows.T @ (rows * weight[:, None])
        kept, values, vectors = _shown(normal_matrix, weight, shown)
        right = vectors.T @ (rows.T @ (weight * residuals))
        step = vectors @ np.where(kept, right / np.where(kept, values, 1.0), 0.0)
        change = small_motion(step[:3] / size, step[3:]).about(centre)
        motion = change.after(motion)
        if float(np.abs(step).max()) < 1e-6 * max(float(np.sqrt(np.mean(residuals**2))), 1e-6 * size):
            break
    moved = motion.apply(points)
    weight, residuals, rows, usable = _equations(moved, pair, centre, size)
    kept, values, vectors = _shown(rows.T @ (rows * weight[:, None]), weight, shown)
    inside = weight > 0.0
    variance = float((weight * residuals**2).sum() / max(weight.sum(), 1e-300))
    inverse = (vectors * np.where(kept, 1.0 / np.where(kept, values, 1.0), 0.0)) @ vectors.T * variance
    scale = np.diag([1.0 / size] * 3 + [1.0] * 3)
    used = np.zeros(len(points), dtype=bool)
    used[np.flatnonzero(usable)[inside]] = True
    return Alignment(
        motion,
        float(np.sqrt(np.mean(residuals[inside] ** 2))),
        used,
        tuple(_in_words(vectors[:, k]) for k in np.flatnonzero(~kept)),
        scale @ inverse @ scale,
        float(np.sqrt(np.trace(inverse) / 3.0)),
        iterations,
    )


def _equations(
    moved: FloatArray, pair: Pairing, centre: FloatArray, size: float
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Weights, distances to go along the normals, and their derivatives by turn (times size) and shift."""
    partners, normals, usable = pair(moved)
    if int(usable.sum()) < _LEAST:
        raise InputError(
            f"Only {int(usable.sum())} of {len(moved)} points lie near the reference, too few to align by; "
            "check that both show the same object, or give a rough position.",
            code="cannot-align",
        )
    at, normals = moved[usable], normals[usable]
    residuals = np.einsum("ij,ij->i", partners[usable] - at, normals)
    rows = np.column_stack([np.cross((at - centre) / size, normals), normals])
    scale = max(1.4826 * float(np.median(np.abs(residuals))), 1e-9)
    t = residuals / (TUKEY * scale)
    return np.where(np.abs(t) < 1.0, (1.0 - t**2) ** 2, 0.0), residuals, rows, usable


def _shown(normal_matrix: FloatArray, weight: FloatArray, shown: float) -> tuple[BoolArray, FloatArray, FloatArray]:
    """Which of the motion's own directions the points fix, with their strengths.

    After N. Gelfand, L. Ikemoto, S. Rusinkiewicz and M. Levoy, "Geometrically stable sampling for the ICP algorithm",
    3DIM 2003, whose eigenvectors of small eigenvalue are the motions in which the surface slides along itself.
    """
    values, vectors = np.linalg.eigh(normal_matrix)
    return values > shown * float(weight.sum()), values, vectors


def _in_words(direction: FloatArray) -> str:
    """A motion's direction as "shift along x" or "turn about z"; mixtures name their parts."""
    names = ("turn about x", "turn about y", "turn about z", "shift along x", "shift along y", "shift along z")
    order = np.argsort(-np.abs(direction))
    parts = [names[k] for k in order if abs(direction[k]) > 0.35]
    return " with ".join(parts or [names[order[0]]])
