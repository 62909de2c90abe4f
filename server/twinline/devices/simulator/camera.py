"""The simulated camera: pictures of the workspace at the camera's own rate, with its controls and its faults."""

import asyncio
import weakref
from collections.abc import AsyncIterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from types import MappingProxyType

import cv2
import numpy as np

from twinline.devices.camera import (
    CameraFrame,
    CameraInfo,
    CameraState,
    CameraStatus,
    Control,
    Encoding,
)
from twinline.devices.cameras.frame_queue import FrameQueue
from twinline.devices.simulator.machine_state import MachineState
from twinline.devices.simulator.sensor import Exposure
from twinline.devices.simulator.workspace import Workspace
from twinline.devices.virtual_time import hold
from twinline.errors import CameraError, ControlError, SettingsError, TransitionError

BASE_EXPOSURE_MS = 8.0
"""Exposure for which the brightness of lasers and room is stated."""
_READOUT_S = 0.012
_CAPACITY = 16
_BEHIND_S = 0.5
_LOOK_AGAIN_S = 0.1
_NAME = "simulated camera"


@dataclass(frozen=True)
class CameraFaults:
    """What is wrong with the camera, and with the lasers that it sees.

    Attributes
    ----------
    lost_share
        Share of the frames that never arrive.
    late_share, late_s
        Share of the frames that are held up on their way, and for how long; those behind them wait too.
    gone
        The cable is out.
    laser_power
        Share of its light that a laser gives, by its number: 0.2 is dim, 0 is dead; 1 for those not named.
    """

    lost_share: float = 0.0
    late_share: float = 0.0
    late_s: float = 0.2
    gone: bool = False
    laser_power: Mapping[int, float] = field(default_factory=lambda: MappingProxyType({}))

    def __post_init__(self) -> None:
        shares = (self.lost_share, self.late_share)
        powers = self.laser_power.values()
        if not (all(0 <= s <= 1 for s in shares) and self.late_s >= 0 and all(0 <= p <= 10 for p in powers)):
            raise SettingsError(
                "Faults of the simulated camera need shares between 0 and 1, a delay of 0 s or more and a laser power "
                f"between 0 and 10, not {shares}, {self.late_s} s and {list(powers)}."
            )


class SimulatedCamera:
    """A live camera above a simulated machine; see `twinline.devices.camera.Camera` for what its methods promise.

    Frames are taken at even distances of host time, each of the machine as it stands in the middle of the exposure.
    They are rendered in a thread of their own. Under virtual time the clock stands still meanwhile; in real time a
    computer that cannot keep up loses frames, which are counted.

    Parameters
    ----------
    workspace
        What lies under the camera.
    machine
        Where cart and lasers are.
    rate_hz
        Frames per second.
    quality
        Of the JPEG, 1 to 100.
    encoding
        "jpeg" or "bgr8".

    Attributes
    ----------
    faults
        May be replaced at any time.
    """

    def __init__(
        self,
        workspace: Workspace,
        machine: MachineState,
        *,
        rate_hz: float = 25.0,
        quality: int = 80,
        encoding: Encoding = "jpeg",
        faults: CameraFaults | None = None,
    ) -> None:
        if not 0.1 <= rate_hz <= 1000.0 or not 1 <= quality <= 100 or encoding == "gray8":
            raise SettingsError(
                "The simulated camera makes 0.1 to 1000 frames/s in colour with a JPEG quality of 1 to 100, not "
                f"{rate_hz} frames/s as {encoding} with {quality}."
            )
        self.faults = faults or CameraFaults()
        self._workspace = workspace
        self._machine = machine
        self._encoding: Encoding = encoding
        self._values = {
            "exposure": min(BASE_EXPOSURE_MS, 900.0 / rate_hz),
            "gain": 0.0,
            "frame_rate": rate_hz,
            "quality": float(quality),
        }
        self._info: CameraInfo | None = None
        self._queue: FrameQueue | None = None
        self._reader: weakref.ref[AsyncIterator[CameraFrame]] | None = None
        self._running: asyncio.Task[None] | None = None
        self._pool: ThreadPoolExecutor | None = None
        self._state = CameraState.CLOSED
        self._reconnections = 0
        self._openings = 0

    async def open(self) -> CameraInfo:
        """See `Camera.open`."""
        if self._info is not None:
            return self._info
        if self.faults.gone:
            raise CameraError(
                "There is no simulated camera: its cable is out; plug it in again (fault gone).",
                code="camera-disconnected",
            )
        self._openings += 1
        opening = self._openings
        self._state = CameraState.CONNECTING
        pool = ThreadPoolExecutor(1, thread_name_prefix="simulated-camera")
        loop = asyncio.get_running_loop()
        try:
            # The world is prepared here, so that the first frame is not late.
            with hold():
                await loop.run_in_executor(pool, self._prepare)
            if opening != self._openings:
                raise CameraError("The simulated camera was closed while it was opened; open it again.")
        except BaseException:
            pool.shutdown(wait=False)
            if opening == self._openings:
                self._state = CameraState.CLOSED
            raise
        size = self._workspace.rig.image_size
        self._pool, self._reconnections = pool, 0
        self._queue = FrameQueue(loop, _CAPACITY)
        self._info = CameraInfo(size, self._values["frame_rate"], self._encoding, _NAME)
        self._state = CameraState.STREAMING
        self._running = asyncio.create_task(self._run(self._queue), name=_NAME)
        return self._info

    def frames(self) -> AsyncIterator[CameraFrame]:
        """See `Camera.frames`."""
        if self._queue is None:
            raise TransitionError("The simulated camera is not open: open it first.")
        iterator = self._queue.read(fresh=True)
        self._reader = weakref.ref(iterator)
        return iterator

    async def controls(self) -> Mapping[str, Control]:
        """See `Camera.controls`: ``exposure`` (ms), ``gain`` (dB), ``frame_rate`` (frames/s), ``quality`` (JPEG, %)."""
        if self._info is None:
            raise TransitionError("The simulated camera is not open: open it first.")
        longest_ms = 950.0 / self._values["frame_rate"]
        limits = {
            "exposure": (0.05, longest_ms, "ms"),
            "gain": (0.0, 30.0, "dB"),
            "frame_rate": (0.5, 120.0, "frames/s"),
            "quality": (1.0, 100.0, "%"),
        }
        return {name: Control(low, high, self._values[name], unit) for name, (low, high, unit) in limits.items()}

    async def set_control(self, name: str, value: float) -> None:
        """See `Camera.set_control`; a frame rate too high for the exposure shortens the exposure."""
        controls = await self.controls()
        if name not in controls:
            raise ControlError(f"The simulated camera has no control {name!r}; it has {', '.join(controls)}.")
        control = controls[name]
        if not control.low <= value <= control.high:
            raise ControlError(
                f"{name} must be between {control.low:g} and {control.high:g} {control.unit}, not {value:g}."
            )
        self._values[name] = float(value)
        self._values["exposure"] = min(self._values["exposure"], 950.0 / self._values["frame_rate"])

    def status(self) -> CameraStatus:
        """See `Camera.status`."""
        delivered, dropped = (0, 0) if self._queue is None else self._queue.counts()
        detail = "The simulated camera's cable is out (fault gone)." if self._state is CameraState.WAITING else None
        return CameraStatus(self._state, detail, delivered, dropped, self._reconnections)

    async def close(self) -> None:
        """See `Camera.close`."""
        self._openings += 1
        running, pool, queue = self._running, self._pool, self._queue
        self._running = self._pool = self._queue = self._info = None
        self._state = CameraState.CLOSED
        if queue is not None:
            queue.close()
        if running is not None:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)
        if pool is not None:
            pool.shutdown(wait=True)

    # ---------------------------------------------------------------------------------------------------------- inside

    def _prepare(self) -> None:
        self._render(0, 0.0, frozenset(), Exposure(), {}, 80)

    async def _run(self, queue: FrameQueue) -> None:
        """Take frames until cancelled."""
        loop = asyncio.get_running_loop()
        number, mid_s = 0, loop.time() + 0.5 / self._values["frame_rate"]
        try:
            while True:
                ready_s = mid_s + self._values["exposure"] / 2000.0 + _READOUT_S
                await asyncio.sleep(max(ready_s - loop.time(), 0.0))
                if self._is_gone():
                    await asyncio.sleep(_LOOK_AGAIN_S)
                    if not self._is_gone():
                        mid_s = loop.time()
                    continue
                await self._take(queue, number, mid_s, behind_s=loop.time() - ready_s)
                number += 1
                mid_s += 1.0 / self._values["frame_rate"]
        except asyncio.CancelledError:
            raise
        # Whatever goes wrong in a picture is the reader's to know; the task itself is awaited by nobody.
        except Exception as error:  # noqa: BLE001
            self._state = CameraState.ENDED
            queue.finish(CameraError(f"The simulated camera failed ({error}); close and open it again."))

    def _is_gone(self) -> bool:
        """Whether the cable is out; keeps the state in step with it."""
        if self.faults.gone:
            self._state = CameraState.WAITING
        elif self._state is CameraState.WAITING:
            self._state = CameraState.STREAMING
            self._reconnections += 1
        return self.faults.gone

    async def _take(self, queue: FrameQueue, number: int, mid_s: float, *, behind_s: float) -> None:
        """Take one frame, or lose it."""
        faults = self.faults
        lost, late = np.random.default_rng([self._workspace.seed, 9, number]).random(2)
        read = self._reader is not None and self._reader() is not None
        if lost < faults.lost_share or behind_s > _BEHIND_S or not read:
            queue.lose(1)
            # Many frames may be lost in a row: others must have their turn.
            await asyncio.sleep(0)
            return
        assert self._pool is not None
        exposure_ms, gain_db = self._values["exposure"], self._values["gain"]
        setting = Exposure(exposure_ms / BASE_EXPOSURE_MS, 10.0 ** (gain_db / 20.0))
        cart_mm, lasers = self._machine.cart_mm(mid_s), self._machine.lasers(mid_s)
        work = (number, cart_mm, lasers, setting, faults.laser_power, round(self._values["quality"]))
        with hold():
            data = await asyncio.get_running_loop().run_in_executor(self._pool, self._render, *work)
        if late < faults.late_share:
            await asyncio.sleep(faults.late_s)
        size = self._workspace.rig.image_size
        queue.put(CameraFrame(number, mid_s, exposure_ms / 1000.0, self._encoding, data, size))

    def _render(
        self,
        number: int,
        cart_mm: float,
        lasers: frozenset[int],
        exposure: Exposure,
        power: Mapping[int, float],
        quality: int,
    ) -> bytes:
        picture = self._workspace.renderer.render(number, cart_mm, lasers, exposure=exposure, power=power)
        if self._encoding != "jpeg":
            return picture.tobytes()
        encoded, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
        if not encoded:
            raise CameraError("a picture could not be encoded as JPEG")
        return data.tobytes()
