"""Connecting, losing the connection, and connecting again, over a source that does as it is told."""

import asyncio
import threading
from collections.abc import Sequence
from itertools import islice

import pytest

from twinline.devices.camera import CameraFrame, CameraInfo, CameraState
from twinline.devices.cameras.settings import CameraSettings
from twinline.devices.cameras.source import Lost, NoControls, Picture
from twinline.devices.cameras.threaded import ThreadedCamera, retry_pauses_s
from twinline.errors import CameraError, DeviceError

INFO = CameraInfo((2, 1), 25.0, "gray8", name="script")
SETTINGS = CameraSettings("script", retry_s=(0.001, 0.002), latency_s=0.030, exposure_s=0.008)
LOST = CameraError("script is gone: look for it.", code="camera-disconnected")

Step = Picture | Lost | Exception | None


class ScriptSource(NoControls):
    """Follows a script: one entry per connection, what to announce (or fail with) and what to deliver.

    At the end of the last connection's script it waits to be interrupted.
    """

    def __init__(self, *script: tuple[CameraInfo | Exception, Sequence[Step]]) -> None:
        self.script = script
        self.connections = 0
        self.disconnections = 0
        self.interrupted = threading.Event()
        self._steps: list[Step] = []

    def connect(self) -> CameraInfo:
        announced, steps = self.script[min(self.connections, len(self.script) - 1)]
        self.connections += 1
        self._steps = list(steps)
        if isinstance(announced, Exception):
            raise announced
        return announced

    def read(self) -> Picture | Lost | None:
        if not self._steps:
            self.interrupted.wait()
            raise CameraError("interrupted")
        step = self._steps.pop(0)
        if isinstance(step, Exception):
            raise step
        return step

    def interrupt(self) -> None:
        self.interrupted.set()

    def disconnect(self) -> None:
        self.disconnections += 1


def picture(number: int, *, stamp_s: float | None = None) -> Picture:
    return Picture(bytes([number, number]), 100.0 + number / 25, stamp_s)


def camera_over(source: ScriptSource, settings: CameraSettings = SETTINGS) -> ThreadedCamera:
    return ThreadedCamera(settings, lambda *_: source)


async def reading(camera: ThreadedCamera, count: int) -> tuple[list[CameraFrame], "asyncio.Task[list[CameraFrame]]"]:
    """A reader that waits for its frames already, so that none comes too early for it."""
    taken: list[CameraFrame] = []

    async def read() -> list[CameraFrame]:
        async for frame in camera.frames():
            taken.append(frame)
            if len(taken) == count:
                break
        return taken

    task = asyncio.create_task(read())
    await asyncio.sleep(0)
    return taken, task


class GatedSource(ScriptSource):
    """The same, but nothing is delivered before somebody reads."""

    def __init__(self, *script: tuple[CameraInfo | Exception, Sequence[Step]]) -> None:
        super().__init__(*script)
        self.gate = threading.Event()

    def read(self) -> Picture | Lost | None:
        self.gate.wait()
        return super().read()

    def interrupt(self) -> None:
        self.gate.set()
        super().interrupt()


async def frames_of(source: GatedSource, count: int, settings: CameraSettings = SETTINGS) -> list[CameraFrame]:
    camera = camera_over(source, settings)
    await camera.open()
    _, task = await reading(camera, count)
    source.gate.set()
    try:
        return await task
    finally:
        await camera.close()


async def test_frames_carry_the_time_of_the_middle_of_their_exposure() -> None:
    (frame,) = await frames_of(GatedSource((INFO, [picture(0)])), 1)
    assert frame.host_time_s == pytest.approx(100.0 - 0.030 - 0.004)
    assert frame.exposure_s == 0.008
    assert (frame.encoding, frame.image_size, frame.data) == ("gray8", (2, 1), b"\0\0")


async def test_after_a_lost_connection_it_connects_until_it_works_and_goes_on_counting() -> None:
    source = GatedSource(
        (INFO, [picture(0), picture(1), LOST]), (LOST, []), (LOST, []), (INFO, [picture(9), picture(10)])
    )
    frames = await frames_of(source, 4)
    assert [frame.sequence for frame in frames] == [0, 1, 2, 3]
    assert [frame.data[0] for frame in frames] == [0, 1, 9, 10]
    assert source.connections == 4
    assert source.disconnections == source.connections


async def test_the_camera_s_clock_of_the_last_connection_is_forgotten() -> None:
    before, after = Picture(b"\0\0", 110.0, 10.0), Picture(b"\0\0", 112.0, 10.5)
    frames = await frames_of(GatedSource((INFO, [before, LOST]), (INFO, [after])), 2, CameraSettings("script"))
    assert [frame.host_time_s for frame in frames] == [110.0, 112.0]


async def test_every_connection_that_worked_makes_the_next_pause_short_again() -> None:
    script: list[tuple[CameraInfo | Exception, Sequence[Step]]] = [
        (INFO, [picture(number), LOST]) for number in range(24)
    ]
    # Doubled each time, the pauses would come to two hours.
    frames = await frames_of(GatedSource(*script), 24, CameraSettings("script", retry_s=(0.001, 1e6)))
    assert frames[-1].sequence == 23


async def test_while_it_waits_its_status_says_why() -> None:
    camera = camera_over(ScriptSource((INFO, [LOST]), (LOST, [])))
    await camera.open()
    while camera.status().state != CameraState.WAITING:  # noqa: ASYNC110 - the state has no event
        await asyncio.sleep(0)
    assert camera.status().detail == LOST.detail
    await camera.close()
    assert camera.status().state == CameraState.CLOSED


async def test_the_first_connection_is_tried_once_and_its_failure_told() -> None:
    source = ScriptSource((LOST, []))
    camera = camera_over(source)
    with pytest.raises(CameraError, match="look for it"):
        await camera.open()
    assert source.connections == 1
    assert camera.status().state == CameraState.CLOSED


async def test_a_camera_that_comes_back_with_another_picture_size_is_refused_with_both_sizes() -> None:
    other = CameraInfo((4, 1), 25.0, "gray8", name="script")
    source = GatedSource((INFO, [picture(0), LOST]), (other, [picture(1)]))
    with pytest.raises(DeviceError, match=r"script sends 4 x 1 px in gray8 .* 2 x 1 px in gray8"):
        await frames_of(source, 2)


async def test_broken_frames_and_gaps_in_the_stamps_are_each_counted_once() -> None:
    steps: list[Step] = [picture(number, stamp_s=number / 25) for number in range(10)]
    # Frame 10 came broken, 11 and 12 not at all, 13 is sound; of 14 and 15 only the gap is seen.
    steps += [Lost("torn"), picture(13, stamp_s=13 / 25), picture(16, stamp_s=16 / 25)]
    frames = await frames_of(GatedSource((INFO, steps)), 12, CameraSettings("script", queue_frames=32))
    assert [frame.dropped for frame in frames[-3:]] == [0, 3, 5]
    assert [frame.sequence for frame in frames[-3:]] == [9, 13, 16]


async def test_a_mistake_in_a_source_reaches_the_reader_and_ends_the_thread() -> None:
    source = GatedSource((INFO, [picture(0), ZeroDivisionError("a mistake")]))
    camera = camera_over(source)
    await camera.open()
    taken, task = await reading(camera, 5)
    source.gate.set()
    with pytest.raises(ZeroDivisionError):
        await task
    assert len(taken) == 1
    assert camera.status().state == CameraState.ENDED
    await camera.close()


@pytest.mark.parametrize("ready", [True, False])
async def test_no_thread_is_left_after_closing(ready: bool) -> None:
    source = ScriptSource((INFO, [])) if ready else HangingSource()
    camera = camera_over(source)
    opening = asyncio.create_task(camera.open())
    await asyncio.sleep(0)
    if ready:
        await opening
    await camera.close()
    outcome = (await asyncio.gather(opening, return_exceptions=True))[0]
    assert ready or isinstance(outcome, CameraError)
    assert not [thread for thread in threading.enumerate() if thread.name == "camera"]


class HangingSource(ScriptSource):
    """A camera that never finishes connecting."""

    def connect(self) -> CameraInfo:
        self.interrupted.wait()
        raise CameraError("interrupted")


async def test_two_that_open_at_the_same_time_get_the_same_camera() -> None:
    source = ScriptSource((INFO, []))
    camera = camera_over(source)
    assert tuple(await asyncio.gather(camera.open(), camera.open())) == (INFO, INFO)
    assert source.connections == 1
    await camera.close()


def test_a_loop_that_goes_away_takes_the_thread_with_it() -> None:
    source = ScriptSource((INFO, [picture(number) for number in range(200)]), (LOST, []))
    loop = asyncio.new_event_loop()
    camera = camera_over(source)
    loop.run_until_complete(camera.open())
    loop.close()
    source.interrupt()
    for thread in threading.enumerate():
        if thread.name == "camera":
            thread.join()


def test_pauses_double_up_to_the_longest() -> None:
    assert list(islice(retry_pauses_s(0.25, 3.0), 6)) == [0.25, 0.5, 1.0, 2.0, 3.0, 3.0]
