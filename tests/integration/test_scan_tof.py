"""What a recorded ToF pass is worth: heights against the truth, edges and places without a reading left out."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.integration.scan_bench import ScanBench, on_machine, workspace
from twinline.arrays import BoolArray, FloatArray
from twinline.devices.simulator.tof import TofFaults
from twinline.fusion.tof import TofRaster, tof_sweeps
from twinline.operations.passes.requests import ScanRequest, TofPassRequest
from twinline.operations.passes.scan import run_scan
from twinline.recording.capture import open_capture
from twinline.recording.tof import TofSamples

SCENE = "steps"
REQUEST = TofPassRequest(186.0, 234.0, 40.0, 160.0, advance_mm=6.0, speed_mm_s=20.0)
"""Over all of the scene."""
FLAT_BUDGET_MM = 0.03
FLAT_AROUND_MM = 3.0
FLAT_MM = 0.02


@dataclass(frozen=True)
class Raster:
    """A recorded pass, its points' errors along the beam, and where the surface is flat around the spot."""

    samples: TofSamples
    error_mm: FloatArray
    raw_error_mm: FloatArray
    flat: BoolArray


def record(folder: Path, faults: TofFaults) -> TofSamples:
    async def play(bench: ScanBench) -> None:
        bench.simulated.adc.reader.faults = faults
        await run_scan(bench.session, ScanRequest(None, REQUEST))

    on_machine(folder, play, scene=SCENE)
    samples = open_capture(folder).tof()
    assert samples is not None
    return samples


@pytest.fixture(scope="module")
def raster(tmp_path_factory: pytest.TempPathFactory) -> Raster:
    samples = record(tmp_path_factory.mktemp("tof") / "scan", TofFaults())
    bed, rig = workspace(SCENE), workspace(SCENE).true_rig()
    assert rig.tof is not None
    raster = TofRaster(samples.time_s, samples.cart_mm, samples.slide_mm, samples.reading)
    points = tof_sweeps(raster, rig.tof, rig.travel).points_mm
    origins = rig.tof.position_mm + np.outer(samples.cart_mm, rig.travel) + np.outer(samples.slide_mm, rig.tof.slide)
    distance = (points - origins) @ rig.tof.beam
    raw = rig.tof.offset_mm + rig.tof.gain_mm_per_unit * samples.reading
    true = bed.tof_distances_mm(samples.cart_mm, samples.slide_mm)
    flat = np.ones(len(true), bool)
    for shift in np.linspace(-FLAT_AROUND_MM, FLAT_AROUND_MM, 7):
        flat &= np.abs(bed.tof_distances_mm(samples.cart_mm, samples.slide_mm + shift) - true) < FLAT_MM
    return Raster(samples, distance - true, raw - true, flat)


def test_heights_on_flats_are_true(raster: Raster) -> None:
    errors = raster.error_mm[raster.flat]
    errors = errors[np.isfinite(errors)]
    assert len(errors) > 0.85 * raster.flat.sum()
    # The sensor's own noise is 0.008 mm, a count of its converter 0.022 mm.
    assert abs(float(errors.mean())) < 0.002
    assert np.percentile(np.abs(errors), 95) < FLAT_BUDGET_MM
    assert float(np.sqrt(np.mean(errors**2))) < 0.5 * FLAT_BUDGET_MM


def test_edges_are_left_out(raster: Raster) -> None:
    # Undone, the lag alone is wrong by millimetres there.
    assert np.nanpercentile(np.abs(raster.raw_error_mm[~raster.flat]), 90) > 1.0
    errors = raster.error_mm[np.isfinite(raster.error_mm)]
    assert (np.abs(errors) > 0.1).mean() < 0.005


def test_dropouts_are_no_readings_and_spoil_no_others(tmp_path: Path) -> None:
    samples = record(tmp_path / "scan", TofFaults(dropout_share=0.1))
    missing = np.isnan(samples.reading)
    assert 0.08 < missing.mean() < 0.3
    bed, rig = workspace(SCENE), workspace(SCENE).true_rig()
    assert rig.tof is not None
    true = bed.tof_distances_mm(samples.cart_mm, samples.slide_mm)
    steady = np.ones(len(true), bool)
    for shift in (-FLAT_AROUND_MM, FLAT_AROUND_MM):
        steady &= np.abs(bed.tof_distances_mm(samples.cart_mm, samples.slide_mm + shift) - true) < FLAT_MM
    distance = rig.tof.offset_mm + rig.tof.gain_mm_per_unit * samples.reading
    errors = np.abs(distance - true)[steady & ~missing]
    # None of the readings that are left is a mean of something and nothing, which would lie millimetres off.
    assert (errors > 0.3).mean() < 0.01
