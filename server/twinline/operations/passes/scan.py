"""A whole scan: from a machine that is switched on to recordings of its passes."""

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from twinline.devices.board import DEFAULT_CART, DEFAULT_SLIDE
from twinline.devices.serial.protocol_gen import Flag
from twinline.errors import DeviceError, TwinlineError
from twinline.operations.passes.forecast import Forecast, laser_forecast, tof_forecast
from twinline.operations.passes.laser import UNKNOWN_RATE_HZ, run_laser_pass
from twinline.operations.passes.machine import Machine
from twinline.operations.passes.preflight import Check, Grade, preflight
from twinline.operations.passes.requests import ScanRequest
from twinline.operations.passes.session import TELEMETRY_HZ, TOF_SAMPLES, ScanSession
from twinline.operations.passes.tof import TofTally, run_tof_pass

_BLIND_SHARE = 0.1
_MOST_DRIFT_MM = 0.1


@dataclass(frozen=True)
class ScanOutcome:
    """What was recorded.

    Attributes
    ----------
    frames, rows
        Of the laser pass and of the ToF pass.
    dropped
        Frames that the camera lost meanwhile.
    warnings
        What makes the recording worse than it could be, a sentence each.
    checks
        What was looked at before.
    forecasts
        What was expected of each pass.
    """

    frames: int
    rows: int
    dropped: int
    warnings: tuple[str, ...]
    checks: tuple[Check, ...]
    forecasts: tuple[Forecast, ...]


async def run_scan(session: ScanSession, request: ScanRequest) -> ScanOutcome:
    """Open the machine, home what has no position, check it, record the passes, and close it.

    Raises
    ------
    DeviceError
        A check failed, or a device during a pass; the lasers are off and what was recorded is kept.
    OutputError
        The recording cannot be written.
    CancelledError
        It was cancelled.
    """
    machine = session.machine
    try:
        session.report("connecting", 0, 0)
        camera = await machine.camera.open() if request.laser else None
        await machine.board.open()
        await _home(session, needs_slide=request.tof is not None)
        rate = (camera and camera.rate_hz) or UNKNOWN_RATE_HZ
        forecasts = await forecast(machine, request, rate)
        session.report("checks", 0, 0)
        checks = await preflight(machine, request.laser, request.tof, forecasts, session.folder.path)
        failed = [check for check in checks if check.grade is Grade.FAILED]
        if failed:
            found = "; ".join(f"{check.name}: {check.detail.rstrip('.')}" for check in failed)
            raise DeviceError(f"The scan did not begin: {found}.", code="preflight-failed")
        return await _passes(session, request, checks, forecasts)
    finally:
        await _shut(machine)


async def continue_scan(session: ScanSession, request: ScanRequest) -> ScanOutcome:
    """Go on with a scan that was interrupted, where it stopped; as `run_scan` otherwise.

    The machine must still know where it is: positions count from the same origin.

    Parameters
    ----------
    request
        For passes that were not begun; one that was goes on as it was asked for then.
    """
    machine = session.machine
    try:
        session.report("connecting", 0, 0)
        laser = await session.aside(session.folder.laser_pass_left)
        tof = await session.aside(session.folder.tof_pass_left)
        request = ScanRequest(laser[0] if laser else request.laser, tof[0] if tof else request.tof)
        if request.laser:
            await machine.camera.open()
        await machine.board.open()
        return await _passes(session, request, (), ())
    finally:
        await _shut(machine)


async def forecast(machine: Machine, request: ScanRequest, rate_hz: float) -> tuple[Forecast, ...]:
    """What each pass will be like, from where the machine stands now."""
    status = await machine.board.status()
    drives = (await machine.board.open()).drives
    cart, slide = drives.get("cart", DEFAULT_CART), drives.get("slide", DEFAULT_SLIDE)
    depth = float(machine.rig.bed_from_camera.translation_mm[2]) if machine.rig else None
    found = []
    if request.laser:
        found.append(
            laser_forecast(request.laser, cart, machine.info(), rate_hz=rate_hz, at_mm=status.cart_mm, depth_mm=depth)
        )
    if request.tof:
        at = request.laser.to_mm if request.laser else status.cart_mm
        found.append(
            tof_forecast(request.tof, cart, slide, samples_hz=TELEMETRY_HZ * TOF_SAMPLES, at_mm=(at, status.slide_mm))
        )
    return tuple(found)


async def _home(session: ScanSession, *, needs_slide: bool) -> None:
    status = await session.unlatched_board()
    if Flag.CART_KNOWN not in status.flags:
        session.report("homing", 0, 0)
        await session.machine.board.home("cart")
    if needs_slide and Flag.SLIDE_KNOWN not in status.flags:
        session.report("homing", 0, 0)
        await session.machine.board.home("slide")


async def _passes(
    session: ScanSession, request: ScanRequest, checks: tuple[Check, ...], forecasts: tuple[Forecast, ...]
) -> ScanOutcome:
    frames = dropped = rows = 0
    warnings: list[str] = []
    if request.laser is not None:
        left = await session.aside(session.folder.laser_pass_left)
        before = session.machine.camera.status().dropped
        seen = await run_laser_pass(session, request.laser, reached_mm=left[1] if left else None)
        frames = seen.frames
        warnings += seen.warnings
        dropped = session.machine.camera.status().dropped - before
        if dropped:
            warnings.append(f"{dropped} frames were lost on their way, so lines are missing; lower rate or size.")
    if request.tof is not None:
        begun = await session.aside(session.folder.tof_pass_left)
        tally = await run_tof_pass(session, request.tof, rows_done=begun[1] if begun else 0)
        rows = tally.rows
        warnings += _tof_warnings(tally)
    return ScanOutcome(frames, rows, dropped, tuple(warnings), checks, forecasts)


def _tof_warnings(tally: TofTally) -> list[str]:
    found = []
    if tally.broken:
        found.append(
            f"The ToF sensor's wire was broken or off in {tally.broken / tally.lines:.0%} of its pass; check plug and "
            "power, and repeat it."
        )
    if tally.blind > _BLIND_SHARE * tally.lines:
        found.append(
            f"The ToF sensor saw nothing within its range in {tally.blind / tally.lines:.0%} of its pass; check its "
            "height, and for glossy or dark surfaces."
        )
    if tally.homing:
        found.append(
            f"The slide could not be homed after the ToF pass, so it may have lost steps and the readings may lie "
            f"elsewhere: {tally.homing}"
        )
    if abs(tally.drift_mm) > _MOST_DRIFT_MM:
        found.append(
            f"The slide's limit switch closed {abs(tally.drift_mm):.1f} mm from where it had before: steps were lost; "
            "check motor and load, home the slide, and repeat the ToF pass."
        )
    return found


async def _shut(machine: Machine) -> None:
    """Lasers off and everything let go, whatever happened before."""
    await machine.board.close()
    with suppress(TwinlineError):
        await machine.camera.close()


def recording_folder(output: Path) -> Path:
    """Where the recording of a scan lies beside its result, unless it is told otherwise."""
    return output.with_name(f"{output.stem}.scan")
