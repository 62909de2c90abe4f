"""Cameras calibrated from the pictures of others, whose results are published or known."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from twinline.calibration.board import Board
from twinline.calibration.intrinsics import calibrate_intrinsics
from twinline.calibration.views import BoardView, compare_views, inspect_view
from twinline.errors import CalibrationError
from twinline.recording.capture import open_capture
from twinline.recording.images import read_image

STEREO = Board("chessboard", 9, 6, 25.0)
CICLOP = Board("chessboard", 11, 6, 13.0)
STAIRS = Board("chessboard", 5, 5, 5.0)


def views_in(folder: Path, pattern: str, board: Board) -> tuple[BoardView, ...]:
    return compare_views((inspect_view(p.name, read_image(p), board) for p in sorted(folder.glob(pattern))), board)


# Published for the left camera; for the right one, a plain calibration with a window of 5 px.
@pytest.mark.parametrize(
    ("pattern", "focal", "centre"),
    [("left[01]*.jpg", 535.9157, (342.283, 235.571)), ("right[01]*.jpg", 537.2, (327.59, 248.88))],
)
def test_a_stereo_pairs_cameras_are_as_published(
    shared_data: Callable[[str], Path], pattern: str, focal: float, centre: tuple[float, float]
) -> None:
    views = views_in(shared_data("opencv_samples_stereo"), pattern, STEREO)
    assert [v.verdict for v in views] == ["found"] * 13
    result = calibrate_intrinsics(views)
    np.testing.assert_allclose((result.camera.fx, result.camera.fy), focal, rtol=0.01)
    np.testing.assert_allclose((result.camera.cx, result.camera.cy), centre, atol=3.0)
    assert result.held_out_rms_px < 0.2
    assert all(v.used for v in result.views)


def test_a_scanners_camera_is_as_published(shared_data: Callable[[str], Path]) -> None:
    views = views_in(shared_data("ciclop_two_laser") / "calib_captures", "*.jpg", CICLOP)
    published = np.array([1429.67, 1430.39, 478.03, 642.60])
    for model in (None, "k1 k2 p1 p2 k3"):
        result = calibrate_intrinsics(views, model=model)
        camera = result.camera
        np.testing.assert_allclose((camera.fx, camera.fy), published[:2], rtol=0.005)
        found = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        sd = [result.covariance.sd(f"camera.{name}") for name in ("fx", "fy", "cx", "cy")]
        assert (np.abs(found - published) < 3.5 * np.array(sd)).all()
    np.testing.assert_allclose(camera.distortion, [0.02719, -0.23099, -0.0009, 0.0, 0.50892], atol=0.05)


def test_a_rendered_captures_camera_is_found_within_its_uncertainty(shared_data: Callable[[str], Path]) -> None:
    folder = shared_data("rendered_sample")
    capture = open_capture(folder)
    assert capture.info.board is not None
    board = Board(**dataclasses.asdict(capture.info.board))
    views = compare_views((inspect_view(p.name, read_image(p), board) for p in capture.views()), board)
    result = calibrate_intrinsics(views, np.asarray(capture.info.camera_matrix_guess))
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    matrix = np.array(truth["camera_matrix"])
    true = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *truth["distortion_k1k2p1p2k3"]])
    camera = result.camera
    found = np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion])
    used = len(result.covariance.names)
    assert result.model == "k1 k2 p1 p2"
    error = (found - true)[:used]
    assert (np.abs(error) < 3.0 * np.sqrt(np.diagonal(result.covariance.matrix))).all()
    # 8 parameters: the 99 % point of chi-square is 20.1.
    assert error @ np.linalg.solve(result.covariance.matrix, error) < 20.1
    np.testing.assert_allclose(found[:2], true[:2], rtol=0.002)


def test_nearly_parallel_views_are_refused_however_small_their_residuals(shared_data: Callable[[str], Path]) -> None:
    views = views_in(shared_data("linear_stairs") / "chessboard", "*.jpg", STAIRS)
    assert sum(view.usable for view in views) >= 10
    with pytest.raises(CalibrationError, match=r"focal length.*tilted by 20° to 45°") as caught:
        calibrate_intrinsics(views)
    assert caught.value.code == "focal-length-unobservable"


class TestBadPictures:
    def refusal(self, views: tuple[BoardView, ...]) -> CalibrationError:
        with pytest.raises(CalibrationError) as caught:
            calibrate_intrinsics(views)
        return caught.value

    @pytest.mark.parametrize(("columns", "rows"), [(8, 6), (9, 7), (10, 7)])
    def test_the_wrong_size_of_board_is_corrected_by_what_is_seen(
        self, shared_data: Callable[[str], Path], columns: int, rows: int
    ) -> None:
        views = views_in(shared_data("opencv_samples_stereo"), "left0*.jpg", Board("chessboard", columns, rows, 25.0))
        error = self.refusal(views)
        assert error.code == "wrong-board"
        assert f"9 x 6 inner corners are seen, not {columns} x {rows}" in error.detail

    def test_pictures_out_of_focus_are_told_apart_from_pictures_without_a_board(
        self, shared_data: Callable[[str], Path]
    ) -> None:
        folder = shared_data("opencv_samples_stereo")
        pictures = [(p.name, read_image(p)) for p in sorted(folder.glob("left0*.jpg"))]
        for sigma in (4.0, 12.0):
            blurred = [
                inspect_view(n, np.asarray(cv2.GaussianBlur(i, (0, 0), sigma), np.uint8), STEREO) for n, i in pictures
            ]
            error = self.refusal(compare_views(blurred, STEREO))
            assert error.code == "blurred-views"
            assert "focus" in error.detail

    def test_one_picture_many_times_is_one_view(self, shared_data: Callable[[str], Path]) -> None:
        image = read_image(shared_data("opencv_samples_stereo") / "left01.jpg")
        views = compare_views([inspect_view(f"{i}.jpg", image, STEREO) for i in range(6)], STEREO)
        error = self.refusal(views)
        assert error.code == "views-alike"
        assert "Move and tilt" in error.detail

    def test_a_picture_of_another_size_is_named(self, shared_data: Callable[[str], Path]) -> None:
        folder = shared_data("opencv_samples_stereo")
        images = {p.name: read_image(p) for p in sorted(folder.glob("left0*.jpg"))}
        images["left05.jpg"] = np.asarray(cv2.resize(images["left05.jpg"], (800, 600)), np.uint8)
        error = self.refusal(compare_views([inspect_view(n, i, STEREO) for n, i in images.items()], STEREO))
        assert error.code == "mixed-image-sizes"
        assert "left05.jpg is 800 x 600 px" in error.detail
