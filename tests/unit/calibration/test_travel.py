"""Travel and bed from a board lying still; the corners are projected by OpenCV, not by the package."""

import cv2
import numpy as np
import pytest

from twinline.arrays import FloatArray
from twinline.calibration.board import Board
from twinline.calibration.travel import calibrate_travel
from twinline.calibration.views import BoardView, view_of_points
from twinline.errors import CalibrationError
from twinline.geometry.camera import Camera

BOARD = Board("chessboard", 9, 6, 12.0)
CAMERA = Camera(
    np.array([[1041.0, 0.0, 634.0], [0.0, 1040.0, 371.0], [0.0, 0.0, 1.0]]),
    (1280, 720),
    np.array([-0.128, 0.07, -0.0007, 0.0005, 0.0]),
)
TRAVEL = np.array([-0.0009, 0.9961, -0.0121])
TURN = np.array([0.012, -0.009, 0.11])
PLACE = np.array([-45.0, 30.0, 421.0])
CARTS = np.array([110.0, 130.0, 150.0, 170.0, 190.0, 210.0])


def views_of(
    carts: FloatArray, rng: np.random.Generator, *, ride: bool = False, noise_px: float = 0.04
) -> list[BoardView]:
    views = []
    for number, cart in enumerate(carts):
        place = PLACE if ride else PLACE - TRAVEL * (cart - carts.mean())
        pixels = cv2.projectPoints(BOARD.points_mm(), TURN, place, CAMERA.matrix, CAMERA.distortion)[0].reshape(-1, 2)
        views.append(
            view_of_points(f"{number:02d}.png", CAMERA.size, BOARD, pixels + rng.normal(0, noise_px, pixels.shape))
        )
    return views


def true_bed(thickness_mm: float = 0.0) -> FloatArray:
    """As seen from the middle of the travel."""
    normal = np.asarray(cv2.Rodrigues(TURN)[0])[:, 2]
    return np.asarray(normal / (normal @ PLACE + thickness_mm))


def test_travel_and_bed_are_found_within_their_standard_deviations() -> None:
    result = calibrate_travel(views_of(CARTS, np.random.default_rng(1)), CARTS, CAMERA)
    sd = np.sqrt(np.diagonal(result.matrix))
    assert np.abs((result.travel - TRAVEL) / sd[:3]).max() < 4.0
    assert np.abs((result.bed - true_bed()) / sd[3:]).max() < 4.0
    assert result.scale == pytest.approx(np.linalg.norm(TRAVEL), abs=2e-4)
    assert result.rms_px == pytest.approx(0.04 * np.sqrt(2), rel=0.15)
    assert result.held_out_px == pytest.approx(result.rms_px, rel=0.2)


def test_the_bed_lies_below_the_boards_face_by_its_thickness() -> None:
    views = views_of(CARTS, np.random.default_rng(2), noise_px=0.0)
    thick = calibrate_travel(views, CARTS, CAMERA, thickness_mm=3.0)
    np.testing.assert_allclose(1 / np.linalg.norm(thick.bed), 1 / np.linalg.norm(true_bed(3.0)), atol=1e-4)


def test_the_dependence_on_the_camera_is_that_of_calibrating_with_another_camera() -> None:
    views = views_of(CARTS, np.random.default_rng(3))
    result = calibrate_travel(views, CARTS, CAMERA)
    for index, step in ((0, 0.5), (3, 0.5), (4, 1e-3)):
        matrix, distortion = CAMERA.matrix.copy(), CAMERA.distortion.copy()
        if index < 4:
            matrix[((0, 0), (1, 1), (0, 2), (1, 2))[index]] += step
        else:
            distortion[index - 4] += step
        other = calibrate_travel(views, CARTS, Camera(matrix, CAMERA.size, distortion))
        change = np.concatenate([other.travel - result.travel, other.bed - result.bed])
        np.testing.assert_allclose(change, result.by_camera[:, index] * step, rtol=0.05, atol=2e-7)


def test_a_view_at_another_place_than_stated_is_dropped_and_named() -> None:
    views = views_of(CARTS, np.random.default_rng(4))
    false = views_of(CARTS + 9.0, np.random.default_rng(5))[2]
    views[2] = view_of_points("moved.png", CAMERA.size, BOARD, false.pixels + 21.0)
    result = calibrate_travel(views, CARTS, CAMERA)
    assert result.dropped == ("moved.png",)
    assert np.linalg.norm(result.travel - TRAVEL) < 1e-3


def test_travel_of_zero_length_is_refused_with_the_next_step() -> None:
    carts = np.full(5, 120.0)
    with pytest.raises(CalibrationError, match="span 0 mm") as caught:
        calibrate_travel(views_of(carts, np.random.default_rng(6)), carts, CAMERA)
    assert caught.value.code == "no-travel"


def test_a_board_that_rides_on_the_cart_is_refused() -> None:
    with pytest.raises(CalibrationError, match="must lie on the bed") as caught:
        calibrate_travel(views_of(CARTS, np.random.default_rng(7), ride=True), CARTS, CAMERA)
    assert caught.value.code == "no-travel"


def test_one_view_is_too_few() -> None:
    with pytest.raises(CalibrationError, match="seen in 1 of 1 views") as caught:
        calibrate_travel(views_of(CARTS[:1], np.random.default_rng(8)), CARTS[:1], CAMERA)
    assert caught.value.code == "too-few-views"


def test_views_that_do_not_fit_a_straight_travel_are_refused() -> None:
    rng = np.random.default_rng(9)
    views = [
        view_of_points(v.name, CAMERA.size, BOARD, v.pixels + rng.uniform(-60, 60, 2)) for v in views_of(CARTS, rng)
    ]
    with pytest.raises(CalibrationError, match="contradict a straight travel") as caught:
        calibrate_travel(views, CARTS, CAMERA)
    assert caught.value.code == "views-contradict"
