"""A whole capture that another program rendered, reconstructed with its true rig and held against its true surfaces.

Budgets: a plain centroid with edge rejection reaches 0.086 mm on all points, 0.100 mm on the objects, 0.014 % beyond
1 mm and 92.9 % covered; a method that is worth its name is not worse. Distances are clipped at 5 mm, so that a single
stray point cannot decide over the rest.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tests.accuracy.rendered_scans import unfiltered
from tests.accuracy.rendered_truth import Floats, RenderedTruth, Score, Solid, read_truth
from twinline.fusion.cloud import PointCloud, Source
from twinline.reconstruction.offline import reconstruct
from twinline.reconstruction.result import Reconstruction, ReconstructionOptions
from twinline.recording.capture import Capture, open_capture
from twinline.stripe import METHODS, Method

ALL_MM = 0.085
OBJECTS_MM = 0.10
GROSS = 0.0002
COVERED = 0.925


@pytest.fixture(scope="module")
def capture(shared_data: Callable[[str], Path]) -> Capture:
    return open_capture(shared_data("rendered_sample"))


@pytest.fixture(scope="module")
def truth(capture: Capture) -> RenderedTruth:
    return read_truth(capture.path)


@pytest.fixture(scope="module")
def result(capture: Capture, truth: RenderedTruth) -> Reconstruction:
    return reconstruct(capture, truth.rig)


@pytest.fixture(scope="module")
def score(result: Reconstruction, truth: RenderedTruth) -> Score:
    return truth.score(result.cloud.points_mm)


def test_points_lie_within_85_micrometres_of_the_true_surface(score: Score) -> None:
    assert score.points > 50_000
    assert score.rms_mm <= ALL_MM


def test_points_on_the_objects_lie_within_100_micrometres(score: Score) -> None:
    assert score.objects_mm <= OBJECTS_MM


def test_hardly_any_point_is_a_millimetre_off(score: Score) -> None:
    assert score.gross <= GROSS


def test_the_surface_seen_from_above_is_covered(score: Score) -> None:
    assert score.covered >= COVERED


@pytest.mark.parametrize("source", [Source.LASER_1, Source.LASER_2])
def test_each_laser_alone_keeps_to_the_budget(source: Source, result: Reconstruction, truth: RenderedTruth) -> None:
    alone = truth.score(result.cloud.points_mm[result.cloud.source == source])
    assert alone.points > 25_000
    assert alone.rms_mm <= ALL_MM
    assert alone.objects_mm <= OBJECTS_MM


def test_every_frame_is_used_and_every_point_is_finite(result: Reconstruction, capture: Capture) -> None:
    assert capture.laser is not None
    assert result.frames == result.frames_used == len(capture.laser) == 215
    assert result.problem_count == 0
    cloud = result.cloud
    assert np.isfinite(cloud.points_mm).all()
    assert np.isfinite(cloud.sigma_mm).all()
    assert (cloud.sigma_mm > 0).all()


def test_reported_deviations_are_of_the_size_of_the_errors(result: Reconstruction, truth: RenderedTruth) -> None:
    # On the flat bed away from the objects, across the bed: z is the error, and speckle its only cause.
    points = result.cloud.points_mm.astype(np.float64)
    bare = (np.abs(points[:, 0]) < 55) & (np.abs(points[:, 1]) < 90) & (truth.distance(points) < 1.0)
    for solid in truth.solids:
        bare &= np.hypot(*(points[:, :2] - solid.centre[:2]).T) > 1.5 * float(solid.half.max()) + 5.0
    error = 1.4826 * float(np.median(np.abs(points[bare, 2])))
    assert bare.sum() > 5000
    assert 0.5 < float(np.median(result.cloud.sigma_mm[bare])) / error < 1.5


def test_dropping_points_at_edges_is_what_makes_the_difference(
    capture: Capture, score: Score, truth: RenderedTruth
) -> None:
    without = truth.score(unfiltered(capture, truth.rig).points_mm)
    assert score.points < without.points
    assert score.objects_mm < 0.95 * without.objects_mm
    assert score.gross < 0.5 * without.gross


@pytest.mark.slow
@pytest.mark.parametrize("method", [m for m in METHODS if m != "maximum-likelihood"])
def test_the_default_method_is_the_best_of_all(
    method: Method, capture: Capture, score: Score, truth: RenderedTruth
) -> None:
    other = truth.score(reconstruct(capture, truth.rig, ReconstructionOptions(method)).cloud.points_mm)
    assert score.rms_mm <= other.rms_mm
    assert score.objects_mm <= other.objects_mm


def test_a_rig_that_is_a_little_wrong_misses_the_budget(result: Reconstruction, truth: RenderedTruth) -> None:
    # The yardstick feels a shift of 0.1 mm: it would notice a wrong sign, scale or half pixel.
    shifted = PointCloud.concatenate([result.cloud]).points_mm + np.array([0.0, 0.0, 0.1])
    assert truth.score(shifted).rms_mm > ALL_MM


def surface_samples(solid: Solid, spacing_mm: float) -> Floats:
    """Points of a solid's surface, from its parametric form, no further apart than the spacing."""
    half, steps = solid.half, np.arange(0.0, 1.0 + 1e-9, spacing_mm / 2.0 / float(solid.half.max()))
    if solid.kind == "sphere":
        turns = np.arange(0, 2 * np.pi, spacing_mm / half[0])
        rise, turn = (a.ravel() for a in np.meshgrid(np.arange(0, np.pi, spacing_mm / half[0]), turns))
        sphere = [np.sin(rise) * np.cos(turn), np.sin(rise) * np.sin(turn), np.cos(rise)]
        return np.asarray(solid.centre + half[0] * np.column_stack(sphere))
    if solid.kind == "cylinder":
        share, turn = (a.ravel() for a in np.meshgrid(steps, np.arange(0, 2 * np.pi, spacing_mm / half[0])))
        ring, flat = np.column_stack([np.cos(turn), np.sin(turn)]) * half[0], 2.0 * share - 1.0
        wall = np.column_stack([ring, flat * half[2]])
        lids = [np.column_stack([ring * share[:, None], np.full(len(ring), s * half[2])]) for s in (-1, 1)]
        return np.asarray(solid.centre + np.concatenate([wall, *lids]))
    a, b = (2.0 * g.ravel() - 1.0 for g in np.meshgrid(steps, steps))
    faces = [np.insert(np.column_stack([a, b]), axis, sign, axis=1) * half for axis in range(3) for sign in (-1.0, 1.0)]
    c, s = np.cos(solid.yaw_rad), np.sin(solid.yaw_rad)
    turned = np.concatenate(faces) @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(solid.centre + turned)


def test_analytic_distances_agree_with_a_dense_sampling_of_the_surfaces(truth: RenderedTruth) -> None:
    rng = np.random.default_rng(20260101)
    spacing = 0.2
    kinds = {solid.kind for solid in truth.solids}
    assert kinds == {"box", "sphere", "cylinder"}
    for solid in truth.solids:
        queries = solid.centre + rng.uniform(-1.6, 1.6, (400, 3)) * float(solid.half.max())
        brute, _ = cKDTree(surface_samples(solid, spacing)).query(queries)
        exact = solid.distance(queries)
        # A sample lies at most half a cell's diagonal beside the nearest point, which only lengthens the way to it.
        assert (brute >= exact - 1e-9).all()
        assert (brute - exact).max() < spacing


def test_the_surface_seen_from_above_is_the_true_surface(truth: RenderedTruth) -> None:
    surface = truth.seen_from_above()
    assert len(surface) == 220 * 360
    assert truth.distance(surface).max() < 1e-9
    assert (surface[:, 2] > 1.0).mean() > 0.1
    above = surface + np.array([0.0, 0.0, 0.01])
    assert truth.distance(above).min() > 0.0
