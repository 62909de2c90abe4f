"""The simulated lens against OpenCV's projection of points."""

import cv2
import numpy as np
import pytest

from twinline.devices.simulator.lens import Lens
from twinline.errors import SettingsError

LENS = Lens((1034.6, 1033.9), (648.5, 363.6), (-0.112, 0.061, 0.004), (0.0006, -0.0004))


def test_rays_projected_by_opencv_come_back_to_their_pixels() -> None:
    u, v = np.linspace(-0.5, 1279.5, 41), np.linspace(-0.5, 719.5, 23)
    slopes = LENS.slopes(u, v)
    points = np.concatenate([slopes, np.ones((*slopes.shape[:2], 1))], axis=-1).reshape(-1, 3)
    matrix = np.array([[1034.6, 0.0, 648.5], [0.0, 1033.9, 363.6], [0.0, 0.0, 1.0]])
    pixels, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), matrix, np.array([-0.112, 0.061, 6e-4, -4e-4, 0.004])
    )
    expected = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    np.testing.assert_allclose(pixels.reshape(-1, 2), expected, atol=1e-8)


def test_project_undoes_slopes() -> None:
    u, v = np.array([0.0, 333.3, 1279.0]), np.array([0.0, 719.0])
    np.testing.assert_allclose(LENS.project(LENS.slopes(u, v)), np.stack(np.meshgrid(u, v), axis=-1), atol=1e-8)


def test_a_lens_that_folds_the_image_over_is_refused() -> None:
    with pytest.raises(SettingsError, match="too strong"):
        Lens((500.0, 500.0), (640.0, 360.0), (-0.9, 0.0, 0.0)).slopes(
            np.arange(0.0, 1280.0, 64), np.arange(0.0, 720.0, 64)
        )
