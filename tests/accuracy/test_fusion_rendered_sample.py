"""Lasers and ToF of a capture that another program rendered, fused, against the true surfaces.

The rig is the true one; the ToF sensor's part of it is worked out here from the truth's own numbers. Budgets are those
of a calibrated machine: 0.065 mm over all points, 0.095 mm on the objects; the two lasers alone cover 93 to 95 % of the
surface seen from above.
"""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.accuracy.rendered_truth import RenderedTruth, Score, read_truth
from twinline.fusion.cloud import Source
from twinline.fusion.lag import estimate_lag
from twinline.fusion.tof import TofRaster
from twinline.geometry.rig import Rig, TofMount
from twinline.reconstruction.fused import reconstruct_fused, sources_of
from twinline.reconstruction.result import Reconstruction, ReconstructionOptions
from twinline.recording.capture import Capture, open_capture

ALL_MM = 0.065
OBJECTS_MM = 0.095
GROSS = 0.00015
LASERS_APART_MM = 0.03


@pytest.fixture(scope="module")
def capture(shared_data: Callable[[str], Path]) -> Capture:
    return open_capture(shared_data("rendered_sample"))


@pytest.fixture(scope="module")
def truth(capture: Capture) -> RenderedTruth:
    return read_truth(capture.path)


@pytest.fixture(scope="module")
def lasers(capture: Capture, truth: RenderedTruth) -> Reconstruction:
    return reconstruct_fused(capture, truth.rig, ReconstructionOptions(sources=frozenset({"laser1", "laser2"})))


@pytest.fixture(scope="module")
def score(lasers: Reconstruction, truth: RenderedTruth) -> Score:
    return truth.score(lasers.cloud.points_mm)


def test_two_lasers_fused_keep_to_the_budget(score: Score) -> None:
    assert score.points > 50_000
    assert score.rms_mm <= ALL_MM
    assert score.objects_mm <= OBJECTS_MM
    assert score.gross <= GROSS


def test_the_lasers_agree_without_any_registration(lasers: Reconstruction) -> None:
    assert lasers.agreement is not None
    assert lasers.agreement.places > 50_000
    assert abs(lasers.agreement.offset_mm) <= LASERS_APART_MM


@pytest.mark.parametrize("source", [Source.LASER_1, Source.LASER_2, Source.BOTH_LASERS])
def test_reported_deviations_are_the_real_ones(
    source: Source, lasers: Reconstruction, truth: RenderedTruth
) -> None:  # fmt: skip
    points = lasers.cloud.points_mm.astype(np.float64)
    judged = (np.abs(points[:, 0]) < 55) & (np.abs(points[:, 1]) < 90) & (lasers.cloud.source == source)
    error = 1.4826 * float(np.median(truth.distance(points[judged])))
    assert float(np.median(lasers.cloud.sigma_mm[judged])) == pytest.approx(error, rel=0.35)


def test_the_lag_is_read_from_the_raster_itself(capture: Capture) -> None:
    samples = capture.tof()
    nominal = capture.rig().tof
    assert samples is not None
    assert nominal is not None
    raster = TofRaster(samples.time_s, samples.cart_mm, samples.slide_mm, samples.reading)
    true = json.loads((capture.path / "truth.json").read_text(encoding="utf-8"))["tof"]["lag_tau_s"]
    assert estimate_lag(raster, nominal) == pytest.approx(true, abs=0.0005)


@pytest.mark.slow
def test_the_tof_sensor_makes_it_better_and_covers_what_the_lasers_leave(
    capture: Capture, truth: RenderedTruth, score: Score
) -> None:  # fmt: skip
    rig = with_tof(truth.rig, capture)
    options = ReconstructionOptions(sources=sources_of(capture, rig), fill=True)
    found = truth.score(reconstruct_fused(capture, rig, options).cloud.points_mm)
    assert found.rms_mm <= 0.8 * score.rms_mm
    assert found.objects_mm <= OBJECTS_MM
    assert found.gross <= GROSS
    assert found.covered >= max(score.covered + 0.02, 0.98)


def with_tof(rig: Rig, capture: Capture) -> Rig:
    """The true rig with the true ToF sensor: it stands off the camera's foot, tilted about the travel and across it."""
    true = json.loads((capture.path / "truth.json").read_text(encoding="utf-8"))["tof"]
    nominal = capture.rig().tof
    assert nominal is not None
    foot = rig.bed_from_camera.translation_mm * [1.0, 1.0, 0.0]
    along, across = np.radians(true["tilt_deg"])
    beam = np.array([np.sin(along), np.sin(across), 0.0])
    beam[2] = -np.sqrt(1.0 - beam @ beam)
    yaw = np.radians(true["slide_yaw_deg"])
    mount = TofMount(
        foot + np.array(true["offset_mm"]), beam, np.array([-np.sin(yaw), np.cos(yaw), 0.0]),
        nominal.gain_mm_per_unit, nominal.offset_mm, nominal.range_mm, true["lag_tau_s"],
    )  # fmt: skip
    return replace(rig, tof=mount)
