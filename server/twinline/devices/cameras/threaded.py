"""A camera whose waiting is done by a thread: connects, connects again, stamps, counts."""

import asyncio
import threading
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from dataclasses import replace

from twinline.devices.camera import CameraFrame, CameraInfo, CameraState, CameraStatus, Control
from twinline.devices.cameras.frame_queue import FrameQueue
from twinline.devices.cameras.host_times import HostTimes
from twinline.devices.cameras.settings import CameraSettings
from twinline.devices.cameras.source import FrameSource, Lost, Picture
from twinline.devices.cameras.stamp_gaps import StampGaps
from twinline.errors import CameraError, ControlError, TransitionError, TwinlineError

# How long closing waits for a thread that hangs in a driver or in name resolution; it then ends by itself, later.
_FAREWELL_S = 1.0

SourceMaker = Callable[[CameraSettings, Callable[[], float]], FrameSource]
"""Makes an unconnected source from the settings and a clock that tells host time."""


class ThreadedCamera:
    """A `twinline.devices.camera.Camera` over a source that blocks.

    Parameters
    ----------
    settings
        Address and treatment.
    make_source
        Makes the source; called once each time the camera is opened.
    """

    def __init__(self, settings: CameraSettings, make_source: SourceMaker) -> None:
        self._settings = settings
        self._make_source = make_source
        self._session: _Session | None = None

    async def open(self) -> CameraInfo:
        """See `Camera.open`."""
        session = self._session
        if session is None:
            loop = asyncio.get_running_loop()
            session = _Session(self._settings, self._make_source(self._settings, loop.time), loop)
            self._session = session
            session.start()
        try:
            return await asyncio.shield(session.opened)
        except BaseException:
            # A refusal and a cancellation alike leave nothing behind.
            await self._leave(session)
            raise

    def frames(self) -> AsyncIterator[CameraFrame]:
        """See `Camera.frames`."""
        session, info = self._opened()
        return session.queue.read(fresh=info.live and not info.ends)

    async def controls(self) -> Mapping[str, Control]:
        """See `Camera.controls`."""
        session, _ = self._opened()
        return await asyncio.to_thread(session.source.controls)

    async def set_control(self, name: str, value: float) -> None:
        """See `Camera.set_control`."""
        session, info = self._opened()
        controls = await asyncio.to_thread(session.source.controls)
        control = controls.get(name)
        if control is None:
            known = (
                f"it has {', '.join(sorted(controls))}"
                if controls
                else "nothing can be set on it from here, use its own page or program"
            )
            raise ControlError(f"{info.name} has no control {name!r}: {known}.")
        if not control.low <= value <= control.high:
            unit = f" {control.unit}" if control.unit else ""
            raise ControlError(
                f"{name} of {info.name} cannot be {value:g}{unit}: use {control.low:g} to {control.high:g}{unit}."
            )
        await asyncio.to_thread(session.source.set_control, name, value)

    def status(self) -> CameraStatus:
        """See `Camera.status`."""
        return CameraStatus(CameraState.CLOSED) if self._session is None else self._session.status()

    async def close(self) -> None:
        """See `Camera.close`."""
        if self._session is not None:
            await self._leave(self._session)

    def _opened(self) -> "tuple[_Session, CameraInfo]":
        if self._session is None or self._session.info is None:
            raise TransitionError("The camera is not open: open it first.")
        return self._session, self._session.info

    async def _leave(self, session: "_Session") -> None:
        if self._session is session:
            self._session = None
        await session.stop()


class _Session:
    """A camera from opening to closing. A thread left over from one session cannot disturb the next."""

    def __init__(self, settings: CameraSettings, source: FrameSource, loop: asyncio.AbstractEventLoop) -> None:
        self.source = source
        self.queue = FrameQueue(loop, settings.queue_frames)
        self.opened: asyncio.Future[CameraInfo] = loop.create_future()
        self.info: CameraInfo | None = None
        self._settings = settings
        self._loop = loop
        self._times = HostTimes(settings.latency_s)
        self._gaps = StampGaps()
        self._stopping = threading.Event()
        self._ended = asyncio.Event()
        self._state: tuple[CameraState, str | None] = (CameraState.CONNECTING, None)
        self._reconnections = 0
        # A driver that never comes back must not keep the program from ending.
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)

    # -------------------------------------------------------------------------------------------------------- the loop

    def start(self) -> None:
        self._thread.start()

    async def stop(self) -> None:
        self._stopping.set()
        self.queue.close()
        self.source.interrupt()
        if not self.opened.done():
            self.opened.set_exception(CameraError("The camera was closed while it was connecting; open it again."))
        if not self.opened.cancelled():
            # Somebody may wait for it or not; in neither case is it an error nobody looked at.
            self.opened.exception()
        try:
            await asyncio.wait_for(self._ended.wait(), _FAREWELL_S)
        except TimeoutError:
            return
        self._thread.join()

    def status(self) -> CameraStatus:
        state, detail = self._state
        delivered, dropped = self.queue.counts()
        return CameraStatus(state, detail, delivered, dropped, self._reconnections)

    def _announce(self, info: CameraInfo) -> None:
        if not self.opened.done():
            self.info = info
            self.opened.set_result(info)

    def _refuse(self, error: Exception) -> None:
        if not self.opened.done():
            self.opened.set_exception(error)

    # ------------------------------------------------------------------------------------------------------ the thread

    def _run(self) -> None:
        try:
            self._keep_connected()
        except Exception as error:  # noqa: BLE001 - the edge of the thread: whoever reads the frames gets the error
            self._fail(error)
        finally:
            self._tell(self._ended.set)

    def _keep_connected(self) -> None:
        expected: CameraInfo | None = None
        pauses_s = retry_pauses_s(*self._settings.retry_s)
        while not self._is_over():
            try:
                info = self.source.connect()
                if expected is None:
                    expected = info
                    self._tell(self._announce, info)
                elif (info.image_size, info.encoding) != (expected.image_size, expected.encoding):
                    self._fail(_changed(expected, info))
                    return
                else:
                    self._reconnections += 1
                self._times.restart()
                self._gaps.restart()
                self._state = (CameraState.STREAMING, None)
                pauses_s = retry_pauses_s(*self._settings.retry_s)
                self._stream(expected)
                self._state = (CameraState.ENDED, None)
                self.queue.finish()
                return
            except CameraError as error:
                if self._stopping.is_set():
                    return
                if expected is None or expected.ends:
                    self._fail(error)
                    return
                self._state = (CameraState.WAITING, error.detail)
            finally:
                self.source.disconnect()
            self._stopping.wait(next(pauses_s))

    def _stream(self, info: CameraInfo) -> None:
        play = _Playback(self._loop.time, self._stopping) if info.ends else None
        lost = 0
        while not self._is_over():
            if play is not None:
                self.queue.wait_for_reader()
            item = self.source.read()
            if item is None:
                return
            if isinstance(item, Lost):
                self.queue.lose(item.count)
                lost += item.count
                continue
            if play is not None:
                item = play.on_time(item, wait=info.live)
            # A frame that came broken leaves a gap in the stamps too, and is counted already.
            self.queue.lose(max(0, self._gaps.missing(item.camera_time_s) - lost))
            lost = 0
            frame = self._stamped(item, info)
            if info.live:
                self.queue.put(frame)
            else:
                self.queue.put_when_taken(frame)

    def _stamped(self, picture: Picture, info: CameraInfo) -> CameraFrame:
        exposure_s = self._settings.exposure_s if picture.exposure_s is None else picture.exposure_s
        host_time_s = self._times.mid_exposure_s(picture.arrival_s, picture.camera_time_s, exposure_s)
        return CameraFrame(0, host_time_s, exposure_s, info.encoding, picture.data, info.image_size)

    def _is_over(self) -> bool:
        # A program that closes its loop and forgets the camera must not leave a thread that connects for ever.
        return self._stopping.is_set() or self._loop.is_closed()

    def _fail(self, error: Exception) -> None:
        self._state = (CameraState.ENDED, error.detail if isinstance(error, TwinlineError) else None)
        self.queue.finish(error)
        self._tell(self._refuse, error)

    def _tell(self, what: Callable[..., None], *arguments: object) -> None:
        try:
            self._loop.call_soon_threadsafe(what, *arguments)
        except RuntimeError:
            # The loop has been closed: there is nobody left to tell.
            return


def retry_pauses_s(first_s: float, longest_s: float) -> Iterator[float]:
    """Pauses before connecting again, without an end: each twice the one before, up to the longest."""
    pause_s = first_s
    while True:
        yield pause_s
        pause_s = min(2 * pause_s, longest_s)


class _Playback:
    """Times for pictures that were made long ago: their own spacing, from when they are first wanted."""

    def __init__(self, clock: Callable[[], float], stopping: threading.Event) -> None:
        self._clock = clock
        self._stopping = stopping
        self._offset_s: float | None = None

    def on_time(self, picture: Picture, *, wait: bool) -> Picture:
        """The picture with the host time at which it is due; waits for it where asked to."""
        stamp_s = picture.camera_time_s or 0.0
        now_s = self._clock()
        # After a pause, when nobody was reading, it goes on from now instead of hurrying after the past.
        if self._offset_s is None or (wait and now_s - stamp_s - self._offset_s > 1.0):
            self._offset_s = now_s - stamp_s
        due_s = stamp_s + self._offset_s
        if wait:
            self._stopping.wait(max(0.0, due_s - now_s))
        return replace(picture, arrival_s=due_s, camera_time_s=None)


def _changed(before: CameraInfo, after: CameraInfo) -> CameraError:
    old, new = (f"{i.image_size[0]} x {i.image_size[1]} px in {i.encoding}" for i in (before, after))
    return CameraError(
        f"{before.name} sends {new} since it was connected again, where it sent {old}: set it back, or open it again."
    )
