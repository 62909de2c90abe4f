from dataclasses import replace

import numpy as np
import pytest

from tests.unit.calibration.scanner_samples import crooked_rig
from twinline.arrays import FloatArray
from twinline.calibration.joint_model import Scanner, tof_points
from twinline.calibration.observations import TofReadings
from twinline.calibration.scanner import scanner_of_rig
from twinline.calibration.tof_start import (
    FIRST_CUT_MM,
    LAST_CUT_MM,
    HeightMap,
    follow_on,
    height_map,
    start_tof,
    tof_bed_groups,
    without_spikes,
)
from twinline.errors import CalibrationError


def top(x: FloatArray, y: FloatArray) -> FloatArray:
    """Two blocks of different height on the bed."""
    first = (np.abs(x - 20) < 12) & (np.abs(y + 20) < 10)
    second = (np.abs(x - 25) < 10) & (np.abs(y - 22) < 13)
    return np.asarray(np.where(first, 12.0, 0.0) + np.where(second, 25.0, 0.0))


def surface(error_mm: float = 0.0) -> HeightMap:
    x, y = (a.ravel() for a in np.meshgrid(np.arange(-20, 70, 0.5) + 0.25, np.arange(-60, 60, 0.5) + 0.25))
    z = top(x, y)
    return height_map([np.column_stack([x, y, z * (1 + error_mm / 25.0)])], [])


def raster(scanner: Scanner, lag_s: float = 0.016) -> TofReadings:
    """What the scanner's own ToF sensor would read over the blocks, swept to and fro."""
    assert scanner.tof is not None
    axes, tof = scanner.axes(), scanner.tof
    beam = axes @ tof.beam
    position = axes @ tof.position + np.array([0.0, 0.0, scanner.height_mm()])
    carts, slides = [], []
    sweep = np.arange(-55.0, 45.0, 0.25)
    for number, cart in enumerate(np.arange(105.0, 155.0, 1.5)):
        carts.append(np.full(len(sweep), cart))
        slides.append(sweep if number % 2 == 0 else sweep[::-1])
    cart, slide = np.concatenate(carts), np.concatenate(slides)
    origin = position + np.outer(cart, axes @ scanner.travel) + np.outer(slide, axes @ tof.slide)
    distance = origin[:, 2] / -beam[2]
    for _ in range(20):
        hit = origin + beam * distance[:, None]
        distance = (origin[:, 2] - top(hit[:, 0], hit[:, 1])) / -beam[2]
    keep = np.exp(-0.01 / lag_s)
    seen = distance.copy()
    for i in range(1, len(seen)):
        seen[i] = keep * seen[i - 1] + (1 - keep) * distance[i]
    reading = (seen - tof.offset) / tof.gain
    return TofReadings(np.arange(len(cart)) * 0.01, cart, slide, np.rint(reading))


@pytest.fixture
def scanner() -> Scanner:
    return scanner_of_rig(crooked_rig())


def misplaced(scanner: Scanner, shift: list[float]) -> Scanner:
    assert scanner.tof is not None
    moved = scanner.tof.position + scanner.axes().T @ np.array(shift)
    return replace(scanner, tof=replace(scanner.tof, position=moved, lag_s=0.0))


@pytest.mark.parametrize("shift", [[5.0, -6.0, 3.0], [-7.0, 2.0, -4.0]])
def test_a_mount_some_millimetres_off_is_found_with_its_lag(scanner: Scanner, shift: list[float]) -> None:
    tof = follow_on(raster(scanner))
    found, _ = start_tof(misplaced(scanner, shift), tof, surface(), cut_mm=LAST_CUT_MM)
    assert found.tof is not None
    assert scanner.tof is not None
    off = scanner.axes() @ (found.tof.position - scanner.tof.position)
    assert np.abs(off).max() < 0.6
    assert found.tof.lag_s == pytest.approx(0.016, abs=0.006)


def test_a_height_map_that_is_still_wrong_by_a_millimetre_does_not_mislead_the_first_search(scanner: Scanner) -> None:
    tof = follow_on(raster(scanner))
    found, _ = start_tof(misplaced(scanner, [4.0, -5.0, 0.0]), tof, surface(1.5), cut_mm=FIRST_CUT_MM)
    assert found.tof is not None
    assert scanner.tof is not None
    assert np.abs(scanner.axes() @ (found.tof.position - scanner.tof.position)).max() < 1.5


def test_a_raster_beside_the_laser_pass_is_refused_with_both_ranges(scanner: Scanner) -> None:
    tof = follow_on(raster(scanner))
    with pytest.raises(CalibrationError, match="nothing in common") as caught:
        start_tof(misplaced(scanner, [400.0, 0.0, 0.0]), tof, surface(), cut_mm=FIRST_CUT_MM)
    assert caught.value.code == "no-overlap"


def test_single_false_readings_are_left_out_and_steps_are_kept() -> None:
    rng = np.random.default_rng(5)
    reading = np.concatenate([np.full(300, 3000.0), np.full(300, 2200.0)]) + rng.normal(0, 1.5, 600)
    clean = reading.copy()
    wrong = rng.random(600) < 0.1
    reading[wrong] = rng.uniform(0, 4095, int(wrong.sum()))
    kept = np.isfinite(without_spikes(reading))
    assert kept[wrong].mean() < 0.12
    assert kept[~wrong].mean() > 0.97
    assert np.isfinite(without_spikes(clean)).all()


def test_readings_follow_on_only_within_a_sweep_and_without_gaps() -> None:
    nan = float("nan")
    readings = TofReadings(
        np.array([0.0, 0.01, 0.02, 0.03, 0.50, 0.51, 0.52]),
        np.array([10.0, 10.0, 10.0, 10.0, 10.0, 11.0, 11.0]),
        np.arange(7.0),
        np.array([100.0, 101.0, nan, 103.0, 104.0, 105.0, 107.0]),
    )
    points = follow_on(readings)
    np.testing.assert_array_equal(points.reading, [101.0, 107.0])
    np.testing.assert_array_equal(points.change, [1.0, 2.0])


def test_readings_on_the_bed_are_averaged_over_squares_of_it(scanner: Scanner) -> None:
    tof = follow_on(raster(scanner))
    points = tof_points(scanner, tof) @ scanner.axes().T + np.array([0.0, 0.0, scanner.height_mm()])
    on_bed = np.flatnonzero(np.abs(points[:, 2]) < 0.3)
    groups = tof_bed_groups(tof, points, on_bed)
    assert 10 < len(groups) < len(on_bed) / 20
    means = tof_points(scanner, groups) @ scanner.axes().T + np.array([0.0, 0.0, scanner.height_mm()])
    # What the counts round off averages out.
    assert np.abs(means[:, 2]).max() < 0.005
    assert not len(tof_bed_groups(tof, points, on_bed[:0]))
