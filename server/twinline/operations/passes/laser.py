"""The laser pass: the cart crosses the area at constant speed, and every frame is recorded."""

import asyncio
from dataclasses import dataclass, field, replace

from twinline.devices.board import DEFAULT_CART, BoardEvent, BoardMessage, LaserPass, Telemetry
from twinline.devices.camera import CameraFrame, CameraInfo
from twinline.devices.replay.descriptions import board_settings, plan_settings
from twinline.devices.serial.protocol_gen import EventKind
from twinline.errors import CameraError, DeviceError, MotionError
from twinline.operations.passes.forecast import DARK_S
from twinline.operations.passes.frame_sorter import FrameSorter
from twinline.operations.passes.leg import record_leg
from twinline.operations.passes.picture_watch import PictureWatch
from twinline.operations.passes.requests import LaserPassRequest
from twinline.operations.passes.session import MOST_INTERRUPTIONS, TELEMETRY_HZ, ScanSession
from twinline.recording.pass_writer import PassWriter

PHASE_FRAMES = 2.0
"""Alternating lasers keep each turn for so many frames: one of them lies wholly within it."""

UNKNOWN_RATE_HZ = 25.0
_DARK_PATIENCE_S = 5.0
_MISSING_FRAMES = 2.5
"""A pass that ends further from its end than so many frames lacks some."""


@dataclass
class LaserTally:
    """What was seen of a laser pass while it was recorded.

    Attributes
    ----------
    frames
        How many were recorded.
    warnings
        What the pictures lack, a sentence each.
    """

    frames: int = 0
    warnings: list[str] = field(default_factory=list)


async def run_laser_pass(
    session: ScanSession, request: LaserPassRequest, *, reached_mm: float | None = None
) -> LaserTally:
    """Record a laser pass.

    A pause, a lost link or a lost camera ends a leg; the next one goes on at the position of the last frame. So does
    a leg whose last frames never came.

    Parameters
    ----------
    reached_mm
        Where an earlier run stopped; None to begin at the beginning.

    Raises
    ------
    DeviceError
        Board or camera failed for good; the lasers are off, and what was recorded is kept.
    OutputError
        The recording cannot be written.
    CancelledError
        It was cancelled.
    """
    reached = request.from_mm if reached_mm is None else reached_mm
    tally, interruptions = LaserTally(), 0
    trouble: DeviceError | None = None
    while interruptions <= MOST_INTERRUPTIONS:
        await session.control.checkpoint()
        leg = _LaserLeg(session, request, reached)
        try:
            await leg.run()
        except DeviceError as error:
            if not session.explains(error):
                interruptions, trouble = interruptions + 1, error
                await session.recovered(error)
        else:
            interruptions += 1
        tally.frames += leg.frames
        tally.warnings += leg.warnings
        left = await session.aside(session.folder.laser_pass_left)
        reached = left[1] if left else reached
        if leg.over and leg.missing(reached) <= _MISSING_FRAMES:
            return tally
    why = trouble.detail if trouble else "frames are lost on their way, so lower the camera's rate or size."
    raise MotionError(
        f"The laser pass was interrupted {interruptions} times and is given up at {reached:.1f} mm: {why}",
        code="too-many-interruptions",
    )


class _LaserLeg:
    """From where the pass has come to its end, or to the next interruption."""

    def __init__(self, session: ScanSession, request: LaserPassRequest, from_mm: float) -> None:
        self._session = session
        self._request = request
        self.frames = 0
        self.over = False
        self.complete = asyncio.Event()
        self._from_mm = from_mm
        self._rate_hz = UNKNOWN_RATE_HZ
        self._stands = False
        self._background: asyncio.Future[None] | None = None
        self._dark_after_s = 0.0
        self._writer: PassWriter | None = None
        self._sorter: FrameSorter | None = None
        self._watch = PictureWatch(session.machine.info().stripe_runs)
        self._cart_mm = from_mm

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the pictures lacked."""
        return self._watch.warnings()

    def missing(self, reached_mm: float) -> float:
        """How many frames there should be between a place and the end of the pass."""
        return abs(self._request.to_mm - reached_mm) / self._request.speed_mm_s * self._rate_hz

    async def run(self) -> None:
        """Record the leg; one with no place for a frame is over at once."""
        session, request = self._session, self._request
        await session.settled_board(needs_slide=False)
        info = await session.machine.camera.open()
        self._rate_hz = info.rate_hz or UNKNOWN_RATE_HZ
        self._go_back_a_turn()
        if self._from_mm == request.from_mm or self.missing(self._from_mm) > 1.0:
            await self._record(info)
        self.over = True

    def _go_back_a_turn(self) -> None:
        """Where the lasers take turns it is the first one's again, and the other must not lack a line."""
        request = self._request
        if request.alternating and self.missing(self._from_mm) > 1.0:
            turn_mm = PHASE_FRAMES * request.speed_mm_s / self._rate_hz
            back_mm = min(turn_mm, abs(self._from_mm - request.from_mm))
            self._from_mm -= request.direction * back_mm

    async def _record(self, info: CameraInfo) -> None:
        session, request = self._session, self._request
        if not session.machine.replayed:
            await session.machine.board.telemetry(TELEMETRY_HZ)
        plan = LaserPass(self._from_mm, request.to_mm, request.speed_mm_s)
        if request.alternating:
            phases = tuple(frozenset({laser}) for laser in (1, 2))
            turn_s = PHASE_FRAMES / self._rate_hz
            plan = replace(plan, phases=phases, phase_s=turn_s)
        settings = {
            "request": request.to_json(),
            "plan": plan_settings(plan),
            "board": board_settings(await session.machine.board.open()),
            "camera": {name: control.value for name, control in (await session.machine.camera.controls()).items()},
            "rate_hz": self._rate_hz,
        }
        self._writer = session.writer("laser", settings)
        self._sorter = FrameSorter(plan, self._keep)
        await record_leg(session.machine, self._writer, self, lambda: self._drive(plan), camera=info)

    async def _drive(self, plan: LaserPass) -> None:
        board, control = self._session.machine.board, self._session.control
        if self._request.background and self._from_mm == self._request.from_mm:
            await self._take_background()
        await control.drive(board.laser_pass(plan), board.stop)

    async def _take_background(self) -> None:
        """One frame with the lasers off, at the place where the pass begins."""
        self._session.report("background frame", 0, 0)
        machine, loop = self._session.machine, asyncio.get_running_loop()
        if machine.replayed:
            if machine.replayed.background is not None and self._writer is not None:
                self._writer.picture(machine.replayed.background)
            return
        await machine.board.lasers(frozenset())
        speed_mm_s = (await machine.board.open()).drives.get("cart", DEFAULT_CART).max_speed_mm_s
        approach = machine.board.move("cart", self._request.from_mm, speed_mm_s)
        await self._session.control.drive(approach, machine.board.stop)
        self._dark_after_s = loop.time() + DARK_S
        self._background = loop.create_future()
        try:
            async with asyncio.timeout(_DARK_PATIENCE_S + self._dark_after_s - loop.time()):
                await self._background
        except TimeoutError:
            raise CameraError(
                "The camera sent no frame with the lasers off; check its cable and power.", code="camera-lost"
            ) from None

    def message(self, message: BoardMessage) -> None:
        """Follow the cart."""
        if self._sorter is not None:
            self._sorter.message(message)
            ended = isinstance(message, BoardEvent) and message.kind is EventKind.MOTION_END
            self._stands |= ended and self._sorter.begun
            self._look()
        if isinstance(message, Telemetry):
            self._cart_mm = message.cart_mm
        if isinstance(message, Telemetry) and self.frames:
            request = self._request
            done = (message.cart_mm - request.from_mm) * request.direction
            self._session.report("laser pass", round(min(max(done, 0.0), request.length_mm)), round(request.length_mm))

    def frame(self, frame: CameraFrame) -> None:
        """Take a frame, lit or dark."""
        waiting = self._background
        if waiting is None or waiting.done():
            if self._sorter is not None:
                self._sorter.frame(frame)
                self._look()
            return
        begins = frame.host_time_s - 0.5 * (frame.exposure_s or 0.0)
        if begins > self._dark_after_s and self._writer is not None:
            self._writer.frame(frame, "laser/off", lasers=frozenset(), cart_mm=self._request.from_mm)
            waiting.set_result(None)

    def _look(self) -> None:
        if self._stands and self._sorter is not None and self._sorter.complete:
            self.complete.set()

    def _keep(self, frame: CameraFrame, lasers: frozenset[int]) -> None:
        if self._writer is not None:
            self._writer.frame(frame, "laser", lasers=lasers)
            self._watch.frame(frame, lasers, self._cart_mm)
            self.frames += 1
