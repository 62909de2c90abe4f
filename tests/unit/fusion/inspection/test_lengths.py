import numpy as np
import pytest

from tests.unit.fusion.inspection.surfaces import block_points, flat_points, turned
from twinline.arrays import FloatArray
from twinline.errors import InputError
from twinline.fusion.inspection.lengths import point_distance, step_height
from twinline.fusion.inspection.prism import fit_prism


class TestPointDistance:
    def test_it_adds_the_variances_of_both_points(self) -> None:
        points = np.array([[0.0, 0.0, 0.0], [3.0, 4.0, 12.0], [np.nan, 0.0, 0.0]])
        found = point_distance(points, 0, 1, np.array([0.03, 0.04, 0.05]))
        assert found.length.value == pytest.approx(13.0)
        assert found.length.sigma == pytest.approx(0.05)
        np.testing.assert_array_equal(found.used, [0, 1])

    def test_two_points_alone_do_not_tell_their_uncertainty(self) -> None:
        assert np.isnan(point_distance(np.eye(3), 0, 1).length.sigma)

    @pytest.mark.parametrize(("row", "words"), [(5, "points 0 to 2"), (-1, "no point -1"), (2, "no measurement")])
    def test_points_that_are_not_there_are_refused(self, row: int, words: str) -> None:
        points = np.array([[0.0, 0.0, 0.0], [3.0, 4.0, 12.0], [np.nan, 0.0, 0.0]])
        with pytest.raises(InputError, match=words):
            point_distance(points, 0, row)


class TestStepHeight:
    def test_its_uncertainty_is_the_error_really_made(self) -> None:
        ratios = []
        for seed in range(40):
            lower = flat_points(500, noise_mm=0.05, seed=seed)
            upper = flat_points(300, size_mm=10.0, noise_mm=0.05, seed=seed + 100) + np.array([40.0, 0.0, 5.0])
            found = step_height(turned(lower, (3.0, 2.0, 0.0)), turned(upper, (3.0, 2.0, 0.0)))
            ratios.append((found.height.value - 5.0) / found.height.sigma)
        assert 0.67 < np.std(ratios) < 1.33

    def test_a_step_down_is_negative_and_points_elsewhere_are_not_used(self) -> None:
        lower, upper = flat_points(300), flat_points(300, seed=2) - [0.0, 0.0, 2.0]
        upper[:40, 2] += 1.0
        found = step_height(lower, upper)
        assert found.height.value == pytest.approx(-2.0, abs=1e-9)
        np.testing.assert_array_equal(found.used_upper, np.arange(40, 300))
        np.testing.assert_array_equal(found.used_lower, np.arange(300))

    def test_surfaces_at_an_angle_have_no_step(self) -> None:
        with pytest.raises(InputError, match=r"12\.0°"):
            step_height(flat_points(300), turned(flat_points(300), (12.0, 0.0, 0.0)))


class TestPrism:
    SIZE = (25.4, 24.2, 19.35)

    @pytest.mark.parametrize("angle_deg", [3.0, 17.0, 45.0, 80.0])
    def test_sides_and_height_keep_the_budget(self, angle_deg: float) -> None:
        # Sides 0.10 and height 0.02 mm are what the fused cloud of a calibrated machine has to reach.
        fit = fit_prism(block_points(self.SIZE, angle_deg=angle_deg, noise_mm=0.06) + np.array([120.0, 40.0, 0.0]))
        assert fit.length.value == pytest.approx(25.4, abs=0.1)
        assert fit.width.value == pytest.approx(24.2, abs=0.1)
        assert fit.height.value == pytest.approx(19.35, abs=0.02)
        assert (fit.angle_deg - angle_deg + 90.0) % 180.0 - 90.0 == pytest.approx(0.0, abs=0.5)

    @pytest.mark.parametrize("angles_deg", [np.zeros(12), np.linspace(2.0, 80.0, 12)])
    def test_sides_have_no_bias_and_their_uncertainty_is_the_error_really_made(self, angles_deg: FloatArray) -> None:
        errors, sigmas = [], []
        for seed, angle in enumerate(angles_deg):
            fit = fit_prism(block_points(self.SIZE, angle_deg=float(angle), noise_mm=0.06, seed=seed))
            errors.append(fit.length.value - 25.4)
            sigmas.append(fit.length.sigma)
        # Rows along an edge leave it uncertain by their spacing; their mean error has to vanish all the same.
        assert abs(np.mean(errors)) < 3.0 * np.mean(sigmas) / np.sqrt(len(errors))
        assert 0.3 < np.sqrt(np.mean(np.square(errors))) / np.mean(sigmas) < 1.5

    def test_corners_lie_on_the_top_face(self) -> None:
        fit = fit_prism(block_points(self.SIZE, angle_deg=30.0, noise_mm=0.02))
        np.testing.assert_allclose(fit.corners_mm[:, 2], 19.35, atol=0.02)
        sides = np.linalg.norm(np.roll(fit.corners_mm, -1, axis=0) - fit.corners_mm, axis=1)
        np.testing.assert_allclose(np.sort(sides), [24.2, 24.2, 25.4, 25.4], atol=0.1)

    def test_without_a_bed_the_height_is_that_over_zero(self) -> None:
        points = block_points(self.SIZE)
        fit = fit_prism(points[points[:, 2] > 10.0])
        assert fit.height.value == pytest.approx(19.35, abs=1e-6)

    def test_a_bare_bed_is_no_block(self) -> None:
        with pytest.raises(InputError, match="no block"):
            fit_prism(flat_points(3000, noise_mm=0.05))
