import numpy as np

from tests.unit.calibration.board_pictures import SIZE, Pose, pose, project
from tests.unit.calibration.synthetic_views import BOARD
from twinline.calibration.coverage import Coverage, coverage


def coverage_of(poses: list[Pose]) -> Coverage:
    points = BOARD.points_mm()
    middle = points.mean(axis=0)
    return coverage(
        [project(points, p) for p in poses],
        np.stack([p.rotation for p in poses]),
        np.stack([p.rotation @ middle + p.translation_mm for p in poses]),
        SIZE,
    )


def test_a_board_in_the_middle_leaves_the_corners_empty() -> None:
    seen = coverage_of([pose(BOARD, (0.0, 0.0, 0.0), (0.0, 0.0, 330.0))] * 2)
    assert seen.cells.shape == (5, 8)
    assert seen.cells[2, 4] > 0
    assert seen.cells[0, 0] == 0
    assert 0 < seen.share < 0.5
    texts = [a.text for a in seen.advice if a.missing]
    assert "Lower left corner is empty" in texts
    assert "Middle is empty" not in texts


def test_a_region_seen_once_is_thin() -> None:
    seen = coverage_of(
        [pose(BOARD, (0.0, 0.0, 0.0), (-150.0, -80.0, 330.0)), pose(BOARD, (0.0, 0.0, 0.0), (0.0, 0.0, 330.0))]
    )
    assert ("Upper left corner is thin", "1 view there") in [(a.text, a.detail) for a in seen.advice]


def test_tilts_are_counted_by_the_direction_to_which_the_board_faces() -> None:
    # Turned by +35 about the image's v axis, the face that looked at the camera looks to the left.
    left = pose(BOARD, (0.0, 35.0, 0.0), (0.0, 0.0, 330.0))
    right = pose(BOARD, (0.0, -20.0, 0.0), (0.0, 0.0, 330.0))
    up = pose(BOARD, (-50.0, 0.0, 0.0), (0.0, 0.0, 330.0))
    seen = coverage_of([left, right, up])
    np.testing.assert_allclose(seen.tilts_deg, [35.0, 20.0, 50.0], atol=1e-9)
    np.testing.assert_array_equal(seen.rings, [[0, 1, 0, 0], [0, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    texts = {a.text: a.detail for a in seen.advice if a.missing}
    assert "No tilt to the left beyond 30°" not in texts
    assert texts["No tilt to the right beyond 30°"] == "1 view from 15° to 30°"
    assert texts["No tilt down beyond 30°"] == "no view from 15° to 30°"


def test_a_board_always_at_one_distance_is_noticed() -> None:
    near, far = pose(BOARD, (0.0, 0.0, 0.0), (0.0, 0.0, 290.0)), pose(BOARD, (0.0, 0.0, 0.0), (0.0, 0.0, 430.0))
    assert "Distance hardly varies" in [a.text for a in coverage_of([near, near]).advice]
    assert ("Distance", "varies 290 to 430 mm") in [(a.text, a.detail) for a in coverage_of([near, far]).advice]


def test_what_is_missing_comes_first() -> None:
    flags = [a.missing for a in coverage_of([pose(BOARD, (0.0, 0.0, 0.0), (0.0, 0.0, 330.0))]).advice]
    assert flags == sorted(flags, reverse=True)
