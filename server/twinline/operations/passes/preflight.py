"""What is looked at before a scan begins, so that nobody finds out after ten minutes what could be known before."""

import asyncio
import shutil
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from math import ceil
from pathlib import Path

import cv2
import numpy as np

from twinline.arrays import ByteArray
from twinline.devices.board import BoardInfo, BoardStatus, Drive, Telemetry
from twinline.devices.camera import CameraFrame, CameraInfo
from twinline.devices.serial.protocol_gen import Flag, Latch
from twinline.errors import CameraError, DeviceError, RigError, TwinlineError
from twinline.geometry.optics import check_stripes_separable
from twinline.operations.passes.forecast import Forecast, run_up_mm
from twinline.operations.passes.machine import Machine
from twinline.operations.passes.requests import LaserPassRequest, TofPassRequest

_LOOK_S = 1.0
_LASER_SETTLE_S = 0.2
_LIT_DN = 20
_FEWEST_LIT_SHARE = 0.05
_SATURATED_DN = 250
_MOST_SATURATED_SHARE = 0.5
_SPARE = 1.2


class Grade(StrEnum):
    """How a check came out."""

    GOOD = "good"
    WARNING = "warning"
    """The scan is possible, and will be worse than it could be."""
    FAILED = "failed"
    """The scan would fail."""


@dataclass(frozen=True)
class Check:
    """One thing that was looked at.

    Attributes
    ----------
    name
        What.
    grade
        How it came out.
    detail
        One sentence: what was found, and the next step where something is wrong.
    """

    name: str
    grade: Grade
    detail: str


async def preflight(
    machine: Machine,
    laser: LaserPassRequest | None,
    tof: TofPassRequest | None,
    forecasts: Sequence[Forecast],
    folder: Path,
) -> tuple[Check, ...]:
    """Check a machine whose board and camera are open. Lights the lasers for a moment each.

    Parameters
    ----------
    forecasts
        Of the passes, for their size.
    folder
        Where the recording will lie.
    """
    checks: list[Check] = []
    try:
        info, status = await machine.board.open(), await machine.board.status()
    except DeviceError as error:
        return (Check("board", Grade.FAILED, error.detail),)
    checks += _board(info, status, needs_slide=tof is not None)
    if laser is not None:
        checks.append(_range(info.drives["cart"], laser))
        # A recording has no frames but those of its passes.
        if machine.replayed is None:
            checks += await _camera(machine, laser)
    if tof is not None:
        checks.append(_raster(info, tof))
        if machine.replayed is None:
            checks.append(await _sensor(machine))
    checks.append(_disk(folder, sum(forecast.bytes for forecast in forecasts)))
    return tuple(checks)


def _board(info: BoardInfo, status: BoardStatus, *, needs_slide: bool) -> list[Check]:
    name = f"{info.name}, firmware {info.firmware}"
    if status.latch is not Latch.NONE:
        why = status.latch.name.lower().replace("_", " ")
        return [Check("board", Grade.FAILED, f"{name}, is latched ({why}); remove the cause and reset it.")]
    known = Flag.CART_KNOWN | Flag.SLIDE_KNOWN if needs_slide else Flag.CART_KNOWN
    if known not in status.flags:
        return [Check("board", Grade.FAILED, f"{name}, does not know where its axes are; home the machine.")]
    return [Check("board", Grade.GOOD, f"{name}; the cart stands at {status.cart_mm:.1f} mm.")]


def _range(drive: Drive, laser: LaserPassRequest) -> Check:
    reach = run_up_mm(laser.speed_mm_s, drive)
    low, high = min(laser.from_mm, laser.to_mm) - reach, max(laser.from_mm, laser.to_mm) + reach
    if low < drive.low_mm or high > drive.high_mm:
        return Check(
            "travel",
            Grade.FAILED,
            f"The laser pass needs the cart from {low:.1f} to {high:.1f} mm with its run-up, and the cart may go from "
            f"{drive.low_mm:g} to {drive.high_mm:g} mm; shorten the area.",
        )
    if laser.speed_mm_s > drive.max_speed_mm_s:
        return Check(
            "travel",
            Grade.FAILED,
            f"The cart moves at up to {drive.max_speed_mm_s:g} mm/s, not at {laser.speed_mm_s:g}; choose less.",
        )
    return Check("travel", Grade.GOOD, f"The cart will go from {low:.1f} to {high:.1f} mm.")


def _raster(info: BoardInfo, tof: TofPassRequest) -> Check:
    for axis, ends, what in (
        ("cart", (tof.from_mm, tof.to_mm), "rows"),
        ("slide", (tof.slide_from_mm, tof.slide_to_mm), "sweeps"),
    ):
        drive = info.drives[axis]  # type: ignore[index]
        if min(ends) < drive.low_mm or max(ends) > drive.high_mm:
            return Check(
                "ToF area",
                Grade.FAILED,
                f"The {what} of the ToF pass reach from {min(ends):g} to {max(ends):g} mm, and the {axis} may go from "
                f"{drive.low_mm:g} to {drive.high_mm:g} mm; shorten the area.",
            )
    slide = info.drives["slide"]
    if tof.speed_mm_s > slide.max_speed_mm_s:
        return Check(
            "ToF area", Grade.FAILED, f"The slide moves at up to {slide.max_speed_mm_s:g} mm/s; choose a lower speed."
        )
    rows = len(tof.row_places_mm(info.drives["cart"]))
    return Check("ToF area", Grade.GOOD, f"{rows} rows of {tof.width_mm:g} mm.")


async def _camera(machine: Machine, laser: LaserPassRequest) -> list[Check]:
    try:
        camera = await machine.camera.open()
        checks = [await _rate(machine, camera), _rig(machine, camera, laser)]
    except TwinlineError as error:
        return [Check("camera", Grade.FAILED, error.detail)]
    if any(check.grade is Grade.FAILED for check in checks):
        return checks
    try:
        return checks + await _lasers(machine)
    except TwinlineError as error:
        return [*checks, Check("lasers", Grade.FAILED, error.detail)]


async def _rate(machine: Machine, camera: CameraInfo) -> Check:
    width, height = camera.image_size
    expected = machine.info().image_size
    if camera.image_size != expected:
        return Check(
            "camera",
            Grade.FAILED,
            f"The camera sends {width} x {height} px, and the scanner is described with {expected[0]} x {expected[1]} "
            "px; choose the same setting for both.",
        )
    before, count = machine.camera.status().dropped, 0
    with suppress(TimeoutError):
        async with asyncio.timeout(_LOOK_S):
            async for _ in machine.camera.frames():
                count += 1
    lost = machine.camera.status().dropped - before
    if not count:
        detail = machine.camera.status().detail or "It is open and sends no frames; check its cable and settings."
        return Check("camera", Grade.FAILED, detail)
    if lost:
        return Check(
            "camera", Grade.WARNING, f"{lost} of {count + lost} frames were lost in {_LOOK_S:g} s; lower its rate."
        )
    return Check("camera", Grade.GOOD, f"{width} x {height} px, {count / _LOOK_S:.0f} frames in a second, none lost.")


def _rig(machine: Machine, camera: CameraInfo, laser: LaserPassRequest) -> Check:
    rig = machine.rig
    if rig is None:
        return Check("calibration", Grade.WARNING, "There is none: expect errors of millimetres; calibrate first.")
    if rig.camera.size != camera.image_size:
        return Check(
            "calibration", Grade.FAILED, f"Rig {rig.name!r} is for pictures of {rig.camera.size[0]} x "
            f"{rig.camera.size[1]} px; use the one made with this camera setting."
        )  # fmt: skip
    if len(rig.sheets) == 2 and not laser.alternating:
        try:
            check_stripes_separable(rig).require()
        except RigError as error:
            return Check("calibration", Grade.FAILED, error.detail)
    if rig.sources and all(source == "nominal" for source in rig.sources.values()):
        return Check("calibration", Grade.WARNING, f"Rig {rig.name!r} is nominal: expect errors of millimetres.")
    return Check("calibration", Grade.GOOD, f"Rig {rig.name!r}.")


async def _lasers(machine: Machine) -> list[Check]:
    board = machine.board
    try:
        await board.lasers(frozenset())
        dark = _grey(await _next_frame(machine))
        checks = []
        for laser in sorted((await board.open()).lasers):
            await board.lasers(frozenset({laser}))
            checks.append(_light(laser, dark, _grey(await _next_frame(machine))))
        return checks
    finally:
        await board.lasers(frozenset())


async def _next_frame(machine: Machine) -> CameraFrame:
    """A frame from after the lasers have settled."""
    settled = asyncio.get_running_loop().time() + _LASER_SETTLE_S
    with suppress(TimeoutError):
        async with asyncio.timeout(3.0 + _LASER_SETTLE_S):
            async for frame in machine.camera.frames():
                if frame.host_time_s - 0.5 * (frame.exposure_s or 0.0) >= settled:
                    return frame
    raise CameraError("The camera stopped while the lasers were being checked; check its cable.")


def _grey(frame: CameraFrame) -> ByteArray:
    """Red for colour, since the lasers are; else grey."""
    if frame.encoding == "jpeg":
        image = cv2.imdecode(np.frombuffer(frame.data, np.uint8), cv2.IMREAD_UNCHANGED)
        if image is None:
            raise CameraError("The camera sent a frame that cannot be decoded; check its cable and settings.")
    else:
        width, height = frame.image_size
        image = np.frombuffer(frame.data, np.uint8).reshape(height, width, -1)
    return np.asarray(image.max(axis=2) if image.ndim == 3 else image, np.uint8)


def _light(laser: int, dark: ByteArray, lit: ByteArray) -> Check:
    name = f"laser {laser}"
    gain = cv2.subtract(lit, dark)
    # Stripes run along rows or columns; whichever shows more of them counts.
    share = max(float(np.mean(gain.max(axis=axis) >= _LIT_DN)) for axis in (0, 1))
    if share < _FEWEST_LIT_SHARE:
        return Check(name, Grade.FAILED, "Its light is not in the picture; check its power, its aim and the exposure.")
    saturated = float(np.mean(lit[gain >= _LIT_DN] >= _SATURATED_DN))
    if saturated > _MOST_SATURATED_SHARE:
        return Check(
            name, Grade.WARNING, f"{saturated:.0%} of its light is saturated; shorten the exposure or lower the gain."
        )
    return Check(name, Grade.GOOD, f"Seen across {share:.0%} of the picture, {saturated:.0%} of it saturated.")


async def _sensor(machine: Machine) -> Check:
    board = machine.board
    messages = board.subscribe()
    with suppress(TimeoutError):
        async with asyncio.timeout(_LOOK_S):
            await board.telemetry(20)
            async for message in messages:
                if isinstance(message, Telemetry):
                    return _reading(message)
    return Check("ToF sensor", Grade.FAILED, "The board sends no readings; check its firmware.")


def _reading(sample: Telemetry) -> Check:
    if Flag.ADC_BROKEN in sample.flags:
        return Check("ToF sensor", Grade.FAILED, "Its wire is broken or off; check plug and power.")
    if Flag.ADC_CLIPPED in sample.flags:
        return Check("ToF sensor", Grade.WARNING, "It sees nothing within its range here; check its height.")
    return Check("ToF sensor", Grade.GOOD, "It sees the surface.")


def _disk(folder: Path, needed: int) -> Check:
    place = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    free = shutil.disk_usage(place).free
    if free < _SPARE * needed:
        return Check(
            "disk",
            Grade.FAILED,
            f"The recording needs about {ceil(needed / 1e6)} MB and {place} has {free / 1e6:.0f} MB left; free some.",
        )
    return Check("disk", Grade.GOOD, f"{free / 1e9:.1f} GB free, about {needed / 1e9:.2f} GB needed.")
