"""Grouped observations as rows of a least-squares problem: residuals and their derivatives at one scanner."""

import numpy as np
from scipy.sparse import csr_matrix

from twinline.arrays import FloatArray
from twinline.calibration.joint_model import (
    LaserSamples,
    Scanner,
    TofPoints,
    bed_height,
    bed_jacobian,
    laser_gain,
    laser_jacobian,
    laser_samples,
    tof_jacobian,
    tof_points,
)
from twinline.calibration.joint_types import HOLD_OUT, TOF, Association, KnownPoints, Observations, Rows
from twinline.calibration.observations import StripePoints


def evaluate(scanner: Scanner, observations: Observations, link: Association, *, derivatives: bool = True) -> Rows:
    """All grouped residuals, with their derivatives if wanted."""
    up = scanner.axes()[2]
    camera = scanner.as_camera()
    parts: list[Rows] = []
    for laser, stripes in enumerate(observations.bed):
        if len(stripes):
            samples = laser_samples(scanner, laser, stripes, camera)
            parts.append(_bed_rows(scanner, samples, stripes, up, derivatives))
    if observations.tof_bed is not None and len(observations.tof_bed):
        parts.append(_tof_bed_rows(scanner, observations.tof_bed, up, derivatives))
    parts.extend(_known_rows(scanner, known, up, derivatives) for known in observations.known)
    if len(link.kind):
        parts.append(_pair_rows(scanner, observations, link, derivatives))
    return _stack(parts)


def _stack(parts: list[Rows]) -> Rows:
    jacobians = [p.jacobian for p in parts if p.jacobian is not None]
    return Rows(
        np.concatenate([p.residual for p in parts]),
        np.concatenate([p.noise for p in parts]),
        np.concatenate([p.share for p in parts]),
        np.concatenate([p.kind for p in parts]),
        np.concatenate([p.held_out for p in parts]),
        np.concatenate([p.place for p in parts]),
        np.concatenate(jacobians) if jacobians else None,
    )


def _bed_rows(
    scanner: Scanner, samples: LaserSamples, stripes: StripePoints, up: FloatArray, derivatives: bool
) -> Rows:
    normals = np.broadcast_to(up, samples.points.shape)
    residual = bed_height(scanner, samples.points)
    jacobian = None
    if derivatives:
        jacobian = laser_jacobian(scanner, samples, normals)
        jacobian[:, 12:15] += bed_jacobian(scanner, samples.points)
    noise = laser_gain(scanner, samples, normals) * stripes.sd_px
    number = len(residual)
    # Groups of lanes, not of positions, are left out: the same lanes would predict themselves.
    lane = np.unique(
        np.round(stripes.pixels[:, 0 if scanner.stripe_runs == "along-u" else 1] / 20), return_inverse=True
    )[1]
    return Rows(
        residual, noise, np.full(number, 0.6), np.full(number, samples.laser), lane % HOLD_OUT == 2,
        samples.points @ scanner.axes()[:2].T, jacobian,
    )  # fmt: skip


def _tof_bed_rows(scanner: Scanner, tof: TofPoints, up: FloatArray, derivatives: bool) -> Rows:
    points = tof_points(scanner, tof)
    jacobian = None
    if derivatives:
        jacobian = tof_jacobian(scanner, tof, np.broadcast_to(up, points.shape))
        jacobian[:, 12:15] += bed_jacobian(scanner, points)
    number = len(points)
    return Rows(
        bed_height(scanner, points), np.full(number, 0.005), np.full(number, 0.6), np.full(number, 2),
        np.arange(number) % HOLD_OUT == 2, points @ scanner.axes()[:2].T, jacobian,
    )  # fmt: skip


def _known_rows(scanner: Scanner, known: KnownPoints, up: FloatArray, derivatives: bool) -> Rows:
    samples = laser_samples(scanner, known.laser, known.stripes)
    blocks = np.isnan(known.normal[:, 0])
    normals = np.where(blocks[:, None], up, known.normal)
    residual = np.where(
        blocks,
        bed_height(scanner, samples.points) - known.offset,
        np.einsum("ij,ij->i", known.normal, samples.points) - known.offset,
    )
    noise = laser_gain(scanner, samples, normals) * known.stripes.sd_px
    groups, index, counts = np.unique(known.group, return_inverse=True, return_counts=True)
    average = csr_matrix((1.0 / counts[index], (index, np.arange(len(index)))), shape=(len(groups), len(index)))
    jacobian = None
    if derivatives:
        single = laser_jacobian(scanner, samples, normals)
        single[blocks, 12:15] += bed_jacobian(scanner, samples.points[blocks])
        jacobian = np.asarray(average @ single)
    on_block = bool(blocks.all())
    return Rows(
        np.asarray(average @ residual), np.sqrt(np.asarray(average.power(2) @ noise**2)), np.ones(len(groups)),
        np.full(len(groups), (8 if on_block else 6) + known.laser), groups % HOLD_OUT == 2,
        np.asarray(average @ (samples.points @ scanner.axes()[:2].T)), jacobian,
    )  # fmt: skip


def _pair_rows(scanner: Scanner, observations: Observations, link: Association, derivatives: bool) -> Rows:
    residual = np.zeros(len(link.kind))
    jacobian = np.zeros((len(link.kind), len(scanner.vector()))) if derivatives else None
    camera = scanner.as_camera()
    for sensor, (average, normals, chosen) in enumerate(zip(link.average, link.normals, link.points, strict=True)):
        if not len(chosen):
            continue
        single: FloatArray | None = None
        if sensor == TOF:
            assert observations.tof_objects is not None
            tof = observations.tof_objects.take(chosen)
            points = tof_points(scanner, tof)
            if derivatives:
                single = tof_jacobian(scanner, tof, normals)
        else:
            samples = laser_samples(scanner, sensor, observations.objects[sensor].take(chosen), camera)
            points = samples.points
            if derivatives:
                single = laser_jacobian(scanner, samples, normals)
        residual += average @ np.nan_to_num(np.einsum("ij,ij->i", normals, points))
        if jacobian is not None and single is not None:
            jacobian += average @ np.nan_to_num(single)
    return Rows(residual, link.noise, link.share, link.kind, link.held_out, link.place, jacobian)
