import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinline.errors import RigError
from twinline.geometry.camera import Camera, distort, distort_jacobian

MATRIX = np.array([[1041.3, 0.0, 633.9], [0.0, 1038.7, 371.2], [0.0, 0.0, 1.0]])
LENSES = {
    "none": [0.0, 0.0, 0.0, 0.0, 0.0],
    "strong barrel": [-0.35, 0.12, 0.004, -0.003, -0.02],
    "strong pincushion": [0.45, 0.2, -0.003, 0.004, 0.1],
    "moustache": [-0.4, 0.6, 0.001, -0.002, -0.2],
}


def grid(step: int = 40) -> np.ndarray:
    u, v = np.meshgrid(np.arange(0, 1280, step), np.arange(0, 720, step))
    edge = [[1279, 0], [0, 719], [1279, 719], [1279, 360]]
    return np.vstack([np.column_stack([u.ravel(), v.ravel()]), edge]).astype(float)


@pytest.mark.parametrize("lens", LENSES)
class TestLens:
    def test_rays_and_project_are_inverse_over_the_whole_image(self, lens: str) -> None:
        camera = Camera(MATRIX, (1280, 720), np.array(LENSES[lens]))
        pixels = grid()
        rays = camera.rays(pixels)
        np.testing.assert_allclose(camera.project(rays * 431.0), pixels, atol=1e-9)

    def test_projection_agrees_with_opencv(self, lens: str) -> None:
        camera = Camera(MATRIX, (1280, 720), np.array(LENSES[lens]))
        points = camera.rays(grid()) * np.linspace(200, 500, len(grid()))[:, None]
        expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), MATRIX, np.array(LENSES[lens]))
        np.testing.assert_allclose(camera.project(points), expected[:, 0], atol=1e-9)

    def test_rays_agree_with_opencv(self, lens: str) -> None:
        camera = Camera(MATRIX, (1280, 720), np.array(LENSES[lens]))
        criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 500, 1e-13)
        pixels = grid() * 0.6 + np.array([256, 144])  # where OpenCV's fixed point converges for every lens
        expected = cv2.undistortPoints(
            pixels[:, None], MATRIX, np.array(LENSES[lens]), R=np.eye(3), P=np.eye(3), criteria=criteria
        )[:, 0]
        np.testing.assert_allclose(camera.rays(pixels)[:, :2], expected, atol=1e-9)

    def test_the_jacobian_agrees_with_differences(self, lens: str) -> None:
        k, h = np.array(LENSES[lens]), 1e-6
        x, y = Camera(MATRIX, (1280, 720), k).rays(grid())[:, :2].T
        a, b, d = distort_jacobian(x, y, k)
        by_x = [(p - m) / (2 * h) for p, m in zip(distort(x + h, y, k), distort(x - h, y, k), strict=True)]
        by_y = [(p - m) / (2 * h) for p, m in zip(distort(x, y + h, k), distort(x, y - h, k), strict=True)]
        np.testing.assert_allclose([a, b, b, d], [*by_x, *by_y], atol=1e-8)


class TestFolding:
    def test_a_point_beyond_the_turning_point_of_the_lens_has_no_image(self) -> None:
        camera = Camera(MATRIX, (1280, 720), np.array([-0.3, 0.0, 0.0, 0.0, 0.0]))
        assert camera.radius2_limit == pytest.approx(1 / 0.9)
        inside, outside = camera.project(np.array([[1.0, 0.0, 1.0], [2.0, 0.0, 1.0]]))
        assert np.isfinite(inside).all()
        assert np.isnan(outside).all()

    def test_a_pixel_that_no_ray_reaches_is_nan(self) -> None:
        camera = Camera(MATRIX, (3000, 720), np.array([-0.3, 0.0, 0.0, 0.0, 0.0]))
        reach = 1041.3 * (1 / 0.9) ** 0.5 * (1 - 0.3 / 0.9) + 633.9
        rays = camera.rays(np.array([[reach - 2.0, 371.2], [reach + 2.0, 371.2], [np.nan, 10.0]]))
        assert np.isfinite(rays[0]).all()
        assert np.isnan(rays[1:, :2]).all()

    def test_a_second_rising_branch_of_the_lens_polynomial_is_not_taken_for_the_first(self) -> None:
        camera = Camera(MATRIX, (1280, 720), np.array([-0.6, 0.1, 0.0, 0.0, 0.0]))
        # 1 - 1.8 s + 0.5 s^2 = 0 has a smaller root, where the image ends, and a larger one, where it starts again.
        assert camera.radius2_limit == pytest.approx(1.8 - (1.8**2 - 2.0) ** 0.5)
        reach = camera.radius2_limit**0.5 * (1 - 0.6 * camera.radius2_limit + 0.1 * camera.radius2_limit**2)
        radii = np.linspace(0.01, 4.0, 400)
        rays = camera.rays(np.column_stack([633.9 + 1041.3 * radii, np.full(400, 371.2)]))
        np.testing.assert_array_equal(np.isfinite(rays[:, 0]), radii < reach)

    def test_points_behind_the_camera_have_no_image(self) -> None:
        camera = Camera(MATRIX, (1280, 720))
        assert np.isnan(camera.project(np.array([[1.0, 2.0, -3.0], [1.0, 2.0, 0.0]]))).all()

    @given(
        st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-0.3, 0.3), st.floats(-0.6, 0.6), st.floats(-0.35, 0.35)
    )
    def test_whatever_the_lens_a_ray_leads_back_to_its_pixel_on_the_branch_through_the_centre(
        self, k1: float, k2: float, k3: float, x: float, y: float
    ) -> None:
        camera = Camera(MATRIX, (1280, 720), np.array([k1, k2, 0.0, 0.0, k3]))
        ray = np.array([[x, y, 1.0]])
        if x * x + y * y < 0.9 * camera.radius2_limit:
            np.testing.assert_allclose(camera.rays(camera.project(ray)), ray, atol=1e-8)


@pytest.mark.parametrize(
    ("matrix", "size", "distortion", "word"),
    [
        (np.zeros((3, 3)), (1280, 720), np.zeros(5), "focal"),
        (MATRIX * 2, (1280, 720), np.zeros(5), "form"),
        (MATRIX + np.array([[0, 3, 0], [0, 0, 0], [0, 0, 0]]), (1280, 720), np.zeros(5), "skew"),
        (MATRIX, (1280, 720), np.zeros(4), "k1, k2, p1, p2, k3"),
        (MATRIX, (1280, 720), np.full(5, np.nan), "finite"),
        (MATRIX, (0, 720), np.zeros(5), "size"),
    ],
)
def test_an_impossible_camera_is_refused(
    matrix: np.ndarray, size: tuple[int, int], distortion: np.ndarray, word: str
) -> None:
    with pytest.raises(RigError, match=word):
        Camera(matrix, size, distortion)
