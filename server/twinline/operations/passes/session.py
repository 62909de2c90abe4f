"""What the passes of one scan share: machine, folder, handle, reports, and the heads of their recordings."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import TypeAlias, TypeVar

from twinline.devices.board import BoardStatus
from twinline.devices.serial.protocol_gen import Flag, Latch
from twinline.devices.serial.reasons import STOPPED_CODE
from twinline.devices.virtual_time import hold
from twinline.errors import DeviceError, DeviceTimeoutError, LinkError, MotionError, OutputError, TwinlineError
from twinline.geometry.rig_json import rig_to_json
from twinline.operations.passes.control import PassControl
from twinline.operations.passes.machine import Machine
from twinline.operations.passes.scan_folder import ScanFolder
from twinline.recording.pass_header import PassHeader, PassKind
from twinline.recording.pass_writer import PassWriter

Result = TypeVar("Result")

Report: TypeAlias = Callable[[str, int, int], None]
"""Called with what is being done, how much of it, of how much."""

TELEMETRY_HZ = 100
TOF_SAMPLES = 4
LINK_BACK_S = 30.0
CAMERA_BACK_S = 30.0
MOST_INTERRUPTIONS = 20
"""A pass that was interrupted more often is given up; pauses do not count."""

_LOOK_S = 0.1
_FRAME_S = 1.0


def _nothing(*_: object) -> None: ...


@dataclass(frozen=True, eq=False)
class ScanSession:
    """A scan that is being made. Made on the event loop that it runs on."""

    machine: Machine
    folder: ScanFolder
    control: PassControl = field(default_factory=PassControl)
    report: Report = _nothing
    _started_at: datetime = field(default_factory=lambda: datetime.now(UTC))
    _started_s: float = field(default_factory=lambda: asyncio.get_running_loop().time())

    def writer(self, kind: PassKind, settings: Mapping[str, object]) -> PassWriter:
        """The recording of a pass's next leg.

        Raises
        ------
        OutputError
            It cannot be made.
        """
        leg, path = self.folder.next_leg(kind)
        now_s = asyncio.get_running_loop().time()
        rig = self.machine.rig
        header = PassHeader(
            kind=kind,
            capture=self.machine.description,
            scan_id=self.folder.scan_id,
            leg=leg,
            # By the loop's own clock, so that legs follow one another as they did for the machine.
            started_at=self._started_at + timedelta(seconds=now_s - self._started_s),
            host_time_s=now_s,
            rig=None if rig is None else rig_to_json(rig),
            settings={"simulated": self.machine.simulated, **settings},
            adc_per_count=self.machine.adc_per_count,
            adc_valid=self.machine.adc_valid,
        )
        is_new = not path.exists()
        try:
            return PassWriter(path, header)
        except OutputError:
            # Without its head the file is no recording, and would stand in the way of all others.
            if is_new:
                with suppress(OSError):
                    path.unlink(missing_ok=True)
            raise

    async def aside(self, work: Callable[[], Result]) -> Result:
        """Do what reads files in a thread, while the machine's time stands still if it can."""
        with hold():
            return await asyncio.to_thread(work)

    async def unlatched_board(self) -> BoardStatus:
        """Make sure that the board lets anything move; a heartbeat that is back is no reason to refuse.

        Raises
        ------
        DeviceError
            It does not; the message says what to do.
        """
        status = await self.machine.board.status()
        if status.latch is Latch.HEARTBEAT:
            await self.machine.board.reset()
            status = await self.machine.board.status()
        if status.latch is not Latch.NONE:
            why = status.latch.name.lower().replace("_", " ")
            raise DeviceError(
                f"The board is latched ({why}): lasers and motors stay off; remove the cause, then reset it.",
                code="latched",
            )
        return status

    async def settled_board(self, *, needs_slide: bool) -> None:
        """Make sure that a pass can begin: no latch, positions known.

        Raises
        ------
        DeviceError
            It cannot; the message says what to do.
        """
        status = await self.unlatched_board()
        known = Flag.CART_KNOWN | Flag.SLIDE_KNOWN if needs_slide else Flag.CART_KNOWN
        if known not in status.flags:
            raise MotionError(
                "The board no longer knows where cart and slide are, so the pass cannot go on where it stopped; home "
                "the machine and begin a new scan (what was recorded is kept).",
                code="position-lost",
            )

    def explains(self, error: DeviceError) -> bool:
        """Whether a leg's end is no trouble: it was paused or cancelled, or a replayed one was interrupted then."""
        return self.control.explains(error) or (self.machine.replayed is not None and error.code == STOPPED_CODE)

    async def recovered(self, error: DeviceError) -> None:
        """Wait until what broke a leg is whole again.

        Parameters
        ----------
        error
            What ended the leg; raised again if waiting does not help.
        """
        if error.code == "board-restarted":
            raise type(error)(f"{error.detail.rstrip('.')}; what was recorded is kept.", code=error.code) from error
        if error.code == "camera-lost":
            await self._wait(CAMERA_BACK_S, self._camera_works, error)
        elif isinstance(error, LinkError | DeviceTimeoutError) or error.code in ("heartbeat", "events-lost"):
            await self._wait(LINK_BACK_S, self._link_works, error)
        else:
            raise error

    async def _wait(self, most_s: float, works: Callable[[], Awaitable[bool]], error: DeviceError) -> None:
        """Look again and again; a pause does not count."""
        loop = asyncio.get_running_loop()
        self.report("waiting for the machine to come back", 0, 0)
        left_s = most_s
        while left_s > 0.0:
            await self.control.checkpoint()
            began_s = loop.time()
            if await works():
                return
            await asyncio.sleep(_LOOK_S)
            left_s -= loop.time() - began_s
        raise type(error)(
            f"{error.detail.rstrip('.')}; it did not come back within {most_s:g} s, what was recorded is kept, and the "
            "scan can be continued.",
            code=error.code,
        ) from error

    async def _link_works(self) -> bool:
        try:
            await self.machine.board.status()
        except DeviceError:
            return False
        return True

    async def _camera_works(self) -> bool:
        try:
            async with asyncio.timeout(_FRAME_S):
                await anext(self.machine.camera.frames())
        except (TimeoutError, StopAsyncIteration, TwinlineError):
            return False
        return True
