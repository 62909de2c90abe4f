"""A recording that plays as a motion board."""

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from dataclasses import replace
from heapq import merge
from operator import attrgetter
from typing import Literal

from twinline.devices.board import (
    Axis,
    Board,
    BoardEvent,
    BoardInfo,
    BoardMessage,
    BoardStatus,
    LaserPass,
    LinkChange,
    Telemetry,
    TofRaster,
)
from twinline.devices.replay.descriptions import plan_settings
from twinline.devices.replay.playback import Playback
from twinline.devices.serial.protocol_gen import EventKind, Flag, Latch, MotionEnd
from twinline.devices.serial.reasons import ended
from twinline.devices.subscription import Broadcast
from twinline.errors import MotionError, RefusedError, TwinlineError
from twinline.recording.pass_header import PassKind
from twinline.recording.pass_reader import Recording

_ASK_AGAIN_S = 0.005


class ReplayBoard:
    """A `Board` that goes through its passes as they were recorded, line by line.

    A machine stands in for everything that was not recorded: it is jogged, homed, and switches its lasers. When a pass
    is asked for it checks and drives the plan, but what subscribers hear meanwhile is the recording: the one that was
    made with the same plan, else the next of its kind. The pass ends as the recorded one ended.

    Parameters
    ----------
    playback
        Shared with the camera. Unless it is armed, the first recording plays on its own and the machine is not heard.
    machine
        Stands in; it belongs to this board from now on. Usually simulated (`twinline.devices.replay.machine`).
    """

    def __init__(self, playback: Playback, machine: Board) -> None:
        self._playback = playback
        self._machine = machine
        self._info: BoardInfo | None = None
        self._broadcast: Broadcast[BoardMessage] = Broadcast()
        self._tasks: list[asyncio.Task[None]] = []
        self._last: Telemetry | None = None
        self._muted = not playback.armed
        self._end: asyncio.Future[MotionEnd] | None = None
        self._running = self._over = self._played_out = False
        self._deaf_until_s = -math.inf

    async def open(self) -> BoardInfo:
        """See `Board.open`."""
        if self._info is None:
            info = await self._machine.open()
            self._broadcast.open()
            self._tasks = [
                asyncio.create_task(self._listen(self._machine.subscribe())),
                asyncio.create_task(self._play()),
            ]
            self._info = replace(info, name=f"replay of {self._playback.recordings[0].path.name}")
        return self._info

    async def close(self) -> None:
        """See `Board.close`."""
        if self._info is None:
            return
        self._info = None
        self._playback.lit = frozenset()
        await self._machine.close()
        listening, playing = self._tasks
        playing.cancel()
        # The machine's last words are that it is closed.
        await asyncio.gather(listening, playing, return_exceptions=True)
        self._finish(MotionEnd.STOPPED)
        self._broadcast.close()

    async def status(self) -> BoardStatus:
        """See `Board.status`; while a recording plays, as of the last telemetry."""
        status = await self._machine.status()
        last = self._last if self._muted else None
        if last is None:
            return status
        return BoardStatus(last.host_time_s, last.cart_mm, last.slide_mm, last.adc, last.flags, Latch.NONE)

    async def lasers(self, on: frozenset[int]) -> None:
        """See `Board.lasers`."""
        self._playback.lit = frozenset()
        await self._machine.lasers(on)
        self._playback.lit = on

    async def move(self, axis: Axis, to_mm: float, speed_mm_s: float) -> None:
        """See `Board.move`."""
        await self._machine.move(axis, to_mm, speed_mm_s)

    async def home(self, axis: Axis) -> None:
        """See `Board.home`."""
        await self._machine.home(axis)

    async def laser_pass(self, plan: LaserPass) -> None:
        """See `Board.laser_pass`; ``nothing-recorded`` if there is no further one."""
        await self._pass("laser", "The laser pass", plan_settings(plan), lambda: self._machine.laser_pass(plan))

    async def raster(self, plan: TofRaster) -> None:
        """See `Board.raster`; ``nothing-recorded`` if there is no further one."""
        await self._pass("tof", "The ToF pass", plan_settings(plan), lambda: self._machine.raster(plan))

    async def stop(self) -> None:
        """See `Board.stop`."""
        self._playback.lit = frozenset()
        await self._machine.stop()

    async def reset(self) -> None:
        """See `Board.reset`."""
        await self._machine.reset()

    async def telemetry(self, rate_hz: int, *, samples: int = 1) -> None:
        """See `Board.telemetry`; what was recorded comes at the rate at which it was recorded."""
        await self._machine.telemetry(rate_hz, samples=samples)

    def subscribe(self) -> AsyncIterator[BoardMessage]:
        """See `Board.subscribe`."""
        if self._info is not None:
            self._playback.begin_unless_armed()
        return self._broadcast.subscribe()

    # ---------------------------------------------------------------------------------------------------------- passes

    async def _pass(
        self,
        kind: PassKind,
        name: str,
        plan: dict[str, object],
        drive: Callable[[], Coroutine[object, object, None]],
    ) -> None:
        if self._running:
            raise RefusedError(f"{name} cannot begin while another one is running: wait for its end.", code="busy")
        self._running = True
        self._playback.lit = frozenset()
        moving = asyncio.ensure_future(drive())
        try:
            await self._accepted(moving)
            if self._playback.armed or self._over or self._playback.current is None:
                self._begin(kind, name, plan)
            self._end = asyncio.get_running_loop().create_future()
            await asyncio.wait((moving, self._end), return_when=asyncio.FIRST_COMPLETED)
            if not self._end.done():
                # Stopped; or complete a moment before the recorded one, or long before if that plays slowly.
                await moving
            end = await self._end
            await self._settle(moving, end)
        finally:
            self._end, self._running = None, False
            if not moving.done():
                moving.cancel()
                await asyncio.gather(moving, return_exceptions=True)
            self._over = True
            if self._played_out or not moving.done() or moving.cancelled() or moving.exception() is not None:
                # What was stopped in the middle does not play on; what is complete is heard to its last line.
                self._unmute()
        if end is not MotionEnd.DONE:
            raise ended(f"{name} as it was recorded", end)

    async def _accepted(self, moving: "asyncio.Future[None]") -> None:
        """Wait until the machine has begun to drive the plan; raises its refusal."""
        while not moving.done():
            if Flag.RUNNING in (await self._machine.status()).flags:
                return
            await asyncio.sleep(_ASK_AGAIN_S)
        await moving

    def _begin(self, kind: PassKind, name: str, plan: dict[str, object]) -> None:
        if self._playback.begin(kind, plan) is None:
            raise RefusedError(
                f"{name} cannot be replayed: no further one is in the recordings that play.", code="nothing-recorded"
            )
        self._muted, self._over, self._played_out, self._last = True, False, False, None

    async def _settle(self, moving: "asyncio.Future[None]", end: MotionEnd) -> None:
        """Let the machine come to its end too, or bring it there where the recording was faster."""
        if end is not MotionEnd.DONE or self._playback.speed > 1.0:
            with contextlib.suppress(TwinlineError):
                await self._machine.stop()
        with contextlib.suppress(MotionError):
            await moving

    def _finish(self, end: MotionEnd) -> None:
        self._over = True
        if self._end is not None and not self._end.done():
            self._end.set_result(end)

    def _unmute(self) -> None:
        """Let the machine be heard again, from now on."""
        if self._playback.armed and self._muted:
            self._muted = False
            self._deaf_until_s = asyncio.get_running_loop().time()

    # -------------------------------------------------------------------------------------------------------- messages

    async def _listen(self, messages: AsyncIterator[BoardMessage]) -> None:
        """Pass on what the machine says, unless a recording plays."""
        async for message in messages:
            told_before = self._muted or message.host_time_s < self._deaf_until_s
            if not told_before or isinstance(message, LinkChange):
                self._broadcast.publish(message)

    async def _play(self) -> None:
        played = 0
        while True:
            recording = await self._playback.next_pass(played)
            played = self._playback.passes
            self._over = self._played_out = False
            await self._play_one(recording, played)
            self._played_out = True
            if not self._running:
                self._unmute()

    async def _play_one(self, recording: Recording, number: int) -> None:
        end = _end_of_pass(recording)
        for recorded in _messages(recording):
            message = recorded
            await asyncio.sleep(self._playback.due_in_s(recorded.host_time_s))
            if self._playback.passes != number or not self._muted:
                return
            if self._playback.moves_stamps:
                message = replace(message, host_time_s=self._playback.stamp_s(message.host_time_s))
            if isinstance(message, Telemetry):
                self._last = message
            self._broadcast.publish(message)
            if isinstance(message, BoardEvent) and message.n == end:
                self._finish(MotionEnd(message.b))
        # A recording that was cut off has no end of its own.
        self._finish(MotionEnd.DONE if end is not None else MotionEnd.STOPPED)


def _messages(recording: Recording) -> Iterator[BoardMessage]:
    """Everything that came from the board, in the order of its times."""
    return merge(_lines(recording), _events(recording), _links(recording), key=attrgetter("host_time_s"))


def _lines(recording: Recording) -> Iterator[Telemetry]:
    for index in range(len(recording.telemetry)):
        line = recording.telemetry.line(index)
        times, places = (line.host_time_s, line.board_time_s), (line.cart_mm, line.slide_mm)
        yield Telemetry(line.n, *times, *places, line.adc, Flag(line.flags), line.earlier_adc)


def _events(recording: Recording) -> Iterator[BoardEvent]:
    known = {kind.value: kind for kind in EventKind}
    for event in recording.events:
        # A later version's board may tell of more than this one knows.
        if event.kind in known:
            times, places = (event.host_time_s, event.board_time_s), (event.cart_mm, event.slide_mm)
            yield BoardEvent(event.n, *times, known[event.kind], *places, event.a, event.b)


def _links(recording: Recording) -> Iterator[LinkChange]:
    # That the connection was closed in the end is said by the machine that stands in.
    states: dict[str, Literal["up", "down"]] = {"up": "up", "down": "down"}
    for link in recording.links:
        if link.state in states:
            yield LinkChange(link.host_time_s, states[link.state], link.reason)


def _end_of_pass(recording: Recording) -> int | None:
    """Number of the event that ended the recorded pass; None if it was cut off before."""
    begun = next((e.a for e in recording.events if e.kind in {EventKind.SCAN_START, EventKind.ROW_START}), None)
    ends = [e for e in recording.events if e.kind == EventKind.MOTION_END and begun in {None, e.a}]
    return ends[-1].n if ends else None
