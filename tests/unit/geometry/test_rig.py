import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twinline.errors import RigError
from twinline.geometry.noise import NoiseModel
from twinline.geometry.nominal import default_rig
from twinline.geometry.rig import Covariance, Drives, TofMount, Transform
from twinline.geometry.sheet import LaserSheet


class TestTransform:
    POSE = Transform(Rotation.from_euler("xyz", [0.3, -1.2, 2.1]).as_matrix(), np.array([3.0, -40.0, 500.0]))
    POINTS = np.random.default_rng(1).normal(scale=300, size=(50, 3))

    def test_the_inverse_undoes_it_on_both_sides(self) -> None:
        back = self.POSE.inverse()
        np.testing.assert_allclose(back.apply(self.POSE.apply(self.POINTS)), self.POINTS, atol=1e-10)
        np.testing.assert_allclose(self.POSE.apply(back.apply(self.POINTS)), self.POINTS, atol=1e-10)

    def test_distances_and_handedness_are_kept(self) -> None:
        moved = self.POSE.apply(self.POINTS)
        np.testing.assert_allclose(
            np.linalg.norm(np.diff(moved, axis=0), axis=1), np.linalg.norm(np.diff(self.POINTS, axis=0), axis=1)
        )
        volume = np.linalg.det(self.POINTS[1:4] - self.POINTS[0])
        assert np.linalg.det(moved[1:4] - moved[0]) == pytest.approx(volume)

    def test_the_origin_goes_to_the_translation(self) -> None:
        np.testing.assert_array_equal(self.POSE.apply(np.zeros((1, 3)))[0], self.POSE.translation_mm)

    def test_rotation_is_applied_from_the_left(self) -> None:
        expected = self.POSE.rotation @ self.POINTS[7] + self.POSE.translation_mm
        np.testing.assert_allclose(self.POSE.apply(self.POINTS)[7], expected)

    @pytest.mark.parametrize("rotation", [np.diag([1.0, 1.0, -1.0]), 2 * np.eye(3), np.eye(2), np.full((3, 3), np.nan)])
    def test_what_is_no_rotation_is_refused(self, rotation: np.ndarray) -> None:
        with pytest.raises(RigError, match="rotation"):
            Transform(rotation, np.zeros(3))

    def test_its_arrays_cannot_be_changed(self) -> None:
        with pytest.raises(ValueError, match="read-only"):
            self.POSE.rotation[0, 0] = 2.0


class TestRig:
    def test_a_side_that_does_not_fit_the_stripes_is_refused(self) -> None:
        rig = default_rig()
        with pytest.raises(RigError, match=r"side '\+v'.*along-v"):
            dataclasses.replace(rig, stripe_runs="along-v")

    def test_two_lasers_on_one_side_are_refused(self) -> None:
        rig = default_rig()
        with pytest.raises(RigError, match="opposite sides"):
            dataclasses.replace(rig, sheets=(rig.sheets[0], rig.sheets[0]))

    @pytest.mark.parametrize("count", [0, 3])
    def test_a_rig_has_one_or_two_lasers(self, count: int) -> None:
        rig = default_rig()
        with pytest.raises(RigError, match=f"not {count}"):
            dataclasses.replace(rig, sheets=rig.sheets[:1] * count)

    @pytest.mark.parametrize("travel", [[0, 0, 0], [1, 0], [np.nan, 0, 0]])
    def test_a_travel_that_leads_nowhere_is_refused(self, travel: list[float]) -> None:
        with pytest.raises(RigError, match="travel"):
            dataclasses.replace(default_rig(), travel=np.array(travel))

    def test_stripes_run_one_of_two_ways(self) -> None:
        with pytest.raises(RigError, match="diagonally"):
            dataclasses.replace(default_rig(), stripe_runs="diagonally")  # type: ignore[arg-type]

    def test_sheets_given_as_a_list_are_kept_as_a_tuple(self) -> None:
        sheets = [LaserSheet(np.array([0.0, 0.9, 0.4]), 220.0, "+v")]
        rig = dataclasses.replace(default_rig(), sheets=sheets)  # type: ignore[arg-type]
        assert rig.sheets == tuple(sheets)


class TestCovariance:
    def test_standard_deviations_are_found_by_name_and_zero_where_unknown(self) -> None:
        covariance = Covariance(("camera.fx", "bed.rx"), np.array([[4.0, 1e-4], [1e-4, 1e-6]]))
        assert covariance.sd("camera.fx") == 2.0
        assert covariance.sd("bed.rx") == pytest.approx(1e-3)
        assert covariance.sd("travel.x") == 0.0

    @pytest.mark.parametrize(
        ("names", "matrix"),
        [
            (("a", "b"), np.eye(3)),
            (("a", "a"), np.eye(2)),
            (("a", "b"), np.array([[1.0, 0.5], [0.4, 1.0]])),
            (("a", "b"), np.array([[1e-12, 5e-13], [4e-13, 1e-12]])),
            (("a",), np.array([[-1.0]])),
            (("a",), np.array([[np.inf]])),
        ],
    )
    def test_what_is_no_covariance_is_refused(self, names: tuple[str, ...], matrix: np.ndarray) -> None:
        with pytest.raises(RigError, match="covariance"):
            Covariance(names, matrix)


class TestParts:
    def test_variance_is_read_shot_and_speckle_noise_together(self) -> None:
        noise = NoiseModel(2.0, 4.0, 0.1)
        np.testing.assert_allclose(noise.variance_dn2(np.array([-5.0, 0.0, 100.0])), [4.0, 4.0, 4.0 + 25.0 + 100.0])

    @pytest.mark.parametrize("values", [(-1.0, 4.0, 0.1), (1.0, 0.0, 0.1), (1.0, 4.0, 1.5), (float("nan"), 4.0, 0.1)])
    def test_an_impossible_noise_is_refused(self, values: tuple[float, float, float]) -> None:
        with pytest.raises(RigError, match="noise"):
            NoiseModel(*values)

    @pytest.mark.parametrize("values", [(0.0, 200.0), (10.0, -1.0), (float("inf"), 200.0)])
    def test_impossible_drives_are_refused(self, values: tuple[float, float]) -> None:
        with pytest.raises(RigError, match="steps"):
            Drives(*values)

    @pytest.mark.parametrize(
        ("change", "word"),
        [
            ({"position_mm": [1, 2]}, "position_mm"),
            ({"beam": [0, 0, -2]}, "beam"),
            ({"gain_mm_per_unit": 0.0}, "gain"),
            ({"range_mm": (140.0, 60.0)}, "range"),
            ({"lag_s": -1.0}, "lag"),
        ],
    )
    def test_an_impossible_tof_mount_is_refused(self, change: dict[str, object], word: str) -> None:
        tof = default_rig().tof
        assert isinstance(tof, TofMount)
        with pytest.raises(RigError, match=word):
            dataclasses.replace(tof, **change)  # type: ignore[arg-type]
