"""What a computer needs to run the scanner, looked at piece by piece."""

import asyncio
import os
import platform
import shutil
import socket
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib import resources
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from twinline.devices.board import Board, Telemetry
from twinline.devices.camera import Camera
from twinline.devices.serial.protocol_gen import PROTOCOL_HASH, Latch
from twinline.errors import TwinlineError
from twinline.operations.passes.preflight import Check, Grade
from twinline.settings import Settings

_LEAST_PYTHON = (3, 11)
_LEAST_FREE = 5e9
_LOOK_S = 1.0
_PACKAGES = ("numpy", "numba", "scipy", "opencv-python-headless", "av", "mcap", "pyserial", "simplejpeg", "viser")


def check_computer(settings: Settings) -> Iterator[Check]:
    """Software, disk, port, serial ports and cameras of this computer."""
    yield _guarded("python", _python)
    yield _guarded("packages", _packages)
    yield _guarded("kernels", _kernels)
    yield _guarded("panel", _panel)
    yield _guarded("disk", lambda: _data_folder(settings.data_dir))
    yield _guarded("port", lambda: _port(settings.host, settings.port))
    yield _guarded("serial ports", _serial_ports)
    yield _guarded("video devices", _video_devices)


async def check_board(board: Board) -> Check:
    """Whether a board answers, with which protocol, and whether its telemetry flows."""
    try:
        info = await board.open()
        status = await board.status()
        messages = board.subscribe()
        await board.telemetry(50)
        lines = 0
        try:
            async with asyncio.timeout(_LOOK_S):
                async for message in messages:
                    lines += isinstance(message, Telemetry)
        except TimeoutError:
            pass
    except TwinlineError as error:
        return Check("board", Grade.FAILED, error.detail)
    finally:
        await board.close()
    name = f"{info.name}, firmware {info.firmware}, protocol {info.protocol_hash or 'none'} (this one: {PROTOCOL_HASH})"
    if status.latch is not Latch.NONE:
        return Check(
            "board",
            Grade.WARNING,
            f"{name}; latched ({status.latch.name.lower().replace('_', ' ')}): reset it before scanning.",
        )
    if not lines:
        return Check("board", Grade.WARNING, f"{name}; no telemetry came in {_LOOK_S:g} s: check its firmware.")
    return Check("board", Grade.GOOD, f"{name}; {lines} lines of telemetry in {_LOOK_S:g} s.")


async def check_camera(camera: Camera) -> Check:
    """Whether a camera delivers frames, how many, and what can be set on it."""
    try:
        info = await camera.open()
        began = asyncio.get_running_loop().time()
        frames, size, took = 0, 0, 0.0
        async with asyncio.timeout(5.0 + _LOOK_S):
            async for frame in camera.frames():
                frames, size = frames + 1, size + len(frame.data)
                took = asyncio.get_running_loop().time() - began
                if took >= _LOOK_S:
                    break
        controls = ", ".join(sorted(await camera.controls())) or "none"
    except TimeoutError:
        detail = camera.status().detail or "It is open and sends no frames; check its settings."
        return Check("camera", Grade.FAILED, detail)
    except TwinlineError as error:
        return Check("camera", Grade.FAILED, error.detail)
    finally:
        await camera.close()
    if not frames:
        return Check("camera", Grade.FAILED, "It has no frames.")
    width, height = info.image_size
    dropped = camera.status().dropped
    text = (
        f"{info.name or 'camera'}: {width} x {height} px {info.encoding}, {frames / max(took, 1e-3):.1f} frames/s, "
        f"{size / frames / 1000:.0f} kB each; controls: {controls}"
    )
    if dropped:
        return Check("camera", Grade.WARNING, f"{text}; {dropped} frames were lost: lower its rate or size.")
    return Check("camera", Grade.GOOD, f"{text}.")


def _guarded(name: str, look: Callable[[], Check]) -> Check:
    """A look that fails is itself a finding."""
    try:
        return look()
    except (OSError, ImportError, TwinlineError) as error:
        return Check(name, Grade.FAILED, f"It cannot be looked at: {error}.")


def _python() -> Check:
    here = f"Python {platform.python_version()} on {platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    if sys.version_info < _LEAST_PYTHON:
        return Check("python", Grade.FAILED, f"{here}; 3.11 or newer is needed.")
    return Check("python", Grade.GOOD, f"{here}.")


def _packages() -> Check:
    found, missing = [], []
    for name in _PACKAGES:
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            missing.append(name)
    if missing:
        return Check("packages", Grade.FAILED, f"{', '.join(missing)} missing; install Twinline again.")
    return Check("packages", Grade.GOOD, f"{', '.join(found)}.")


def _kernels() -> Check:
    """Extract one drawn stripe: shows that compiled code runs, and whether it is kept."""
    from twinline.stripe import extract

    rows = np.arange(64)[:, None]
    picture = np.repeat(20 + 150 * np.exp(-0.5 * ((rows - 31.3) / 2.0) ** 2), 96, axis=1).astype(np.uint8)
    began = time.perf_counter()
    centre = float(np.nanmedian(extract(picture).centre_px))
    took = time.perf_counter() - began
    if not abs(centre - 31.3) < 0.05:
        return Check("kernels", Grade.FAILED, f"A stripe at 31.30 px was found at {centre:.2f}; install numba again.")
    slow = "; compiled just now" if took > 5.0 else ""
    return Check("kernels", Grade.GOOD, f"A stripe at 31.30 px was found at {centre:.2f} in {took:.1f} s{slow}.")


def _panel() -> Check:
    if (resources.files("twinline.api") / "panel" / "index.html").is_file():
        return Check("panel", Grade.GOOD, "Built.")
    return Check(
        "panel", Grade.WARNING, "Not built, so the browser shows nothing; run ./dev run, or install a release."
    )


def _data_folder(folder: Path) -> Check:
    place = next(p for p in (folder, *folder.parents) if p.exists())
    with tempfile.TemporaryFile(dir=place):
        pass
    free = shutil.disk_usage(place).free
    if free < _LEAST_FREE:
        return Check("disk", Grade.WARNING, f"{free / 1e9:.1f} GB free in {place}; a scan takes one or two.")
    return Check("disk", Grade.GOOD, f"{folder} can be written, {free / 1e9:.0f} GB free.")


def _port(host: str, port: int) -> Check:
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            return Check("port", Grade.WARNING, f"{host}:{port} is taken ({error.strerror}); another server may run.")
    return Check("port", Grade.GOOD, f"{host}:{port} is free.")


def _serial_ports() -> Check:
    from serial.tools import list_ports

    ports = sorted(list_ports.comports(), key=lambda p: p.device)
    if not ports:
        return Check("serial ports", Grade.WARNING, "None found: connect the board, or use the simulated machine.")
    closed = [p.device for p in ports if Path(p.device).exists() and not os.access(p.device, os.R_OK | os.W_OK)]
    names = ", ".join(f"{p.device} ({p.description})" for p in ports)
    if closed:
        return Check(
            "serial ports", Grade.WARNING, f"{', '.join(closed)} may not be opened by this user; add it to the group "
            "dialout and log in again."
        )  # fmt: skip
    return Check("serial ports", Grade.GOOD, f"{names}.")


def _video_devices() -> Check:
    devices = sorted(Path("/dev").glob("video*")) if sys.platform == "linux" else []
    if sys.platform != "linux":
        return Check("video devices", Grade.GOOD, "Not listed on this system; try uvc:0.")
    if not devices:
        return Check("video devices", Grade.WARNING, "None found: connect a camera, or use rtsp:// or http://.")
    closed = [str(d) for d in devices if not os.access(d, os.R_OK | os.W_OK)]
    if closed:
        return Check(
            "video devices", Grade.WARNING, f"{', '.join(closed)} may not be opened by this user; add it to the group "
            "video and log in again."
        )  # fmt: skip
    return Check("video devices", Grade.GOOD, f"{', '.join(map(str, devices))}.")
