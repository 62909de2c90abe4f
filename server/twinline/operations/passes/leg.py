"""One leg of a pass: the machine moves, and all that board and camera say is recorded until it stands again."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from typing import Any, Protocol

from twinline.devices.board import BoardEvent, BoardMessage, LinkChange, Telemetry
from twinline.devices.camera import Camera, CameraFrame, CameraInfo
from twinline.devices.serial.protocol_gen import Flag
from twinline.devices.virtual_time import hold
from twinline.errors import CameraError, DeviceError, TwinlineError
from twinline.operations.passes.machine import Machine
from twinline.recording.pass_writer import PassWriter

LAST_FRAMES_S = 10.0
"""How much later than the machine stands its last frames may come; a camera that is silent is found out earlier."""

LAST_WORDS_S = 1.0
"""The same where the leg was cut short, and may have no end that anybody tells of."""

MOST_SILENCE_S = 1.5
"""Without a frame for so long, the camera counts as lost."""

MOST_SILENT_FRAMES = 4.0
"""The same in frames, for slow cameras."""

_SAFE_S = 2.0
_LOOK_S = 0.02
_MOVING = Flag.CART_MOVING | Flag.SLIDE_MOVING | Flag.RUNNING


class Listener(Protocol):
    """Something that follows a leg: which frames to keep, how far it is."""

    @property
    def complete(self) -> asyncio.Event:
        """Set when everything that belongs to the leg has arrived."""
        ...

    def message(self, message: BoardMessage) -> None:
        """The board told something; it is recorded already."""
        ...

    def frame(self, frame: CameraFrame) -> None:
        """The camera delivered a frame; it is for the listener to record it."""
        ...


async def record_leg(
    machine: Machine,
    writer: PassWriter,
    listener: Listener,
    drive: Callable[[], Awaitable[None]],
    *,
    camera: CameraInfo | None,
) -> None:
    """Record until ``drive`` has ended and what belongs to it has arrived, then close the recording.

    Whatever fails, the board is stopped, which switches its lasers off, and what was recorded stays readable.

    Parameters
    ----------
    drive
        Moves the machine; returns when it stands.
    camera
        What is known of the machine's camera, where frames are wanted; that it falls silent then ends the leg.

    Raises
    ------
    DeviceError
        Board or camera failed, or the movement was stopped.
    OutputError
        The recording cannot be written.
    """
    messages = machine.board.subscribe()
    stands = asyncio.Event()
    failure: DeviceError | None = None
    try:
        async with asyncio.TaskGroup() as group:
            board_follower = group.create_task(_follow_board(messages, writer, listener))
            camera_follower = (
                None if camera is None else group.create_task(_follow_camera(machine.camera, camera, listener, stands))
            )
            try:
                await drive()
            except DeviceError as error:
                failure = error
            stands.set()
            await _last_words(listener, camera_follower, LAST_FRAMES_S if failure is None else LAST_WORDS_S)
            board_follower.cancel()
            if camera_follower is not None:
                camera_follower.cancel()
    except BaseExceptionGroup as group_error:
        raise _first(group_error) from None
    finally:
        await _make_safe(machine, writer)
    if failure is not None:
        raise failure


async def _follow_board(messages: AsyncIterator[BoardMessage], writer: PassWriter, listener: Listener) -> None:
    async for message in messages:
        if isinstance(message, Telemetry):
            writer.telemetry(message)
        elif isinstance(message, BoardEvent):
            writer.event(message)
        elif isinstance(message, LinkChange):
            writer.link(message)
        listener.message(message)


async def _follow_camera(camera: Camera, info: CameraInfo, listener: Listener, stands: asyncio.Event) -> None:
    patience_s = max(MOST_SILENCE_S, MOST_SILENT_FRAMES / (info.rate_hz or MOST_SILENT_FRAMES))
    frames = camera.frames()
    try:
        while True:
            try:
                async with asyncio.timeout(patience_s):
                    frame = await anext(frames)
            except TimeoutError:
                if info.live:
                    raise _lost(camera, patience_s) from None
                # It keeps what it has until it is asked, so that nothing is lost; nor is there anything on its way.
                if stands.is_set():
                    return
            except StopAsyncIteration:
                raise CameraError("The camera's frames came to an end in the middle of the pass.") from None
            else:
                listener.frame(frame)
    finally:
        # An error's traceback would keep it, and the camera would go on taking frames for nobody.
        del frames


def _lost(camera: Camera, patience_s: float) -> CameraError:
    detail = camera.status().detail
    because = f" ({detail.rstrip('.')})" if detail else ""
    return CameraError(
        f"No frame came from the camera for {patience_s:g} s{because}; check its cable and power.", code="camera-lost"
    )


async def _last_words(listener: Listener, camera_follower: "asyncio.Task[None] | None", most_s: float) -> None:
    """Wait for what is still on its way."""
    complete = asyncio.ensure_future(listener.complete.wait())
    waiting: set[asyncio.Future[Any]] = {complete}
    if camera_follower is not None:
        waiting.add(camera_follower)
    try:
        await asyncio.wait(waiting, timeout=most_s, return_when=asyncio.FIRST_COMPLETED)
    finally:
        complete.cancel()


async def _make_safe(machine: Machine, writer: PassWriter) -> None:
    """Stop the machine, wait until it stands, and close the recording, also for a caller who is being cancelled."""
    with suppress(TwinlineError, TimeoutError):
        async with asyncio.timeout(_SAFE_S):
            await machine.board.stop()
            while (await machine.board.status()).flags & _MOVING:  # noqa: ASYNC110  (the board is to be asked)
                await asyncio.sleep(_LOOK_S)
    with hold():
        await asyncio.shield(asyncio.to_thread(writer.close))


def _first(group: BaseExceptionGroup[BaseException]) -> BaseException:
    """The first error of a group that is none of a group's own."""
    error: BaseException = group
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    return error
