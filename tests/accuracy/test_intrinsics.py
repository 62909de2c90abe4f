"""How near calibrated cameras come to known ones, and whether their stated uncertainty is the real one."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.unit.calibration.board_pictures import TRUE_CAMERA
from tests.unit.calibration.synthetic_views import good_views
from twinline.calibration.board import Board
from twinline.calibration.intrinsics import calibrate_intrinsics
from twinline.calibration.views import view_of_points

# Published with the data; the last digit of a lens coefficient is 1e-5, a parameter's share of rounding below that.
PUBLISHED_FOCAL = (809.94790, 806.55964)
PUBLISHED_CENTRE = (361.99611, 214.39514)
PUBLISHED_LENS = (-0.12821, -0.39441, -0.00435, -0.00732)
PUBLISHED_SD_PX = (0.10179, 0.09492)


def test_a_published_calibration_is_reproduced(shared_data: Callable[[str], Path]) -> None:
    points = np.loadtxt(shared_data("opencv_calib1_dat") / "calib1_points.txt").reshape(7, 35, 2)
    board = Board("chessboard", 7, 5, 2.54)
    views = [view_of_points(f"view {i + 1}", (640, 480), board, p) for i, p in enumerate(points)]
    result = calibrate_intrinsics(views, model="k1 k2 p1 p2")
    camera = result.camera
    np.testing.assert_allclose((camera.fx, camera.fy), PUBLISHED_FOCAL, rtol=1e-5)
    np.testing.assert_allclose((camera.cx, camera.cy), PUBLISHED_CENTRE, rtol=1e-5)
    np.testing.assert_allclose(camera.distortion[:4], PUBLISHED_LENS, atol=3e-5)
    assert camera.distortion[4] == 0.0
    residuals = np.concatenate([view.residuals_px for view in result.views])
    np.testing.assert_allclose(residuals.std(axis=0), PUBLISHED_SD_PX, rtol=0.005)
    # Seven views say little, which the published figures do not tell.
    assert 0.005 < result.covariance.sd("camera.fx") / camera.fx < 0.03


@pytest.mark.slow
def test_the_stated_uncertainty_is_the_real_one() -> None:
    # With 60 cameras of 8 parameters the mean of squared standard scores has a standard deviation of about 0.1; it
    # may lie below 1, since the inflation never falls below 1.
    squares, distances = [], []
    for seed in range(60):
        result = calibrate_intrinsics(good_views(1000 + seed), model="k1 k2 p1 p2")
        theta = np.array([result.camera.fx, result.camera.fy, result.camera.cx, result.camera.cy])
        error = np.concatenate([theta, result.camera.distortion[:4]]) - TRUE_CAMERA[:8]
        covariance = result.covariance.matrix
        squares.append(error**2 / np.diagonal(covariance))
        distances.append(error @ np.linalg.solve(covariance, error) / 8)
    by_parameter = np.mean(squares, axis=0)
    assert 0.75 < np.mean(squares) < 1.2
    assert (by_parameter > 0.4).all()
    assert (by_parameter < 1.7).all()
    assert 0.75 < np.mean(distances) < 1.2


@pytest.mark.slow
def test_choosing_the_lens_model_by_evidence_keeps_the_uncertainty_honest() -> None:
    scores = []
    for seed in range(20):
        result = calibrate_intrinsics(good_views(2000 + seed))
        scores.append((result.camera.fx - TRUE_CAMERA[0]) / result.covariance.sd("camera.fx"))
    assert np.mean(np.square(scores)) < 1.8
