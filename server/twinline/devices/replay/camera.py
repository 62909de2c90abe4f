"""A recording that plays as a camera."""

import asyncio
import weakref
from collections.abc import AsyncIterator, Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np

from twinline.devices.camera import CameraFrame, CameraInfo, CameraState, CameraStatus, Control, Encoding
from twinline.devices.replay.playback import Playback
from twinline.devices.virtual_time import hold
from twinline.errors import CameraError, ControlError, DeviceError, FrameError, TransitionError
from twinline.recording.images import read_image
from twinline.recording.pass_rows import RecordedFrame
from twinline.recording.topics import PartName

_USUAL_PERIOD_S = 0.04


class ReplayCamera:
    """A `Camera` that delivers the frames of a recording.

    Numbers, times and bytes of the frames are those of the recording. Frames that were recorded as PNG come as pixels.
    A frame that the recording no longer has as it was is counted as dropped. Nothing is lost because a reader is slow.

    Where the playback is armed and moves stamps to the present, the camera never falls silent: while nothing recorded
    is due it shows a still picture, with the lasers that are on as far as there is one, and frames are numbered anew.
    """

    def __init__(self, playback: Playback, part: PartName = "laser") -> None:
        self._playback = playback
        self._part = part
        self._info: CameraInfo | None = None
        self._openings = 0
        self._closed = asyncio.Event()
        self._state = CameraState.CLOSED
        self._reader: weakref.ref[_Frames] | None = None
        self._owner: weakref.ref[asyncio.Task[object]] | None = None
        self._pass = 0
        self._next = 0
        self._delivered = self._damaged = self._dropped = 0
        self._period_s = _USUAL_PERIOD_S
        self._stills: dict[frozenset[int] | None, CameraFrame] = {}

    async def open(self) -> CameraInfo:
        """See `Camera.open`."""
        if self._info is not None:
            return self._info
        self._openings += 1
        opening = self._openings
        self._state = CameraState.CONNECTING
        try:
            with hold():
                info = await asyncio.to_thread(self._describe)
        except BaseException:
            self._give_up(opening)
            raise
        if opening != self._openings:
            raise DeviceError("The camera was closed while it was being opened.")
        self._info, self._closed = info, asyncio.Event()
        self._period_s = 1.0 / info.rate_hz if info.rate_hz else _USUAL_PERIOD_S
        self._state = CameraState.STREAMING
        self._pass = self._next = self._delivered = self._damaged = self._dropped = 0
        return info

    def frames(self) -> AsyncIterator[CameraFrame]:
        """See `Camera.frames`."""
        self._require_open()
        if self._is_read():
            raise TransitionError("Somebody else reads this camera's frames: end that first.")
        iterator = _Frames(self, self._openings)
        self._reader = weakref.ref(iterator)
        task = asyncio.current_task()
        self._owner = None if task is None else weakref.ref(task)
        return iterator

    async def controls(self) -> Mapping[str, Control]:
        """See `Camera.controls`: what was recorded cannot be set any more."""
        self._require_open()
        return {}

    async def set_control(self, name: str, value: float) -> None:
        """See `Camera.set_control`."""
        self._require_open()
        raise ControlError(f"A replayed camera has no control {name!r}: its frames were taken long ago.")

    def status(self) -> CameraStatus:
        """See `Camera.status`."""
        return CameraStatus(self._state, None, self._delivered, self._dropped)

    async def close(self) -> None:
        """See `Camera.close`."""
        self._openings += 1
        self._info = None
        self._state = CameraState.CLOSED
        self._closed.set()

    async def take(self, iterator: "_Frames", opening: int) -> CameraFrame:
        """The next frame of an iteration; StopAsyncIteration after the last."""
        while True:
            if opening != self._openings or self._reader is None:
                raise StopAsyncIteration
            if self._reader() is not iterator:
                raise TransitionError("Somebody else reads this camera's frames by now: begin again.")
            if self._shows_still():
                return await self._still(opening)
            frames = await self._playing()
            if frames is None or opening != self._openings:
                raise StopAsyncIteration
            if self._next == len(frames):
                if not self._playback.armed:
                    self._state = CameraState.ENDED
                    raise StopAsyncIteration
                self._pass, self._next = self._pass + 1, 0
                continue
            recorded = frames[self._next]
            if await self._closes_within(self._playback.due_in_s(recorded.host_time_s)):
                raise StopAsyncIteration
            with hold():
                frame = await asyncio.to_thread(self._read, recorded)
            if opening != self._openings:
                raise StopAsyncIteration
            self._next += 1
            if frame is None:
                self._damaged += 1
                continue
            return self._counted(frame)

    def release(self, iterator: "_Frames") -> None:
        """End an iteration."""
        if self._reader is not None and self._reader() is iterator:
            self._reader = None

    def _shows_still(self) -> bool:
        """Whether a live camera has nothing recorded to show for more than a frame's time."""
        playback = self._playback
        if not (playback.armed and playback.moves_stamps):
            return False
        current = playback.current
        if current is None or playback.passes <= self._pass:
            return True
        frames = current.parts.get(self._part, ())
        if not frames:
            return True
        # The frames of a pass that has just begun are counted from its first.
        following = self._next if playback.passes == self._pass + 1 else 0
        over = following == len(frames)
        return over or playback.due_in_s(frames[following].host_time_s) > 1.5 * self._period_s

    async def _still(self, opening: int) -> CameraFrame:
        if await self._closes_within(self._period_s) or opening != self._openings:
            raise StopAsyncIteration
        return self._counted(replace(self._still_picture(), host_time_s=asyncio.get_running_loop().time()))

    def _still_picture(self) -> CameraFrame:
        """The recorded frame with the lasers that are on; not every set of them was recorded."""
        lit = self._playback.lit
        more = (frame for lasers, frame in self._stills.items() if lit and (lasers is None or lasers >= lit))
        return self._stills.get(lit) or next(more, None) or next(iter(self._stills.values()))

    def _counted(self, frame: CameraFrame) -> CameraFrame:
        if self._playback.moves_stamps:
            frame = replace(frame, sequence=self._delivered + self._damaged, dropped=self._damaged)
        self._delivered += 1
        self._dropped = frame.dropped
        return frame

    async def _playing(self) -> tuple[RecordedFrame, ...] | None:
        """Frames of the recording whose turn it is; None if the camera was closed first."""
        self._playback.begin_unless_armed()
        if self._playback.passes <= self._pass:
            waiting = asyncio.ensure_future(self._playback.next_pass(self._pass))
            closing = asyncio.ensure_future(self._closed.wait())
            try:
                await asyncio.wait((waiting, closing), return_when=asyncio.FIRST_COMPLETED)
            finally:
                waiting.cancel()
                closing.cancel()
        current = self._playback.current
        if current is None or self._closed.is_set():
            return None
        if self._pass + 1 < self._playback.passes:
            # Another pass has begun before all of the last one was read.
            self._pass, self._next = self._playback.passes - 1, 0
        return current.parts.get(self._part, ())

    async def _closes_within(self, seconds: float) -> bool:
        if seconds <= 0:
            return self._closed.is_set()
        try:
            async with asyncio.timeout(seconds):
                await self._closed.wait()
        except TimeoutError:
            return False
        return True

    def _describe(self) -> CameraInfo:
        holders = [r for r in self._playback.recordings if r.parts.get(self._part)]
        if not holders:
            raise CameraError(f"{self._playback.recordings[0].path} holds no {self._part} frames to replay.")
        first = holders[0]
        frames = first.parts[self._part]
        stills: dict[frozenset[int] | None, CameraFrame] = {}
        for frame in (*first.parts.get("laser/off", ()), *frames):
            if frame.lasers in stills:
                continue
            with suppress(FrameError, OSError):
                encoding, data = _data(frame)
                size = frame.picture.at.size
                stills[frame.lasers] = CameraFrame(0, 0.0, frame.exposure_s, encoding, data, size)
        if not stills:
            raise CameraError(f"None of the {len(frames)} {self._part} frames in {first.path} can be read.")
        self._stills = stills
        still = next(iter(stills.values()))
        times = np.array([frame.host_time_s for frame in frames])
        gaps = np.diff(times[np.isfinite(times)])
        rate_hz = float(1.0 / np.median(gaps)) if len(gaps) and np.median(gaps) > 0 else None
        return CameraInfo(
            still.image_size,
            rate_hz,
            still.encoding,
            f"replay of {first.path.name}",
            live=False,
            ends=not self._playback.armed,
        )

    def _read(self, recorded: RecordedFrame) -> CameraFrame | None:
        assert self._info is not None or self._closed.is_set()
        try:
            encoding, data = _data(recorded)
        except (FrameError, OSError):
            return None
        info = self._info
        if info is not None and (encoding, recorded.picture.at.size) != (info.encoding, info.image_size):
            return None
        return CameraFrame(
            recorded.sequence,
            self._playback.stamp_s(recorded.host_time_s),
            recorded.exposure_s,
            encoding,
            data,
            recorded.picture.at.size,
            recorded.dropped + self._damaged,
        )

    def _give_up(self, opening: int) -> None:
        if opening == self._openings:
            self._state = CameraState.CLOSED

    def _require_open(self) -> None:
        if self._info is None:
            raise TransitionError("The camera is not open: open it first.")

    def _is_read(self) -> bool:
        if self._reader is None or self._reader() is None:
            return False
        # The traceback of a task that failed can keep its iterator alive for long, and nobody reads on.
        task = None if self._owner is None else self._owner()
        return self._owner is None or (task is not None and not task.done())


class _Frames(AsyncIterator[CameraFrame]):
    """One iteration; over when closed, or when nobody holds it any more."""

    def __init__(self, camera: ReplayCamera, opening: int) -> None:
        self._camera = camera
        self._opening = opening

    async def __anext__(self) -> CameraFrame:
        return await self._camera.take(self, self._opening)

    async def aclose(self) -> None:
        """End the iteration."""
        self._camera.release(self)


def _data(recorded: RecordedFrame) -> tuple[Encoding, bytes]:
    encoding = recorded.picture.at.encoding
    if encoding != "png":
        data = recorded.picture.raw_bytes()
        return encoding, data
    image = read_image(recorded.picture)
    return ("gray8" if image.ndim == 2 else "bgr8"), image.tobytes()
