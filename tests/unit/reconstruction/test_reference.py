"""Heights that count from the empty bed, as the reference pass saw it."""

import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.unit.reconstruction.small_pass import NO_BLOCK, Pass, write_pass
from twinline.reconstruction.offline import reconstruct
from twinline.reconstruction.reference import BedDrift, drift_of, smooth_line
from twinline.reconstruction.result import Reconstruction
from twinline.recording.capture import open_capture

SAG_MM = -1.2
GIVEN = replace(Pass().with_frames(40, 3.0), bed_mm=SAG_MM, block=((-20.0, -40.0, SAG_MM), (20.0, 30.0, SAG_MM + 15.0)))


def scan(folder: Path, laser: Pass, reference: Pass | None) -> Reconstruction:
    write_pass(folder, laser)
    if reference is not None:
        write_pass(folder.parent / "bed", reference)
        shutil.move(folder.parent / "bed" / "laser", folder / "reference")
    capture = open_capture(folder)
    with ThreadPoolExecutor(1) as pool:
        return reconstruct(capture, capture.rig(), executor=pool)


def heights(result: Reconstruction) -> tuple[float, float]:
    """Median of the block's top and of the bed."""
    x, y, z = result.cloud.points_mm.T
    top = (np.abs(x) < 17) & (y > -36) & (y < 26) & (z > 7)
    bed = (np.abs(x) > 26) | (y < -45) | (y > 35)
    return float(np.median(z[top])), float(np.median(z[bed]))


def test_a_bed_lower_than_the_rig_expects_shows_without_a_reference_pass(tmp_path: Path) -> None:
    top, bed = heights(scan(tmp_path / "capture", GIVEN, None))
    assert bed == pytest.approx(SAG_MM, abs=0.05)
    assert top == pytest.approx(SAG_MM + 15.0, abs=0.05)


def test_with_a_reference_pass_heights_count_from_that_bed(tmp_path: Path) -> None:
    top, bed = heights(scan(tmp_path / "capture", GIVEN, replace(GIVEN, block=NO_BLOCK, seed=77)))
    assert bed == pytest.approx(0.0, abs=0.05)
    # The rig sees the bed 1.2 mm from where it is, so the scale is off by as much of the 215 mm to the camera.
    assert top == pytest.approx(15.0, abs=0.25)


def test_a_bed_that_settled_after_the_reference_pass_is_noticed_and_said(tmp_path: Path) -> None:
    result = scan(tmp_path / "capture", GIVEN, replace(GIVEN, bed_mm=0.0, block=NO_BLOCK))
    _, bed = heights(result)
    assert bed == pytest.approx(0.0, abs=0.05)
    assert any("reference pass" in warning for warning in result.warnings)


def test_a_gap_in_the_reference_stripe_is_bridged_in_a_straight_line() -> None:
    line = np.linspace(10.0, 30.0, 41)[None]
    gapped = line.copy()
    gapped[0, 12:20] = np.nan
    # A running median of a straight line is that line, but for the ends of what was found.
    np.testing.assert_allclose(smooth_line(gapped)[0, 6:-6], line[0, 6:-6], atol=1.1)
    assert np.isfinite(smooth_line(gapped)).all()


def test_a_single_wrong_reading_of_the_bed_is_smoothed_away() -> None:
    line = np.full((1, 40), 12.0)
    line[0, 17] = 90.0
    np.testing.assert_array_equal(smooth_line(line), np.full((1, 40), 12.0))


def test_a_laser_that_shows_nothing_stays_unknown() -> None:
    assert np.isnan(smooth_line(np.full((2, 30), np.nan))).all()


def test_drift_needs_both_ends_of_the_stripe_to_agree() -> None:
    bed = np.full((1, 100), 50.0)
    centre = bed + 0.8
    np.testing.assert_allclose(drift_of(centre, bed), [0.8])
    centre[0, 30:70] += 40.0
    np.testing.assert_allclose(drift_of(centre, bed), [0.8])
    centre[0, 70:] += 3.0
    assert np.isnan(drift_of(centre, bed)).all()


def test_a_stripe_that_is_gone_or_far_away_tells_no_drift() -> None:
    bed = np.full((2, 100), 50.0)
    centre = np.stack([np.full(100, np.nan), np.full(100, 62.0)])
    assert np.isnan(drift_of(centre, bed)).all()


def test_drift_is_interpolated_between_the_positions_where_it_was_seen() -> None:
    drift = BedDrift(np.array([0.0, 10.0]), np.array([[0.0, 2.0], [1.0, 1.0]]))
    assert [drift.at(0, x) for x in (-5.0, 0.0, 2.5, 10.0, 99.0)] == [0.0, 0.0, 0.5, 2.0, 2.0]
    assert drift.at(1, 4.0) == 1.0
    assert BedDrift(np.empty(0), np.empty((0, 0))).at(0, 3.0) == 0.0
