"""A recording played as the machine: the same passes give the same frames, positions and points, bit by bit."""

import asyncio
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.integration.scan_bench import LASER, TOF, ScanBench, on_machine
from twinline.devices.virtual_time import run_virtual
from twinline.machines import replayed_machine
from twinline.operations.passes.requests import ScanRequest
from twinline.operations.passes.scan import ScanOutcome, run_scan
from twinline.operations.passes.scan_folder import ScanFolder
from twinline.operations.passes.session import ScanSession
from twinline.reconstruction.offline import reconstruct
from twinline.reconstruction.result import Reconstruction, ReconstructionOptions
from twinline.recording.capture import Capture, open_capture


@dataclass(frozen=True)
class Twice:
    """A scan of a simulated machine, and the scan of its replay."""

    original: Capture
    again: Capture
    outcome: ScanOutcome
    outcome_again: ScanOutcome


def replay(recording: Path, folder: Path, speed: float) -> ScanOutcome:
    async def run() -> ScanOutcome:
        replayed = replayed_machine(recording, speed=speed)
        try:
            async with asyncio.timeout(600.0):
                session = ScanSession(replayed.machine, ScanFolder.create(folder))
                return await run_scan(session, replayed.requests)
        finally:
            replayed.close()

    return run_virtual(run())


def scan_and_pause(bench: ScanBench) -> "asyncio.Future[ScanOutcome]":
    async def play() -> ScanOutcome:
        scan = asyncio.ensure_future(run_scan(bench.session, ScanRequest(LASER, TOF)))
        await bench.until_cart(45.0)
        bench.session.control.pause()
        await asyncio.sleep(2.0)
        bench.session.control.resume()
        return await scan

    return asyncio.ensure_future(play())


@pytest.fixture(scope="module", params=[1.0, math.inf], ids=["at its own speed", "as fast as it can be read"])
def twice(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Twice:
    folder = tmp_path_factory.mktemp("replay")
    outcome = on_machine(folder / "original", lambda bench: run_scan(bench.session, ScanRequest(LASER, TOF)))
    again = replay(folder / "original", folder / "again", request.param)
    return Twice(open_capture(folder / "original"), open_capture(folder / "again"), outcome, again)


def require_same_frames(original: Capture, again: Capture) -> None:
    assert original.laser is not None
    assert again.laser is not None
    assert [f.cart_mm for f in again.laser.frames] == [f.cart_mm for f in original.laser.frames]
    assert [f.lasers for f in again.laser.frames] == [f.lasers for f in original.laser.frames]
    for ours, theirs in zip(again.laser.frames, original.laser.frames, strict=True):
        assert ours.stored is not None
        assert theirs.stored is not None
        assert ours.stored.raw_bytes() == theirs.stored.raw_bytes()


def test_frames_and_positions_are_the_same(twice: Twice) -> None:
    require_same_frames(twice.original, twice.again)
    assert twice.outcome_again.frames == twice.outcome.frames
    assert twice.outcome_again.dropped == 0


def test_the_background_frame_is_the_same(twice: Twice) -> None:
    assert twice.original.laser_off is not None
    assert twice.again.laser_off is not None
    assert twice.again.laser_off.read_bytes() == twice.original.laser_off.read_bytes()


def test_the_tof_pass_is_the_same(twice: Twice) -> None:
    original, again = twice.original.tof(), twice.again.tof()
    assert original is not None
    assert again is not None
    assert twice.outcome_again.rows == twice.outcome.rows
    for name in ("cart_mm", "slide_mm", "reading", "distance_mm"):
        np.testing.assert_array_equal(getattr(again, name), getattr(original, name))
    # Only the place of zero differs: each recording counts from its own beginning.
    np.testing.assert_allclose(np.diff(again.time_s), np.diff(original.time_s), atol=1e-9)


def test_the_reconstruction_is_the_same(twice: Twice) -> None:
    ours, theirs = cloud_of(twice.again), cloud_of(twice.original)
    assert len(theirs.cloud) > 1000
    np.testing.assert_array_equal(ours.cloud.points_mm, theirs.cloud.points_mm)
    np.testing.assert_array_equal(ours.cloud.sigma_mm, theirs.cloud.sigma_mm)


def cloud_of(capture: Capture) -> Reconstruction:
    rig = capture.own_rig()
    assert rig is not None
    with ThreadPoolExecutor(1) as executor:
        return reconstruct(capture, rig, ReconstructionOptions(), executor=executor)


def test_a_pass_that_was_interrupted_is_replayed_leg_by_leg(tmp_path: Path) -> None:
    on_machine(tmp_path / "original", scan_and_pause)
    replay(tmp_path / "original", tmp_path / "again", 1.0)
    assert len(list((tmp_path / "again").iterdir())) == len(list((tmp_path / "original").iterdir())) == 3
    require_same_frames(open_capture(tmp_path / "original"), open_capture(tmp_path / "again"))
