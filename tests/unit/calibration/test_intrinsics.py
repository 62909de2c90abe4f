from dataclasses import replace

import numpy as np
import pytest

from tests.unit.calibration.board_pictures import SIZE, TRUE_CAMERA, Pose, pose, project, random_poses, rotation
from tests.unit.calibration.synthetic_views import BOARD, camera_error_px, good_views, views_of
from twinline.calibration.bundle import Solution, normal_equations, residuals, stack_sightings
from twinline.calibration.intrinsics import IntrinsicsResult, calibrate_intrinsics
from twinline.calibration.views import BoardView, Verdict, compare_views, view_of_points
from twinline.errors import CalibrationError


def theta_of(result: IntrinsicsResult) -> np.ndarray:
    m = result.camera.matrix
    return np.array([m[0, 0], m[1, 1], m[0, 2], m[1, 2], *result.camera.distortion])


class TestFit:
    def test_exact_corners_give_the_exact_camera(self) -> None:
        result = calibrate_intrinsics(good_views(1, noise_px=0.0), model="k1 k2 p1 p2")
        np.testing.assert_allclose(theta_of(result)[:4], TRUE_CAMERA[:4], rtol=1e-8)
        np.testing.assert_allclose(theta_of(result)[4:], TRUE_CAMERA[4:], atol=1e-7)

    def test_the_poses_are_those_of_the_board(self) -> None:
        rng = np.random.default_rng(2)
        poses = random_poses(BOARD, 12, rng)
        result = calibrate_intrinsics(views_of(poses, rng, noise_px=0.0), model="k1 k2 p1 p2")
        for fit, where in zip(result.views, poses, strict=True):
            assert fit.camera_from_board is not None
            np.testing.assert_allclose(fit.camera_from_board.rotation, where.rotation, atol=1e-7)
            np.testing.assert_allclose(fit.camera_from_board.translation_mm, where.translation_mm, rtol=1e-6, atol=1e-5)

    def test_a_far_off_guess_does_not_matter(self) -> None:
        views = good_views(3)
        guess = np.array([[4000.0, 0, 100], [0, 4000.0, 600], [0, 0, 1]])
        np.testing.assert_allclose(
            theta_of(calibrate_intrinsics(views, guess)), theta_of(calibrate_intrinsics(views)), rtol=1e-5, atol=1e-6
        )

    def test_the_normal_equations_agree_with_differences(self) -> None:
        rng = np.random.default_rng(4)
        poses = random_poses(BOARD, 2, rng)
        views = views_of(poses, rng, noise_px=1.0)
        sightings = stack_sightings([v.board_mm for v in views], [v.pixels for v in views])
        theta = TRUE_CAMERA + np.array([5, 5, 5, 5, 0.01, 0.01, 0.001, 0.001, 0.05])
        start = Solution(theta, np.stack([p.rotation for p in poses]), np.stack([p.translation_mm for p in poses]))
        normal = normal_equations(sightings, start, np.arange(9))

        def moved(view: int, step: np.ndarray) -> Solution:
            turn = np.eye(3) + np.cross(np.eye(3), step[:3])
            rotations, translations = start.rotations.copy(), start.translations_mm.copy()
            rotations[view], translations[view] = turn @ rotations[view], translations[view] + step[3:]
            return Solution(theta, rotations, translations)

        def half_squares(solution: Solution) -> float:
            return float(0.5 * (residuals(sightings, solution) ** 2).sum())

        for i in range(9):
            h = np.zeros(9)
            h[i] = 1e-6 * max(1.0, abs(theta[i]))
            pair = [half_squares(Solution(theta + s * h, start.rotations, start.translations_mm)) for s in (1, -1)]
            expected = (pair[0] - pair[1]) / (2 * h[i])
            assert normal.camera_gradient.sum(axis=0)[i] == pytest.approx(expected, rel=2e-4, abs=1e-3)
        for i in range(6):
            h = np.zeros(6)
            h[i] = 1e-6 if i < 3 else 1e-4
            expected = (half_squares(moved(1, h)) - half_squares(moved(1, -h))) / (2 * h[i])
            assert normal.pose_gradient[1, i] == pytest.approx(expected, rel=2e-4, abs=1e-2)

    def test_views_with_different_numbers_of_corners_go_together(self) -> None:
        views = good_views(5, noise_px=0.0)
        part = views[0]
        keep = np.arange(10, 40)
        views[0] = replace(part, ids=keep, board_mm=part.board_mm[keep], pixels=part.pixels[keep], verdict="partial")
        result = calibrate_intrinsics(views, model="k1 k2 p1 p2")
        np.testing.assert_allclose(theta_of(result)[:4], TRUE_CAMERA[:4], rtol=1e-8)
        assert len(result.views[0].residuals_px) == 30


class TestEvidence:
    @pytest.mark.parametrize(
        ("lens", "model"),
        [
            ((0.0, 0.0, 0.0, 0.0, 0.0), "none"),
            ((-0.1, 0.0, 0.0, 0.0, 0.0), "k1"),
            ((-0.25, 0.12, 0.0, 0.0, 0.0), "k1 k2"),
            ((-0.25, 0.12, 0.003, -0.002, 0.0), "k1 k2 p1 p2"),
            ((-0.4, 0.25, 0.003, -0.002, 0.35), "k1 k2 p1 p2 k3"),
        ],
    )
    def test_the_lens_model_is_as_rich_as_the_lens(self, lens: tuple[float, ...], model: str) -> None:
        camera = np.array([1041.3, 1040.1, 633.9, 371.2, *lens])
        result = calibrate_intrinsics(good_views(6, 24, noise_px=0.08, camera=camera))
        assert result.model == model
        assert [m.chosen for m in result.models].count(True) == 1
        assert all(m.verdict for m in result.models)
        assert set(result.covariance.names) == {f"camera.{n}" for n in ("fx fy cx cy " + model).split() if n != "none"}

    def test_the_residuals_and_their_spread_are_those_of_the_noise(self) -> None:
        result = calibrate_intrinsics(good_views(7, 24, noise_px=0.2))
        assert result.corner_sd_px == pytest.approx(0.2, rel=0.05)
        assert result.rms_px == pytest.approx(0.2 * 2**0.5, rel=0.08)
        assert result.rms_px < result.held_out_rms_px < 1.1 * result.rms_px
        assert result.inflation < 1.6
        assert not result.warnings

    def test_errors_that_views_have_in_common_inflate_the_covariance(self) -> None:
        rng = np.random.default_rng(8)
        poses = random_poses(BOARD, 18, rng)
        bent = BOARD.points_mm()
        bent[:, 2] += 0.4 * np.sin(bent[:, 0] / bent[:, 0].max() * np.pi)
        views = [
            view_of_points(f"{i}", SIZE, BOARD, project(bent, p) + rng.normal(0, 0.05, (54, 2)))
            for i, p in enumerate(poses)
        ]
        result = calibrate_intrinsics(views, model="k1 k2 p1 p2")
        assert result.inflation > 4
        assert any("flat plate" in text for text in result.warnings)

    def test_each_view_has_its_error_with_and_without_itself(self) -> None:
        views = good_views(9, 16)
        rng = np.random.default_rng(1)
        views[3] = replace(views[3], pixels=views[3].pixels + rng.normal(0, 0.18, (54, 2)))
        result = calibrate_intrinsics(views)
        rms = np.array([v.rms_px for v in result.views])
        assert rms.argmax() == 3
        assert all(v.used and v.held_out_px > 0.95 * v.rms_px for v in result.views)
        assert result.views[3].largest_px > rms[3]


class TestFalseData:
    def test_false_boards_are_dropped_and_named(self) -> None:
        views = good_views(10, 20)
        for i in (4, 11):
            views[i] = replace(views[i], pixels=views[i].pixels * [1.0, 1.06] + [0, -20])
        result = calibrate_intrinsics(views)
        assert [i for i, v in enumerate(result.views) if not v.used] == [4, 11]
        assert "times the usual" in result.views[4].reason
        assert result.views[4].held_out_px > 3 * result.held_out_rms_px

    def test_ten_percent_of_false_boards_cost_less_than_half_of_the_error(self) -> None:
        clean, soiled = [], []
        for seed in range(6):
            views = good_views(100 + seed, 20)
            rng = np.random.default_rng(seed)
            clean.append(camera_error_px(theta_of(calibrate_intrinsics(views, model="k1 k2 p1 p2"))))
            for i in rng.choice(20, 2, replace=False):
                false = rng.permutation(views[i].pixels) if seed % 2 else views[i].pixels + rng.normal(0, 4, (54, 2))
                views[i] = replace(views[i], pixels=false)
            soiled.append(camera_error_px(theta_of(calibrate_intrinsics(views, model="k1 k2 p1 p2"))))
        assert np.sqrt(np.mean(np.square(soiled))) < 1.5 * np.sqrt(np.mean(np.square(clean)))

    def test_ten_percent_of_false_corners_cost_less_than_half_of_the_error(self) -> None:
        clean, soiled = [], []
        for seed in range(6):
            views = good_views(200 + seed, 18)
            rng = np.random.default_rng(seed)
            clean.append(camera_error_px(theta_of(calibrate_intrinsics(views, model="k1 k2 p1 p2"))))
            for i, view in enumerate(views):
                wrong = rng.random(54) < 0.1
                shift = np.where(wrong[:, None], rng.normal(0, 8, (54, 2)), 0.0)
                views[i] = replace(view, pixels=view.pixels + shift)
            result = calibrate_intrinsics(views, model="k1 k2 p1 p2")
            assert 0.05 < result.rejected_share < 0.15
            soiled.append(camera_error_px(theta_of(result)))
        assert np.sqrt(np.mean(np.square(soiled))) < 1.5 * np.sqrt(np.mean(np.square(clean)))


def refusal(views: list[BoardView]) -> CalibrationError:
    with pytest.raises(CalibrationError) as caught:
        calibrate_intrinsics(views)
    return caught.value


class TestRefusals:
    def test_views_parallel_to_the_board_do_not_show_the_focal_length(self) -> None:
        rng = np.random.default_rng(11)
        poses = random_poses(BOARD, 14, rng, tilt_deg=3.0)
        error = refusal(views_of(poses, rng, noise_px=0.15))
        assert error.code == "focal-length-unobservable"
        assert "20° to 45°" in error.detail

    def test_a_low_residual_is_no_excuse(self) -> None:
        # Without noise the fit is perfect, and the same poses still cannot carry a real picture's errors.
        poses = [pose(BOARD, (0.0, 0.0, 15.0 * i), (8.0 * i - 40, 3.0 * i - 20, 330.0)) for i in range(10)]
        error = refusal(views_of(poses, np.random.default_rng(0), noise_px=0.001))
        assert error.code == "focal-length-unobservable"

    def test_a_corner_of_the_image_alone_does_not_show_the_lens(self) -> None:
        rng = np.random.default_rng(12)
        poses: list[Pose] = []
        while len(poses) < 8:
            turn = (rng.uniform(-35, 35), rng.uniform(-35, 35), 0.0)
            poses.append(pose(BOARD, turn, (-260.0, -140.0, 700.0 + rng.uniform(-50, 50))))
        error = refusal(views_of(poses, rng, noise_px=0.3))
        assert error.code in ("distortion-unobservable", "focal-length-unobservable")
        assert "Show the board there too" in error.detail or "everywhere in the image" in error.detail

    def test_no_view_at_all(self) -> None:
        error = refusal([])
        assert error.code == "too-few-views"
        assert "at least 10 poses" in error.detail

    def test_three_views_are_too_few(self) -> None:
        error = refusal(good_views(13, 3))
        assert error.code == "too-few-views"
        assert "Only 3 of 3 pictures" in error.detail

    def test_ten_times_the_same_pose_is_one_view(self) -> None:
        rng = np.random.default_rng(14)
        views = compare_views(views_of(random_poses(BOARD, 1, rng) * 10, rng), BOARD)
        error = refusal(list(views))
        assert error.code == "views-alike"
        assert "9 show the board in the same pose" in error.detail

    def test_pictures_of_two_sizes_do_not_mix(self) -> None:
        views = good_views(15, 10)
        views[7] = replace(views[7], size=(640, 480))
        error = refusal(views)
        assert error.code == "mixed-image-sizes"
        assert all(part in error.detail for part in ("view 7", "640 x 480", "1280 x 720"))

    @pytest.mark.parametrize(
        ("verdict", "code"),
        [
            ("blurred", "blurred-views"),
            ("mirrored", "mirrored-board"),
            ("wrong-size", "wrong-board"),
            ("over-exposed", "badly-exposed-views"),
            ("not-found", "too-few-views"),
        ],
    )
    def test_the_most_frequent_cause_is_the_one_that_is_told(self, verdict: Verdict, code: str) -> None:
        views = good_views(16, 9)
        views[2:] = [replace(v, verdict=verdict, advice="this and that; do so") for v in views[2:]]
        error = refusal(views)
        assert error.code == code
        assert "do so" in error.detail
        assert "7 because" in error.detail

    def test_views_of_two_cameras_contradict_each_other(self) -> None:
        other = TRUE_CAMERA * [1.4, 1.4, 1, 1, 1, 1, 1, 1, 1]
        views = good_views(17, 8) + good_views(18, 7, camera=other)
        assert refusal(views).code in ("views-contradict", "focal-length-unobservable")

    def test_an_unknown_lens_model_is_refused(self) -> None:
        with pytest.raises(CalibrationError, match="k1 k2 p1 p2"):
            calibrate_intrinsics(good_views(19, 6), model="k9")


def test_rotation_of_the_test_helper_is_a_rotation() -> None:
    r = rotation((10.0, 20.0, 30.0))
    np.testing.assert_allclose(r @ r.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(r) == pytest.approx(1.0)
