import numpy as np
import pytest
import trimesh

from tests.unit.fusion.inspection.surfaces import flat_points, sphere_points
from twinline.errors import InputError
from twinline.fusion.inspection.deviation import (
    check_tolerance,
    deviation_colours,
    deviation_from_cloud,
    deviation_from_mesh,
)
from twinline.fusion.inspection.nearest import MeshSurface
from twinline.fusion.inspection.units import guess_unit
from twinline.fusion.mesh import TriangleMesh


def ball(radius_mm: float) -> MeshSurface:
    sphere = trimesh.creation.icosphere(5, radius=radius_mm)
    return MeshSurface(TriangleMesh(np.asarray(sphere.vertices), np.asarray(sphere.faces)))


class TestFromMesh:
    def test_a_larger_ball_lies_outside_by_the_difference(self) -> None:
        found = deviation_from_mesh(sphere_points(2000, radius_mm=12.8), ball(12.7))
        assert found.mean_mm == pytest.approx(0.1, abs=0.004)
        assert found.rms_mm == pytest.approx(0.1, abs=0.004)
        inside = deviation_from_mesh(sphere_points(2000, radius_mm=12.6), ball(12.7))
        assert inside.mean_mm == pytest.approx(-0.1, abs=0.005)

    def test_percentiles_are_those_of_the_noise(self) -> None:
        found = deviation_from_mesh(sphere_points(40_000, noise_mm=0.05), ball(12.7))
        percentiles = found.percentiles_mm()
        assert percentiles[50.0] == pytest.approx(0.0, abs=0.003)
        assert percentiles[97.5] == pytest.approx(1.96 * 0.05, abs=0.003)
        assert percentiles[0.15] == pytest.approx(-2.968 * 0.05, abs=0.012)
        assert found.p95_mm == pytest.approx(1.96 * 0.05, abs=0.003)

    def test_rows_stay_and_what_is_far_or_unmeasured_is_not_compared(self) -> None:
        points = sphere_points(300)
        points[3] = np.nan
        points[5] += 40.0
        found = deviation_from_mesh(points, ball(12.7), reach_mm=2.0)
        assert np.isnan(found.signed_mm[[3, 5]]).all()
        assert found.compared.sum() == 298

    def test_nothing_near_is_refused(self) -> None:
        with pytest.raises(InputError, match=r"Only 0 of 300 points lie within 2 mm"):
            deviation_from_mesh(sphere_points(300) + 90.0, ball(12.7), reach_mm=2.0)


class TestFromCloud:
    def test_a_raised_cloud_lies_above_by_as_much_and_its_overhang_is_not_compared(self) -> None:
        reference = flat_points(8000, noise_mm=0.01)
        points = flat_points(4000, size_mm=60.0, noise_mm=0.01, seed=2) + np.array([0.0, 0.0, 0.25])
        found = deviation_from_cloud(points, reference)
        assert found.mean_mm == pytest.approx(0.25, abs=0.002)
        outside = np.abs(points[:, :2]).max(axis=1) > 22.0
        assert not found.compared[outside].any()
        assert found.compared[np.abs(points[:, :2]).max(axis=1) < 19.0].mean() > 0.999

    def test_both_need_points(self) -> None:
        with pytest.raises(InputError, match="A reference needs"):
            deviation_from_cloud(flat_points(100), np.full((100, 3), np.nan))


class TestTolerance:
    def test_the_verdict_needs_certainty_either_way(self) -> None:
        def verdict(limit_mm: float, sigma_mm: float) -> str:
            found = deviation_from_mesh(sphere_points(20_000, noise_mm=0.03), ball(12.7), alignment_sigma_mm=sigma_mm)
            return check_tolerance(found, -limit_mm, limit_mm).verdict

        # 99.7 % lie within about 0.09 mm.
        assert verdict(0.2, 0.01) == "pass"
        assert verdict(0.11, 0.03) == "undecided"
        assert verdict(0.05, 0.01) == "fail"

    def test_an_empty_tolerance_is_refused(self) -> None:
        found = deviation_from_mesh(sphere_points(300), ball(12.7))
        with pytest.raises(InputError, match="is empty"):
            check_tolerance(found, 0.1, -0.1)


def test_colours_tell_outside_from_inside_and_from_nothing() -> None:
    colours = deviation_colours(np.array([-1.0, 0.0, 0.5, 9.0, np.nan]), 1.0).astype(int)
    assert colours[0, 2] > colours[0, 0]
    assert (colours[1] == 245).all()
    assert colours[2, 0] > colours[2, 2]
    np.testing.assert_array_equal(colours[3], [190, 20, 30])
    np.testing.assert_array_equal(colours[4], [128, 128, 128])


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1.0), ("inch", 25.4), ("m", 1000.0)])
@pytest.mark.parametrize("share", [0.6, 1.0, 1.6])
def test_the_unit_is_known_by_the_size_also_of_a_part(unit: str, factor: float, share: float) -> None:
    scan = np.random.default_rng(1).uniform(0.0, 80.0, (5000, 3))
    guess = guess_unit(scan, scan / factor * share)
    assert guess.unit == unit
    assert guess.likely
    assert not guess_unit(scan, scan / factor * 4.5).likely
