"""The ToF sensor's points: lag undone, edges and flanks left out, noise averaged."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.unit.fusion.scenes import MOUNT, flat, raster, step
from twinline.arrays import FloatArray
from twinline.fusion.lag import estimate_lag
from twinline.fusion.tof import TofRaster, TofReason, freed_distances, tof_sweeps

TRAVEL = np.array([1.0, 0.0, 0.0])


def test_the_inverse_is_exact_for_a_distance_that_stays_between_readings() -> None:
    rng = np.random.default_rng(20260105)
    true = np.repeat(rng.uniform(70.0, 130.0, 200), 1)
    dt, tau = 0.01, 0.018
    a = np.exp(-dt / tau)
    seen, reading = true[0], []
    for value in true:
        seen = value + (seen - value) * a
        reading.append(seen)
    n = len(true)
    given = TofRaster(dt * np.arange(n), np.zeros(n), 0.0 * np.arange(n), np.array(reading))
    freed, reason = freed_distances(given, replace(MOUNT, range_mm=(0.0, 1000.0)), tau)
    good = np.isfinite(freed)
    assert good[1:].sum() > 100
    np.testing.assert_allclose(freed[good], true[good], atol=1e-9)
    assert not np.isfinite(freed[0])
    assert reason[0] == TofReason.NO_NEIGHBOURS


def test_a_flat_bed_lies_at_zero_within_the_reported_deviation() -> None:
    sweeps = tof_sweeps(raster(flat, noise_mm=0.02), MOUNT, TRAVEL)
    height = sweeps.points_mm[sweeps.kept, 2]
    assert sweeps.kept.mean() > 0.95
    assert abs(float(height.mean())) < 0.005
    # The lag's inverse multiplies noise by 2.7 here; averaging takes it back.
    assert float(height.std()) < 0.03
    assert float(np.median(sweeps.sigma_mm[sweeps.kept])) == pytest.approx(float(height.std()), rel=0.5)


@pytest.mark.parametrize("lag_s", [0.018, 0.03])
def test_points_near_a_step_lie_on_its_upper_or_lower_face(lag_s: float) -> None:
    sweeps = tof_sweeps(raster(step, lag_s=lag_s, noise_mm=0.01), replace(MOUNT, lag_s=lag_s), TRAVEL)
    points = sweeps.points_mm[sweeps.kept]
    off = np.minimum(np.abs(points[:, 2]), np.abs(points[:, 2] - 10.0))
    assert off.max() < 0.15
    upper = points[points[:, 2] > 5.0]
    assert len(upper) > 500
    # What lies on the plate lies over the plate: with the lag left in, edges move by 0.4 mm and more.
    assert np.abs(upper[:, 1]).max() < 8.05
    assert np.abs(points[points[:, 2] < 5.0, 1]).min() > 7.75


def test_left_in_the_lag_moves_edges() -> None:
    right, left_in = (tof_sweeps(raster(step), MOUNT, TRAVEL, lag_s=lag_s) for lag_s in (None, 0.0))
    off = [
        float(np.minimum(np.abs(s.points_mm[s.kept, 2]), np.abs(s.points_mm[s.kept, 2] - 10.0)).max())
        for s in (right, left_in)
    ]
    assert off[0] < 0.05
    assert off[1] > 2.0 * off[0]
    assert (right.kept.sum() - left_in.kept.sum()) > 100


def test_a_steep_flank_is_left_out_and_a_gentle_one_kept() -> None:
    def ramp(slope: float) -> TofRaster:
        def surface(x: FloatArray, y: FloatArray) -> FloatArray:
            return slope * (y + 30.0) + 0.0 * x

        return raster(surface, noise_mm=0.002, lines=4)

    # 20 mm/s and 18 ms: a slope of 0.14 is 0.05 mm in one lag.
    gentle, steep = (tof_sweeps(ramp(slope), MOUNT, TRAVEL) for slope in (0.08, 0.3))
    assert gentle.kept.mean() > 0.9
    assert steep.kept.mean() < 0.05
    assert (steep.reason == TofReason.TOO_FAST).mean() > 0.9
    points = gentle.points_mm[gentle.kept]
    np.testing.assert_allclose(points[:, 2], 0.08 * (points[:, 1] + 30.0), atol=0.04)


def test_readings_that_are_none_are_named_by_reason() -> None:
    given = raster(flat)
    reading = given.reading.copy()
    reading[50], reading[90], reading[200] = np.nan, 139.99 + 5.0, 120.0
    sweeps = tof_sweeps(replace(given, reading=reading), MOUNT, TRAVEL)
    assert sweeps.reason[50] == TofReason.NO_READING
    assert sweeps.reason[90] == TofReason.OUT_OF_RANGE
    assert sweeps.reason[200] == TofReason.SPIKE
    assert not np.isfinite(sweeps.points_mm[[50, 90, 200]]).any()
    assert sweeps.kept.mean() > 0.9


def test_a_pass_without_readings_has_no_points() -> None:
    none = np.empty(0)
    sweeps = tof_sweeps(TofRaster(none, none, none, none), MOUNT, TRAVEL)
    assert sweeps.points_mm.shape == (0, 3)


@pytest.mark.parametrize("lag_s", [0.01, 0.018, 0.04])
def test_the_lag_is_found_from_opposite_sweeps(lag_s: float) -> None:
    found = estimate_lag(raster(step, lag_s=lag_s, noise_mm=0.01, lines=16), MOUNT)
    assert found == pytest.approx(lag_s, abs=0.0015)


@pytest.mark.parametrize(("case", "options"), [("one way", {"both_ways": False}), ("few lines", {"lines": 1})])
def test_a_raster_that_cannot_tell_the_lag_says_so(case: str, options: dict[str, Any]) -> None:
    assert estimate_lag(raster(step, **options), MOUNT) is None, case


def test_a_flat_bed_cannot_tell_the_lag() -> None:
    assert estimate_lag(raster(flat, noise_mm=0.01), MOUNT) is None
