"""The ToF pass: the slide sweeps to and fro, the cart advances, and every reading is recorded."""

import asyncio
from contextlib import suppress
from dataclasses import dataclass

from twinline.devices.board import DEFAULT_CART, BoardEvent, BoardMessage, Telemetry, TofRaster
from twinline.devices.camera import CameraFrame
from twinline.devices.replay.descriptions import board_settings, plan_settings
from twinline.devices.serial.protocol_gen import EventKind, Flag
from twinline.errors import DeviceError, MotionError
from twinline.operations.passes.leg import record_leg
from twinline.operations.passes.requests import TofPassRequest
from twinline.operations.passes.session import MOST_INTERRUPTIONS, TELEMETRY_HZ, TOF_SAMPLES, ScanSession

_TELEMETRY_S = 1.0


@dataclass
class TofTally:
    """What was seen of a ToF pass while it was recorded.

    Attributes
    ----------
    rows
        Rows that were finished.
    lines, blind, broken
        Lines of telemetry within rows; those with the sensor out of its range, and with its wire broken.
    drift_mm
        Largest distance between where the low limit switch closed and where it did at homing.
    homing
        Why the slide could not be homed afterwards; empty where it could.
    """

    rows: int = 0
    lines: int = 0
    blind: int = 0
    broken: int = 0
    drift_mm: float = 0.0
    homing: str = ""


async def run_tof_pass(session: ScanSession, request: TofPassRequest, *, rows_done: int = 0) -> TofTally:
    """Record a ToF pass, then home the slide: where its switch closes tells whether steps were lost.

    A pause or a lost link ends a leg; the next one goes on with the row that was not finished.

    Parameters
    ----------
    rows_done
        Rows that an earlier run finished.

    Raises
    ------
    DeviceError
        The board failed for good; what was recorded is kept.
    OutputError
        The recording cannot be written.
    CancelledError
        It was cancelled.
    """
    tally = TofTally(rows=rows_done)
    interruptions = 0
    while True:
        await session.control.checkpoint()
        leg = _TofLeg(session, request, tally)
        try:
            await leg.run()
        except DeviceError as error:
            if not session.explains(error):
                interruptions += 1
                if interruptions > MOST_INTERRUPTIONS:
                    raise MotionError(
                        f"The ToF pass was interrupted {interruptions} times and is given up after {tally.rows} rows: "
                        f"{error.detail}",
                        code="too-many-interruptions",
                    ) from error
                await session.recovered(error)
        else:
            if leg.recorded and session.machine.replayed is None:
                await _home_again(session, tally)
            return tally


async def _home_again(session: ScanSession, tally: TofTally) -> None:
    session.report("checking the slide", 0, 0)
    board = session.machine.board
    messages = board.subscribe()
    try:
        await session.control.drive(board.home("slide"), board.stop)
    except DeviceError as error:
        # What was recorded is none the worse for it, but nobody knows how good it is.
        tally.homing = error.detail
        return
    with suppress(TimeoutError):
        async with asyncio.timeout(_TELEMETRY_S):
            async for message in messages:
                if isinstance(message, BoardEvent) and message.kind is EventKind.LIMIT and message.b:
                    # Homing makes the switch's place zero; until it does so again, zero is where it should close.
                    tally.drift_mm = message.slide_mm
                    return


class _TofLeg:
    """From the first row that is missing to the last, or to the next interruption."""

    def __init__(self, session: ScanSession, request: TofPassRequest, tally: TofTally) -> None:
        self._session = session
        self._request = request
        self._tally = tally
        self._before = tally.rows
        self._places: tuple[float, ...] = ()
        self.recorded = False
        self._in_row = False
        self._ended_s: float | None = None
        self.complete = asyncio.Event()

    async def run(self) -> None:
        """Record the leg; one without rows is over at once."""
        session, request, board = self._session, self._request, self._session.machine.board
        info = await board.open()
        self._places = request.row_places_mm(info.drives.get("cart", DEFAULT_CART))
        if self._before >= len(self._places):
            return
        await session.settled_board(needs_slide=True)
        if not session.machine.replayed:
            await board.telemetry(TELEMETRY_HZ, samples=TOF_SAMPLES)
        ends = (request.slide_from_mm, request.slide_to_mm)
        near, far = ends if self._before % 2 == 0 else ends[::-1]
        begin = self._places[self._before]
        plan = TofRaster(begin, request.to_mm, request.advance_mm, near, far, request.speed_mm_s)
        settings = {
            "request": request.to_json(),
            "plan": plan_settings(plan),
            "board": board_settings(info),
            "rows_before": self._before,
        }
        writer = session.writer("tof", settings)

        async def drive() -> None:
            await session.control.drive(board.raster(plan), board.stop)

        self.recorded = True
        await record_leg(session.machine, writer, self, drive, camera=None)

    def message(self, message: BoardMessage) -> None:
        """Count the rows, and what the sensor saw in them."""
        tally = self._tally
        if isinstance(message, BoardEvent):
            if message.kind is EventKind.ROW_START:
                self._in_row = True
            elif message.kind is EventKind.ROW_END:
                self._in_row = False
                tally.rows += 1
                self._session.report("ToF pass", tally.rows, len(self._places))
            elif message.kind is EventKind.MOTION_END:
                self._ended_s = message.host_time_s
        elif isinstance(message, Telemetry):
            if self._in_row:
                tally.lines += 1
                tally.broken += Flag.ADC_BROKEN in message.flags
                tally.blind += Flag.ADC_CLIPPED in message.flags and Flag.ADC_BROKEN not in message.flags
            if self._ended_s is not None and message.host_time_s >= self._ended_s:
                self.complete.set()

    def frame(self, frame: CameraFrame) -> None:
        """There are none."""
