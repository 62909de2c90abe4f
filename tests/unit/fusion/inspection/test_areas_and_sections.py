import numpy as np
import pytest
import trimesh

from twinline.errors import InputError
from twinline.fusion.inspection.areas import surface_area, volume_over_base
from twinline.fusion.inspection.section import cross_section, mesh_section
from twinline.fusion.mesh import TriangleMesh


class TestVolume:
    @pytest.mark.parametrize("angle_deg", [0.0, 27.0])
    def test_volume_and_area_of_a_block_are_within_their_uncertainty(self, angle_deg: float) -> None:
        ratios = []
        turn = np.radians(angle_deg)
        for seed in range(40):
            rng = np.random.default_rng(seed)
            # The block's place on the raster is what decides how many cells it covers.
            y, x = np.mgrid[:90, :90] * 0.5 - 22.5 + rng.uniform(0.0, 0.5, 2)[:, None, None]
            u, v = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
            inside = (np.abs(u) < 10.1) & (np.abs(v) < 8.2)
            z = np.where(inside, 12.0, 0.0) + rng.normal(0.0, 0.05, inside.shape)
            found = volume_over_base(z, 0.5)
            assert found.highest_mm == pytest.approx(12.0, abs=0.3)
            ratios.append(
                [
                    (found.volume.value - 20.2 * 16.4 * 12.0) / found.volume.sigma,
                    (found.area.value - 20.2 * 16.4) / found.area.sigma,
                ]
            )
        # The four edges of a block err together in pairs, which makes the claim up to a factor of two too careful.
        assert np.sqrt(np.mean(np.square(ratios), axis=0)).max() < 1.5
        assert np.sqrt(np.mean(np.square(ratios), axis=0)).min() > 0.3

    def test_what_is_missing_inside_is_said_and_not_counted(self) -> None:
        z = np.zeros((30, 30))
        z[5:25, 5:25] = 4.0
        z[10:12, 10:13] = np.nan
        found = volume_over_base(z, 0.5)
        assert found.unmeasured_mm2 == pytest.approx(6 * 0.25)
        assert found.volume.value == pytest.approx(4.0 * (400 - 6) * 0.25)
        np.testing.assert_allclose(z.ravel()[found.used], 4.0)

    def test_a_bare_bed_has_no_volume(self) -> None:
        with pytest.raises(InputError, match=r"more than 0\.2 mm above the base at 0 mm"):
            volume_over_base(np.full((9, 9), 0.1), 0.5)

    def test_the_area_of_a_slope_is_that_of_the_surface_itself(self) -> None:
        y, x = np.mgrid[:21, :41] * 0.5
        assert surface_area(0.75 * x, 0.5) == pytest.approx(10.0 * 20.0 * 1.25)
        assert surface_area(0.75 * x, 0.5, x <= 10.0) == pytest.approx(10.0 * 10.0 * 1.25)
        assert surface_area(0.75 * y, 0.5) == pytest.approx(10.0 * 20.0 * 1.25)


class TestSection:
    def test_points_of_the_slice_are_seen_in_it_in_order(self) -> None:
        rng = np.random.default_rng(1)
        points = rng.uniform(-10.0, 10.0, (2000, 3))
        points[:, 2] = 0.3 * points[:, 0]
        points[5] = np.nan
        found = cross_section(points, np.array([0.0, 2.0, 0.0]), np.array([0.0, 3.0, 0.0]), thickness_mm=1.0)
        assert (np.diff(found.profile_mm[:, 0]) >= 0.0).all()
        assert (np.abs(points[found.used, 1] - 2.0) <= 0.5).all()
        assert len(found.used) == (np.abs(points[:, 1] - 2.0) <= 0.5).sum()
        np.testing.assert_allclose(found.profile_mm[:, 1], points[found.used, 2], atol=1e-12)
        np.testing.assert_allclose(np.abs(found.profile_mm[:, 0]), np.abs(points[found.used, 0]), atol=1e-12)

    def test_a_section_beside_the_points_is_refused(self) -> None:
        with pytest.raises(InputError, match=r"within 0\.25 mm"):
            cross_section(np.zeros((5, 3)), np.array([9.0, 0, 0]), np.array([1.0, 0, 0]))
        with pytest.raises(InputError, match="no direction"):
            cross_section(np.zeros((5, 3)), np.zeros(3), np.zeros(3))

    def test_the_outline_of_a_cut_sphere_is_its_circle_as_trimesh_finds_it(self) -> None:
        sphere = trimesh.creation.icosphere(4, radius=10.0)
        mesh = TriangleMesh(sphere.vertices, sphere.faces)
        segments = mesh_section(mesh, np.array([0.0, 0.0, 6.0]), np.array([0.0, 0.0, 1.0]))
        np.testing.assert_allclose(np.linalg.norm(segments, axis=2), 8.0, atol=0.03)
        length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum()
        other = sphere.section([0, 0, 1], [0, 0, 6.0])
        assert other is not None
        assert length == pytest.approx(float(other.length), rel=1e-9)
