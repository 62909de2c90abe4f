"""Faults in the middle of a scan on the simulated machine: what happens, and what the user reads."""

import asyncio
import errno
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from unittest import mock

import numpy as np

from tests.integration.scan_bench import LASER, TOF, ScanBench, on_machine
from twinline.devices.serial.link import SILENCE_S
from twinline.devices.serial.protocol_gen import HEARTBEAT_DEFAULT_MS
from twinline.devices.simulator.camera import CameraFaults
from twinline.devices.simulator.faults import Faults
from twinline.devices.simulator.tof import TofFaults
from twinline.errors import CaptureError, TwinlineError
from twinline.operations.passes.requests import ScanRequest
from twinline.operations.passes.scan import ScanOutcome, run_scan
from twinline.recording import container_file
from twinline.recording.capture import open_capture
from twinline.recording.pass_reader import open_recording
from twinline.recording.recorded_capture import RecordedCapture

BEFORE, LASER_PASS, TOF_PASS = "before the scan", "laser pass", "ToF pass"
FAULT_AT_MM = 40.0
FAULT_ROW = 2
MOST_DARK_MS = max(HEARTBEAT_DEFAULT_MS, 1000.0 * SILENCE_S) + 50
"""The heartbeat that came last before a fault may have come with it; and so may the board's last word."""

Inject = Callable[[ScanBench], None]


@dataclass(frozen=True)
class Fault:
    """A fault, when it comes, and what is expected of the scan.

    Attributes
    ----------
    name, during
        For the table.
    inject
        Brings it about.
    code
        Code of the error that the scan ends with; empty where it is completed.
    legs
        Recordings of the pass in the end.
    noticed
        Whether a scan that is completed tells of it.
    harmless
        Whether nothing is worse for it.
    """

    name: str
    during: str
    inject: Inject
    code: str = ""
    legs: int = 1
    noticed: bool = False
    harmless: bool = False


@dataclass(frozen=True)
class Outcome:
    """How a scan with a fault ended.

    Attributes
    ----------
    code, reads
        The error's code and sentence; or the warnings, where it was completed.
    dark_after_ms
        Time from the fault until no laser shone, rounded up to 10 ms; None where none shone when it came, where the
        scan was completed in one go, and where it depends on the disk, which lives in another time than the machine.
    dark, still
        Whether in the end no laser shines and nothing moves.
    legs
        Recordings of the pass.
    gap_frames
        Largest distance of neighbouring frames of a completed laser pass, in lines of an undisturbed one.
    overlap_frames
        How far a leg began before the end of the one before it, in the same unit.
    rows
        Rows of a completed ToF pass.
    readable
        Whether all that was recorded opens again.
    """

    code: str
    reads: str
    dark_after_ms: int | None
    dark: bool
    still: bool
    legs: int
    gap_frames: float
    overlap_frames: float
    rows: int
    readable: bool


def board(**changes: object) -> Inject:
    """A lasting fault of the board or its cable."""

    def inject(bench: ScanBench) -> None:
        machine = bench.simulated.board
        machine.faults = replace(machine.faults, **changes)  # type: ignore[arg-type]

    return inject


def camera(**changes: object) -> Inject:
    """A lasting fault of the camera."""

    def inject(bench: ScanBench) -> None:
        bench.simulated.camera.faults = replace(bench.simulated.camera.faults, **changes)  # type: ignore[arg-type]

    return inject


def sensor(**changes: object) -> Inject:
    """A lasting fault of the ToF sensor."""

    def inject(bench: ScanBench) -> None:
        reader = bench.simulated.adc.reader
        reader.faults = replace(reader.faults, **changes)  # type: ignore[arg-type]

    return inject


def for_a_while(inject: Inject, seconds: float) -> Inject:
    """A fault that goes away again."""

    def begin(bench: ScanBench) -> None:
        inject(bench)
        asyncio.get_running_loop().call_later(seconds, mend, bench)

    return begin


def mend(bench: ScanBench) -> None:
    """Let all faults go."""
    bench.simulated.board.faults = Faults()
    bench.simulated.camera.faults = CameraFaults()
    bench.simulated.adc.reader.faults = TofFaults()


def fill_disk(_bench: ScanBench) -> None:
    """Let no file take another byte; `outcome` takes that back."""

    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    container_file._Sink.write = full  # type: ignore[method-assign,assignment]


def restart(bench: ScanBench) -> None:
    """Let the board start again."""
    bench.simulated.board.reset()


FAULTS = (
    Fault("board's cable out", BEFORE, board(unplugged=True), "disconnected", 0),
    Fault("camera's cable out", BEFORE, camera(gone=True), "camera-disconnected", 0),
    Fault("emergency stop pressed", BEFORE, board(e_stop=True), "latched", 0),
    Fault("low limit switch never closes", BEFORE, board(low_switch=False), "home-failed", 0),
    Fault("laser 1 dead", BEFORE, board(dead_lasers=frozenset({1})), "preflight-failed", 0),
    Fault("laser 2 gives a twentieth of its light", BEFORE, camera(laser_power={2: 0.05}), "preflight-failed", 0),
    Fault("ToF sensor's wire off", BEFORE, sensor(unplugged=True), "preflight-failed", 0),
    Fault(
        "1 byte in 200 corrupted, both ways",
        LASER_PASS,
        board(corrupt_to_board=0.005, corrupt_to_host=0.005),
        harmless=True,
    ),
    Fault("1 byte in 200 lost, both ways", LASER_PASS, board(lose_to_board=0.005, lose_to_host=0.005), harmless=True),
    Fault("cable pulled for 5 s", LASER_PASS, for_a_while(board(unplugged=True), 5.0), legs=2),
    Fault("cable pulled for good", LASER_PASS, board(unplugged=True), "disconnected"),
    Fault("nothing reaches the board for 0.7 s", LASER_PASS, for_a_while(board(lose_to_board=1.0), 0.7), legs=2),
    Fault("nothing comes from the board for 5 s", LASER_PASS, for_a_while(board(lose_to_host=1.0), 5.0), legs=2),
    Fault("nothing comes from the board any more", LASER_PASS, board(lose_to_host=1.0), "device-timeout"),
    Fault("board restarts", LASER_PASS, restart, "board-restarted"),
    Fault("emergency stop pressed", LASER_PASS, board(e_stop=True), "e-stop"),
    Fault("every 5th frame 0.15 s late", LASER_PASS, camera(late_share=0.2, late_s=0.15), harmless=True),
    Fault("every 10th frame lost", LASER_PASS, camera(lost_share=0.1), noticed=True),
    Fault("no frame arrives for 1 s", LASER_PASS, for_a_while(camera(lost_share=1.0), 1.0), legs=2, noticed=True),
    Fault("camera's cable out for 5 s", LASER_PASS, for_a_while(camera(gone=True), 5.0), legs=2),
    Fault("camera's cable out for good", LASER_PASS, camera(gone=True), "camera-lost"),
    Fault("laser 1 dies", LASER_PASS, board(dead_lasers=frozenset({1})), noticed=True),
    Fault("laser 2 falls to a twentieth of its light", LASER_PASS, camera(laser_power={2: 0.05}), noticed=True),
    Fault("cart's motor stalls", LASER_PASS, board(stalled=frozenset({"cart"})), noticed=True),
    Fault("disk full", LASER_PASS, fill_disk, "cannot-write"),
    Fault(
        "1 byte in 200 corrupted, both ways",
        TOF_PASS,
        board(corrupt_to_board=0.005, corrupt_to_host=0.005),
        harmless=True,
    ),
    Fault("cable pulled for 5 s", TOF_PASS, for_a_while(board(unplugged=True), 5.0), legs=2),
    Fault("cable pulled for good", TOF_PASS, board(unplugged=True), "disconnected"),
    Fault("board restarts", TOF_PASS, restart, "board-restarted"),
    Fault("emergency stop pressed", TOF_PASS, board(e_stop=True), "e-stop"),
    Fault("low limit switch stays pressed", TOF_PASS, board(low_switch=True), "limit"),
    Fault("both limit switches pressed", TOF_PASS, board(low_switch=True, high_switch=True), "wiring"),
    Fault("slide's motor stalls", TOF_PASS, board(stalled=frozenset({"slide"})), noticed=True),
    Fault(
        "slide's motor stalls for 0.3 s", TOF_PASS, for_a_while(board(stalled=frozenset({"slide"})), 0.3), noticed=True
    ),
    Fault("ToF sensor sees nothing for a third of the time", TOF_PASS, sensor(dropout_share=0.33), noticed=True),
    Fault("ToF sensor saturated", TOF_PASS, sensor(saturated=True), noticed=True),
    Fault("ToF sensor's wire off", TOF_PASS, sensor(unplugged=True), noticed=True),
    Fault("disk full", TOF_PASS, fill_disk, "cannot-write"),
)


def outcome(fault: Fault, folder: Path) -> Outcome:
    """Let a fault happen, in virtual time.

    Raises
    ------
    TimeoutError
        Something hangs.
    """
    with mock.patch.object(container_file._Sink, "write", container_file._Sink.write):
        return on_machine(folder, lambda bench: _happen(fault, bench))


async def _happen(fault: Fault, bench: ScanBench) -> Outcome:
    loop, machine = asyncio.get_running_loop(), bench.simulated.board
    request = ScanRequest(None if fault.during == TOF_PASS else LASER, None if fault.during == LASER_PASS else TOF)
    dark: asyncio.Task[int | None] = loop.create_task(_inject(fault, bench))
    scan = loop.create_task(run_scan(bench.session, request))
    error: TwinlineError | None = None
    done: ScanOutcome | None = None
    try:
        done = await scan
    except TwinlineError as caught:
        error = caught
    dark_after_ms = await dark
    # A board that nobody can reach switches off by itself.
    await asyncio.sleep(1.0)
    capture = _capture(bench.session.folder.path)
    legs = list(bench.session.folder.path.iterdir())
    gap, overlap = _gaps(capture)
    return Outcome(
        code=error.code if error else "",
        reads=_plain(error.detail if error else " ".join(done.warnings if done else ()), bench.session.folder.path),
        dark_after_ms=None if fault.inject is fill_disk or (done is not None and len(legs) == 1) else dark_after_ms,
        dark=bench.dark,
        still=not machine.moving,
        legs=len(legs),
        gap_frames=gap,
        overlap_frames=overlap,
        rows=done.rows if done else 0,
        readable=_readable(bench.session.folder.path),
    )


async def _inject(fault: Fault, bench: ScanBench) -> int | None:
    loop, machine = asyncio.get_running_loop(), bench.simulated.board
    if fault.during == LASER_PASS:
        await bench.until_cart(FAULT_AT_MM)
    elif fault.during == TOF_PASS:
        await bench.until(lambda: bench.rows == FAULT_ROW)
        await asyncio.sleep(0.4)
    begin_s = loop.time()
    shone = bool(machine.lasers(begin_s))
    fault.inject(bench)
    if not shone:
        return None
    await bench.until(lambda: bench.dark)
    passed_ms = (loop.time() - begin_s) * 1000.0
    return -int(-passed_ms // 10) * 10


def _capture(folder: Path) -> RecordedCapture | None:
    try:
        capture = open_capture(folder)
    except CaptureError:
        return None
    assert isinstance(capture, RecordedCapture)
    return capture


def _readable(folder: Path) -> bool:
    for file in folder.iterdir():
        open_recording(file)
    return True


def _gaps(capture: RecordedCapture | None) -> tuple[float, float]:
    """Largest gap and largest overlap of a laser pass's frames, in lines."""
    if capture is None or capture.laser is None:
        return 0.0, 0.0
    steps = np.diff([frame.cart_mm for frame in capture.laser.frames]) / (LASER.speed_mm_s / 25.0)
    return round(float(steps.max()), 2), round(float(max(-steps.min(), 0.0)), 2)


def _plain(text: str, folder: Path) -> str:
    return text.replace(str(folder), "scan")
