from collections.abc import Callable

import numpy as np
import pytest

from tests.unit.calibration.scanner_samples import crooked_rig
from twinline.arrays import FloatArray
from twinline.calibration.joint_model import (
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
from twinline.calibration.observations import StripePoints
from twinline.calibration.scanner import scanner_of_rig
from twinline.geometry.triangulation import stripe_points


@pytest.fixture
def scanner() -> Scanner:
    return scanner_of_rig(crooked_rig())


@pytest.fixture
def stripes() -> StripePoints:
    rng = np.random.default_rng(11)
    pixels = np.column_stack([rng.uniform(0, 1279, 60), rng.uniform(200, 600, 60)])
    return StripePoints(pixels, np.full(60, 0.1), rng.uniform(0, 200, 60))


@pytest.fixture
def readings() -> TofPoints:
    rng = np.random.default_rng(12)
    return TofPoints(
        rng.uniform(0, 200, 40),
        rng.uniform(-90, 90, 40),
        rng.uniform(0, 4095, 40),
        rng.normal(0, 20, 40),
        np.full(40, 0.01),
    )


def normals(count: int) -> FloatArray:
    vectors = np.random.default_rng(13).normal(size=(count, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def numeric(scanner: Scanner, function: Callable[[Scanner], FloatArray], steps: FloatArray) -> FloatArray:
    theta = scanner.vector()
    columns = []
    for i, step in enumerate(steps):
        ends = []
        for sign in (1.0, -1.0):
            moved = theta.copy()
            moved[i] += sign * step
            ends.append(function(scanner.with_vector(moved)))
        columns.append((ends[0] - ends[1]) / (2 * step))
    return np.stack(columns, axis=1)


def steps_of(scanner: Scanner) -> FloatArray:
    return np.maximum(np.abs(scanner.vector()) * 1e-5, 1e-7)


@pytest.mark.parametrize("laser", [0, 1])
def test_lasers_derivatives_are_those_of_the_points(scanner: Scanner, stripes: StripePoints, laser: int) -> None:
    along = normals(len(stripes))
    analytic = laser_jacobian(scanner, laser_samples(scanner, laser, stripes), along)
    expected = numeric(
        scanner, lambda s: np.einsum("ij,ij->i", along, laser_samples(s, laser, stripes).points), steps_of(scanner)
    )
    scale = np.abs(expected).max(axis=0) + 1e-9
    np.testing.assert_allclose(analytic / scale, expected / scale, atol=1e-5)


def test_tof_derivatives_are_those_of_the_points(scanner: Scanner, readings: TofPoints) -> None:
    along = normals(len(readings))
    analytic = tof_jacobian(scanner, readings, along)
    expected = numeric(scanner, lambda s: np.einsum("ij,ij->i", along, tof_points(s, readings)), steps_of(scanner))
    scale = np.abs(expected).max(axis=0) + 1e-9
    np.testing.assert_allclose(analytic / scale, expected / scale, atol=1e-5)


def test_the_beds_derivatives_are_those_of_the_heights(scanner: Scanner, stripes: StripePoints) -> None:
    points = laser_samples(scanner, 0, stripes).points
    expected = numeric(scanner, lambda s: bed_height(s, points), steps_of(scanner))[:, 12:15]
    np.testing.assert_allclose(bed_jacobian(scanner, points), expected, rtol=1e-4)


def test_a_pixel_moves_the_point_as_far_as_triangulating_it_again_says(scanner: Scanner, stripes: StripePoints) -> None:
    along = normals(len(stripes))
    moved = StripePoints(stripes.pixels + np.array([0.0, 1e-3]), stripes.sd_px, stripes.cart_mm)
    here, there = laser_samples(scanner, 0, stripes), laser_samples(scanner, 0, moved)
    expected = np.abs(np.einsum("ij,ij->i", along, there.points - here.points)) / 1e-3
    np.testing.assert_allclose(laser_gain(scanner, here, along), expected, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("laser", [0, 1])
def test_points_are_those_of_the_rig_in_another_frame(stripes: StripePoints, laser: int) -> None:
    rig = crooked_rig()
    points = laser_samples(scanner_of_rig(rig), laser, stripes).points
    for i in range(0, len(stripes), 7):
        expected = stripe_points(rig, laser, stripes.pixels[i : i + 1], stripes.sd_px[i : i + 1], stripes.cart_mm[i])[0]
        np.testing.assert_allclose(rig.bed_from_camera.apply(points[i : i + 1]), expected, atol=1e-9)


def test_the_tof_mount_survives_the_way_to_a_scanner_and_back() -> None:
    rig = crooked_rig()
    assert rig.tof is not None
    scanner = scanner_of_rig(rig)
    mount = scanner.as_tof(rig.tof.range_mm)
    assert mount is not None
    # The rig's own x axis is turned to the travel, which it is already; its frame stays.
    np.testing.assert_allclose(scanner.axes(), rig.bed_from_camera.rotation, atol=1e-9)
    np.testing.assert_allclose(mount.position_mm, rig.tof.position_mm, atol=1e-9)
    np.testing.assert_allclose(mount.beam, rig.tof.beam, atol=1e-9)
    np.testing.assert_allclose(mount.slide, rig.tof.slide, atol=1e-9)


def test_a_first_order_lag_is_undone_exactly() -> None:
    rng = np.random.default_rng(14)
    true = np.cumsum(rng.normal(0, 30, 300)) + 2000
    keep = np.exp(-0.01 / 0.016)
    seen = true.copy()
    for i in range(1, len(true)):
        seen[i] = keep * seen[i - 1] + (1 - keep) * true[i]
    points = TofPoints(np.zeros(299), np.zeros(299), seen[1:], np.diff(seen), np.full(299, 0.01))
    np.testing.assert_allclose(points.corrected(0.016)[0], true[1:], atol=1e-8)
    np.testing.assert_array_equal(points.corrected(0.0)[0], seen[1:])
