"""Whole scans on a simulated machine in virtual time, against what the machine truly did."""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest

from tests.integration.scan_bench import LASER, RATE_HZ, TOF, ScanBench, Witness, on_machine
from twinline.devices.board import DEFAULT_CART
from twinline.errors import CancelledError, DeviceError, TwinlineError
from twinline.operations.passes import laser as laser_pass
from twinline.operations.passes.laser import run_laser_pass
from twinline.operations.passes.requests import ScanRequest
from twinline.operations.passes.scan import ScanOutcome, continue_scan, run_scan
from twinline.recording.capture import open_capture
from twinline.recording.images import read_image
from twinline.recording.pass_reader import Recording
from twinline.recording.recorded_capture import RecordedCapture

BUDGET_MM = 0.05
BOTH = ScanRequest(LASER, TOF)
BOTH_LASERS = frozenset({1, 2})
LASER_ONLY = ScanRequest(LASER, None)
TOF_ONLY = ScanRequest(None, TOF)
PITCH_MM = LASER.speed_mm_s / RATE_HZ
Result = TypeVar("Result")


def opened(folder: Path) -> RecordedCapture:
    capture = open_capture(folder)
    assert isinstance(capture, RecordedCapture)
    assert not capture.problems
    return capture


def positions(capture: RecordedCapture) -> list[float]:
    assert capture.laser is not None
    return [frame.cart_mm for frame in capture.laser.frames]


def seconds_of(recording: Recording) -> float:
    """From a recording's first movement to its last."""
    return recording.events[-1].host_time_s - recording.header.host_time_s


class Scanned:
    """One undisturbed scan, both passes, with clock drift, and all that was seen of it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

        async def play(bench: ScanBench) -> tuple[ScanOutcome, Witness, list[str], bool]:
            outcome = await run_scan(bench.session, BOTH)
            return outcome, bench.truth, bench.phases, bench.dark and not bench.simulated.board.moving

        self.outcome, self.truth, self.phases, self.safe = on_machine(folder, play, drift_ppm=80.0)
        self.capture = opened(folder)
        self.laser, self.tof = (
            next(r for r in self.capture.recordings if r.header.kind == kind) for kind in ("laser", "tof")
        )


@pytest.fixture(scope="module")
def scanned(tmp_path_factory: pytest.TempPathFactory) -> Scanned:
    return Scanned(tmp_path_factory.mktemp("scan") / "scan")


class TestAScan:
    def test_its_recordings_open_as_one_capture(self, scanned: Scanned) -> None:
        assert scanned.capture.laser is not None
        assert len(scanned.capture.laser) == scanned.outcome.frames >= 24
        assert scanned.capture.tof() is not None
        assert scanned.capture.own_rig() is not None
        assert scanned.laser.whole
        assert scanned.tof.whole

    def test_nothing_is_lost_and_nothing_wrong_is_reported(self, scanned: Scanned) -> None:
        assert (scanned.outcome.dropped, scanned.outcome.warnings) == (0, ())
        assert all(check.grade == "good" for check in scanned.outcome.checks)

    def test_the_lasers_are_off_and_the_axes_stand_in_the_end(self, scanned: Scanned) -> None:
        assert scanned.safe

    def test_what_is_being_done_is_told_in_words(self, scanned: Scanned) -> None:
        expected = ["connecting", "homing", "checks", "background frame", "laser pass", "ToF pass"]
        assert [phase for phase in scanned.phases if phase in expected] == expected

    def test_frames_are_stamped_with_where_the_cart_truly_was(self, scanned: Scanned) -> None:
        assert scanned.capture.laser is not None
        errors = [frame.cart_mm - scanned.truth.cart[frame.time_s] for frame in scanned.capture.laser.frames]
        assert np.abs(errors).max() <= BUDGET_MM

    def test_every_frame_was_lit_as_it_says(self, scanned: Scanned) -> None:
        assert scanned.capture.laser is not None
        assert all(
            scanned.truth.lit[frame.time_s] == frame.lasers == BOTH_LASERS for frame in scanned.capture.laser.frames
        )

    def test_the_frames_cover_the_area_evenly(self, scanned: Scanned) -> None:
        places = positions(scanned.capture)
        assert LASER.from_mm <= places[0] < LASER.from_mm + PITCH_MM
        assert LASER.to_mm - PITCH_MM < places[-1] <= LASER.to_mm
        np.testing.assert_allclose(np.diff(places), PITCH_MM, atol=0.1)

    def test_the_background_frame_is_dark_and_the_others_are_lit(self, scanned: Scanned) -> None:
        assert scanned.capture.laser is not None
        assert scanned.capture.laser_off is not None
        dark = read_image(scanned.capture.laser_off).astype(int)
        # The first frame is taken almost where the background is: but for the light they show the same.
        lit = next(iter(scanned.capture.laser.read([0]))).image
        assert lit is not None
        gain = (lit - dark).max(axis=2)
        assert np.median(np.abs(gain)) < 15
        assert (gain.max(axis=0) > 60).mean() > 0.9

    def test_the_forecasts_hold(self, scanned: Scanned) -> None:
        laser, tof = scanned.outcome.forecasts
        assert laser.samples == pytest.approx(scanned.outcome.frames, abs=1)
        assert laser.duration_s == pytest.approx(seconds_of(scanned.laser), rel=0.04)
        assert tof.duration_s == pytest.approx(seconds_of(scanned.tof), rel=0.04)
        assert tof.samples == pytest.approx(400 * seconds_of(scanned.tof), rel=0.04)

    def test_the_recording_says_how_it_was_made(self, scanned: Scanned) -> None:
        settings = scanned.laser.header.settings
        assert settings["request"] == LASER.to_json()
        assert settings["rate_hz"] == RATE_HZ
        assert settings["simulated"] is True
        assert set(settings) >= {"plan", "board", "camera"}


class TestTheTofPass:
    def test_rows_lie_where_they_were_asked_for(self, scanned: Scanned) -> None:
        starts = [event for event in scanned.tof.events if event.kind == "row-start"]
        assert scanned.outcome.rows == len(starts) == 5
        np.testing.assert_allclose([event.cart_mm for event in starts], np.arange(5), atol=DEFAULT_CART.mm_per_step)

    def test_sweeps_go_to_and_fro(self, scanned: Scanned) -> None:
        rows = zip(
            (event.slide_mm for event in scanned.tof.events if event.kind == "row-start"),
            (event.slide_mm for event in scanned.tof.events if event.kind == "row-end"),
            strict=True,
        )
        ends = [(round(begin), round(end)) for begin, end in rows]
        assert ends == [(40, 70), (70, 40), (40, 70), (70, 40), (40, 70)]

    def test_it_has_four_readings_for_each_line_of_telemetry(self, scanned: Scanned) -> None:
        samples = scanned.capture.tof()
        assert samples is not None
        assert len(samples) == pytest.approx(4 * len(scanned.tof.telemetry), abs=8)
        assert np.isfinite(samples.distance_mm).all()


def test_lasers_that_take_turns_are_told_apart(tmp_path: Path) -> None:
    request = ScanRequest(replace(LASER, to_mm=60.0, speed_mm_s=25.0, alternating=True), None)
    on_machine(tmp_path / "scan", lambda bench: run_scan(bench.session, request))
    capture = opened(tmp_path / "scan")
    assert capture.laser is not None
    seen = [frame.lasers for frame in capture.laser.frames]
    shares = [seen.count(frozenset({laser})) / len(seen) for laser in (1, 2)]
    assert min(shares) > 0.2
    stripes: dict[int, list[float]] = {1: [], 2: []}
    for frame in capture.laser.read(range(len(capture.laser))):
        lasers = frame.entry.lasers
        assert lasers is not None
        if lasers and frame.image is not None:
            red = frame.image[:, :, 2].astype(int) - frame.image[:, :, :2].max(axis=2)
            (laser,) = lasers
            stripes[laser].append(float(np.median(red.argmax(axis=0))))
    # Laser 1 lies at larger v; had they been swapped anywhere, the ranges would overlap.
    assert min(stripes[1]) > max(stripes[2]) + 20


class TestInterruptions:
    def test_a_paused_pass_is_dark_and_still_and_goes_on_without_gap_or_overlap(self, tmp_path: Path) -> None:
        async def play(bench: ScanBench) -> tuple[ScanOutcome, bool, Witness]:
            scan = asyncio.ensure_future(run_scan(bench.session, LASER_ONLY))
            await bench.until_cart(40.0)
            bench.session.control.pause()
            await asyncio.sleep(8.0)
            safe = bench.dark and not bench.simulated.board.moving and not scan.done()
            bench.session.control.resume()
            return await scan, safe, bench.truth

        outcome, safe, truth = on_machine(tmp_path / "scan", play)
        assert safe
        capture = opened(tmp_path / "scan")
        assert capture.laser is not None
        # Between the stop and standing still there is no light.
        assert all(truth.lit[frame.time_s] == {1, 2} for frame in capture.laser.frames if frame.time_s in truth.lit)
        assert len(capture.recordings) == 2
        self.require_even(capture, outcome.frames)

    def test_a_pause_that_is_taken_back_at_once_does_not_end_the_pass(self, tmp_path: Path) -> None:
        async def play(bench: ScanBench) -> ScanOutcome:
            scan = asyncio.ensure_future(run_scan(bench.session, LASER_ONLY))
            await bench.until_cart(40.0)
            bench.session.control.pause()
            bench.session.control.resume()
            return await scan

        self.require_even_of(on_machine(tmp_path / "scan", play), tmp_path / "scan")

    def test_a_pass_can_be_paused_more_often_than_it_may_be_disturbed(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(laser_pass, "MOST_INTERRUPTIONS", 2)

        async def play(bench: ScanBench) -> ScanOutcome:
            scan = asyncio.ensure_future(run_scan(bench.session, LASER_ONLY))
            for place_mm in np.arange(24.0, 64.0, 10.0).tolist():
                await bench.until_cart(place_mm)
                bench.session.control.pause()
                bench.session.control.resume()
                await bench.until(lambda: bench.dark)
            return await scan

        self.require_even_of(on_machine(tmp_path / "scan", play), tmp_path / "scan")

    def test_a_pause_before_the_pass_lets_nothing_move(self, tmp_path: Path) -> None:
        async def play(bench: ScanBench) -> tuple[float, ScanOutcome]:
            bench.session.control.pause()
            scan = asyncio.ensure_future(run_scan(bench.session, LASER_ONLY))
            await asyncio.sleep(60.0)
            stood_mm = bench.simulated.board.cart_mm(asyncio.get_running_loop().time())
            bench.session.control.resume()
            return stood_mm, await scan

        stood_mm, outcome = on_machine(tmp_path / "scan", play)
        assert stood_mm == 0.0
        self.require_even_of(outcome, tmp_path / "scan")

    def test_stopping_from_elsewhere_ends_the_pass(self, tmp_path: Path) -> None:
        async def play(bench: ScanBench) -> TwinlineError:
            scan = asyncio.ensure_future(run_scan(bench.session, LASER_ONLY))
            await bench.until_cart(40.0)
            await bench.simulated.machine.board.stop()
            return await raised(scan)

        error = on_machine(tmp_path / "scan", play)
        assert (error.code, opened(tmp_path / "scan").laser is not None) == ("stopped", True)

    @pytest.mark.parametrize("when_mm", [None, 40.0], ids=["before it began", "in its middle"])
    def test_a_cancelled_pass_ends_dark_with_a_recording_that_opens(
        self, tmp_path: Path, when_mm: float | None
    ) -> None:
        async def play(bench: ScanBench) -> tuple[TwinlineError, bool, float]:
            scan = asyncio.ensure_future(run_scan(bench.session, LASER_ONLY))
            if when_mm is not None:
                await bench.until_cart(when_mm)
            bench.session.control.cancel()
            began_s = asyncio.get_running_loop().time()
            error = await raised(scan)
            return error, bench.dark and not bench.simulated.board.moving, asyncio.get_running_loop().time() - began_s

        error, safe, took_s = on_machine(tmp_path / "scan", play)
        assert isinstance(error, CancelledError)
        assert safe
        if when_mm is not None:
            assert took_s < 5.0
            places = positions(opened(tmp_path / "scan"))
            assert places[-1] == pytest.approx(when_mm, abs=2 * PITCH_MM)

    def test_a_task_that_is_cancelled_ends_dark_too(self, tmp_path: Path) -> None:
        async def play(bench: ScanBench) -> bool:
            scan = asyncio.ensure_future(run_scan(bench.session, LASER_ONLY))
            await bench.until_cart(40.0)
            scan.cancel()
            await asyncio.wait({scan})
            return scan.cancelled() and bench.dark and not bench.simulated.board.moving

        assert on_machine(tmp_path / "scan", play)
        assert positions(opened(tmp_path / "scan"))

    def test_a_paused_tof_pass_goes_on_with_the_row_that_was_not_finished(self, tmp_path: Path) -> None:
        async def play(bench: ScanBench) -> ScanOutcome:
            scan = asyncio.ensure_future(run_scan(bench.session, TOF_ONLY))
            await bench.until(lambda: bench.rows == 2)
            await asyncio.sleep(0.5)
            bench.session.control.pause()
            await asyncio.sleep(5.0)
            bench.session.control.resume()
            return await scan

        assert on_machine(tmp_path / "scan", play).rows == 5
        capture = opened(tmp_path / "scan")
        assert len(capture.recordings) == 2
        ends = [e for recording in capture.recordings for e in recording.events if e.kind == "row-end"]
        assert [round(e.slide_mm) for e in ends] == [70, 40, 70, 40, 70]
        np.testing.assert_allclose([e.cart_mm for e in ends], np.arange(5), atol=DEFAULT_CART.mm_per_step)

    def require_even_of(self, outcome: ScanOutcome, folder: Path) -> None:
        self.require_even(opened(folder), outcome.frames)

    @staticmethod
    def require_even(capture: RecordedCapture, frames: int) -> None:
        places = positions(capture)
        steps = np.diff(places)
        assert len(places) == frames
        assert places[0] < LASER.from_mm + PITCH_MM
        assert places[-1] > LASER.to_mm - PITCH_MM
        assert steps.max() < 1.05 * PITCH_MM
        assert steps.min() > 0.0


class TestContinuing:
    """A scan whose program ended in the middle, on a machine that stayed on."""

    @staticmethod
    def interrupted(folder: Path, request: ScanRequest, when: Callable[[ScanBench], Awaitable[None]]) -> ScanOutcome:
        async def play(bench: ScanBench) -> ScanOutcome:
            scan = asyncio.ensure_future(run_scan(bench.session, request))
            await when(bench)
            scan.cancel()
            await asyncio.wait({scan})
            fresh = replace(bench.session, folder=bench.session.folder.reopen(folder))
            return await continue_scan(fresh, request)

        return on_machine(folder, play)

    def test_a_laser_pass_goes_on_where_it_stopped(self, tmp_path: Path) -> None:
        self.interrupted(tmp_path / "scan", LASER_ONLY, lambda bench: bench.until_cart(40.0))
        capture = opened(tmp_path / "scan")
        assert len(capture.recordings) == 2
        TestInterruptions.require_even(capture, len(positions(capture)))

    def test_a_tof_pass_goes_on_with_its_next_row(self, tmp_path: Path) -> None:
        async def when(bench: ScanBench) -> None:
            await bench.until(lambda: bench.rows == 3)

        outcome = self.interrupted(tmp_path / "scan", BOTH, when)
        capture = opened(tmp_path / "scan")
        assert outcome.rows == 5
        assert [r.header.leg for r in capture.recordings if r.header.kind == "laser"] == [0]
        rows = [e.cart_mm for r in capture.recordings for e in r.events if e.kind == "row-end"]
        np.testing.assert_allclose(rows, np.arange(5), atol=DEFAULT_CART.mm_per_step)

    def test_it_goes_on_as_it_was_asked_for_then(self, tmp_path: Path) -> None:
        async def play(bench: ScanBench) -> ScanOutcome:
            scan = asyncio.ensure_future(run_scan(bench.session, LASER_ONLY))
            await bench.until_cart(40.0)
            scan.cancel()
            await asyncio.wait({scan})
            other = ScanRequest(replace(LASER, to_mm=30.0, speed_mm_s=10.0), None)
            return await continue_scan(bench.session, other)

        on_machine(tmp_path / "scan", play)
        TestInterruptions.require_even(opened(tmp_path / "scan"), len(positions(opened(tmp_path / "scan"))))

    def test_a_scan_that_is_complete_stays_as_it_is(self, tmp_path: Path) -> None:
        async def play(bench: ScanBench) -> ScanOutcome:
            await run_scan(bench.session, BOTH)
            return await continue_scan(bench.session, BOTH)

        outcome = on_machine(tmp_path / "scan", play)
        assert (outcome.frames, outcome.rows) == (0, 5)
        assert len(opened(tmp_path / "scan").recordings) == 2

    def test_a_machine_that_was_off_meanwhile_cannot_go_on(self, tmp_path: Path) -> None:
        async def begin(bench: ScanBench) -> None:
            scan = asyncio.ensure_future(run_scan(bench.session, LASER_ONLY))
            await bench.until_cart(40.0)
            scan.cancel()
            await asyncio.wait({scan})

        on_machine(tmp_path / "scan", begin)
        with pytest.raises(DeviceError, match="no longer knows where cart and slide are") as caught:
            on_machine(tmp_path / "scan", lambda bench: continue_scan(bench.session, LASER_ONLY), resume=True)
        assert caught.value.code == "position-lost"
        assert len(opened(tmp_path / "scan").recordings) == 1


def test_lasers_in_turns_lack_no_line_after_an_interruption(tmp_path: Path) -> None:
    request = replace(LASER, speed_mm_s=25.0, alternating=True)

    async def play(bench: ScanBench) -> ScanOutcome:
        scan = asyncio.ensure_future(run_scan(bench.session, ScanRequest(request, None)))
        await bench.until_cart(45.0)
        bench.session.control.pause()
        bench.session.control.resume()
        return await scan

    on_machine(tmp_path / "scan", play)
    capture = opened(tmp_path / "scan")
    assert capture.laser is not None
    for laser in (1, 2):
        places = sorted(f.cart_mm for f in capture.laser.frames if f.lasers == frozenset({laser}))
        # Of two frames in each turn one may fall on the switch to the next.
        assert max(b - a for a, b in pairwise(places)) < 4.1 * request.speed_mm_s / RATE_HZ


def test_a_pass_in_the_other_direction_is_recorded_as_well(tmp_path: Path) -> None:
    request = replace(LASER, from_mm=60.0, to_mm=30.0)
    on_machine(tmp_path / "scan", lambda bench: run_scan(bench.session, ScanRequest(request, None)))
    places = positions(opened(tmp_path / "scan"))
    assert places[0] == pytest.approx(60.0, abs=PITCH_MM)
    assert places[-1] == pytest.approx(30.0, abs=PITCH_MM)


class TestChecksBefore:
    """What would make a scan fail is found before it begins."""

    @pytest.mark.parametrize(
        ("request_", "match"),
        [
            (ScanRequest(replace(LASER, to_mm=995.0), None), r"needs the cart from 12.8 to 1002.2 mm with its run-up"),
            (ScanRequest(replace(LASER, speed_mm_s=120.0), None), r"moves at up to 100 mm/s, not at 120"),
            (ScanRequest(None, replace(TOF, slide_to_mm=300.0)), r"sweeps of the ToF pass reach from 40 to 300 mm"),
            (ScanRequest(None, replace(TOF, from_mm=-200.0)), r"rows of the ToF pass reach from -200 to 4 mm"),
            (ScanRequest(None, replace(TOF, speed_mm_s=60.0)), r"slide moves at up to 40 mm/s"),
        ],
    )
    def test_what_the_axes_cannot_do_is_refused(self, tmp_path: Path, request_: ScanRequest, match: str) -> None:
        error = self.refused(tmp_path, request_)
        assert error.code == "preflight-failed"
        with pytest.raises(DeviceError, match=match):
            raise error

    @pytest.mark.parametrize(
        ("spoil", "match"),
        [
            (lambda m: replace(m, description=m.description.replace("360", "480")), r"640 x 360 px, and the scanner"),
            (lambda m: replace(m, rig=replace(m.rig, camera=replace(m.rig.camera, size=(1280, 720)))), r"pictures of"),
        ],
        ids=["another description", "another rig"],
    )
    def test_what_does_not_fit_the_camera_is_refused(self, tmp_path: Path, spoil: object, match: str) -> None:
        def change(bench: ScanBench) -> ScanBench:
            session = replace(bench.session, machine=spoil(bench.session.machine))  # type: ignore[operator]
            return replace(bench, session=session)

        error = self.refused(tmp_path, LASER_ONLY, change)
        with pytest.raises(DeviceError, match=match):
            raise error

    def test_a_full_disk_is_found_out(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        import shutil

        monkeypatch.setattr(shutil, "disk_usage", lambda _path: shutil._ntuple_diskusage(10**9, 10**9, 10**5))
        with pytest.raises(DeviceError, match=r"needs about 1 MB and .* has 0 MB left; free some"):
            raise self.refused(tmp_path, LASER_ONLY)

    def test_a_machine_without_calibration_is_warned_of_and_scans(self, tmp_path: Path) -> None:
        def play(bench: ScanBench) -> Awaitable[ScanOutcome]:
            return run_scan(replace(bench.session, machine=replace(bench.session.machine, rig=None)), LASER_ONLY)

        outcome = on_machine(tmp_path / "scan", play)
        (check,) = (check for check in outcome.checks if check.name == "calibration")
        assert check.grade == "warning"
        assert "calibrate first" in check.detail

    def refused(
        self,
        tmp_path: Path,
        request: ScanRequest,
        change: Callable[[ScanBench], ScanBench] = lambda bench: bench,
    ) -> TwinlineError:
        async def play(bench: ScanBench) -> tuple[TwinlineError, bool]:
            error = await raised(asyncio.ensure_future(run_scan(change(bench).session, request)))
            return error, bench.dark

        error, dark = on_machine(tmp_path / "scan", play)
        assert dark
        assert not list((tmp_path / "scan").iterdir())
        return error


def test_a_machine_that_is_not_homed_is_told_so(tmp_path: Path) -> None:
    async def play(bench: ScanBench) -> TwinlineError:
        await bench.simulated.machine.board.open()
        return await raised(asyncio.ensure_future(run_laser_pass(bench.session, LASER)))

    assert on_machine(tmp_path / "scan", play).code == "position-lost"


async def raised(task: "asyncio.Future[Any]") -> TwinlineError:
    """The error that a task ends with."""
    try:
        await task
    except TwinlineError as error:
        return error
    pytest.fail("it was completed")
