"""What every camera keeps to. A new kind joins by a maker in `MAKERS`; none may leave a test out.

A maker is given an empty folder, and yields a `CameraUnderTest` for as long as the camera is needed.
"""

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.integration.mjpeg_server import MjpegServer
from tests.integration.rtsp_server import RtspServer, h264_stream, jpeg_stream
from tests.unit.devices.cameras.fake_usb import FakeCapture, FakeKernel
from tests.unit.devices.cameras.pictures import SIZE, make_images, make_jpegs
from tests.unit.recording.recorded_passes import write_recording
from tests.unit.recording.sample_captures import SIZE as RECORDED_SIZE
from twinline.devices.camera import Camera, CameraFrame, CameraInfo, CameraState
from twinline.devices.cameras.opening import open_camera
from twinline.devices.cameras.settings import CameraSettings
from twinline.devices.cameras.threaded import ThreadedCamera
from twinline.devices.cameras.uvc import UvcSource
from twinline.devices.cameras.v4l2_controls import V4l2Controls
from twinline.devices.replay.camera import ReplayCamera
from twinline.devices.replay.playback import open_playback
from twinline.devices.simulator.camera import SimulatedCamera
from twinline.devices.simulator.machine import ideal_rig
from twinline.devices.simulator.renderer import RoomLight
from twinline.devices.simulator.scenes import Scene
from twinline.devices.simulator.workspace import Workspace
from twinline.devices.simulator.world import Material
from twinline.errors import ControlError, DeviceError, TransitionError

# Long enough for the slowest machine; only a camera that hangs ever waits for it.
PATIENCE_S = 60.0


@dataclass(frozen=True)
class CameraUnderTest:
    """A camera that has not been opened.

    Attributes
    ----------
    image_size : (int, int)
        What it has to say.
    frames
        How many it has; None if there is no end to them.
    """

    camera: Camera
    image_size: tuple[int, int]
    frames: int | None = None


class RollingMachine:
    """A cart that rolls evenly with both lasers on."""

    def cart_mm(self, host_time_s: float) -> float:
        return 20.0 * host_time_s % 100.0

    def slide_mm(self, host_time_s: float) -> float:
        return 0.0

    def lasers(self, host_time_s: float) -> frozenset[int]:
        return frozenset({1, 2})


Maker = Callable[[Path], AbstractContextManager[CameraUnderTest]]


@contextmanager
def folder(path: Path) -> Iterator[CameraUnderTest]:
    write_pictures(path, 12)
    yield CameraUnderTest(open_camera(CameraSettings(str(path), paced=False)), SIZE, frames=12)


@contextmanager
def paced_folder(path: Path) -> Iterator[CameraUnderTest]:
    write_pictures(path, 12)
    yield CameraUnderTest(open_camera(CameraSettings(str(path), rate_hz=100.0, queue_frames=20)), SIZE, frames=12)


@contextmanager
def video(path: Path) -> Iterator[CameraUnderTest]:
    writer = cv2.VideoWriter(str(path / "pass.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 25.0, SIZE)
    for image in make_images(15):
        writer.write(image)
    writer.release()
    yield CameraUnderTest(open_camera(CameraSettings(str(path / "pass.mp4"), paced=False)), SIZE, frames=15)


@contextmanager
def mjpeg(_: Path) -> Iterator[CameraUnderTest]:
    with MjpegServer(make_jpegs(6)) as server:
        yield CameraUnderTest(open_camera(server.url), SIZE)


@contextmanager
def rtsp_jpeg(_: Path) -> Iterator[CameraUnderTest]:
    with RtspServer(jpeg_stream(make_jpegs(6)), rate_hz=50.0) as server:
        yield CameraUnderTest(open_camera(server.url), SIZE)


@contextmanager
def rtsp_h264(_: Path) -> Iterator[CameraUnderTest]:
    with RtspServer(h264_stream(make_images(10)), rate_hz=50.0) as server:
        yield CameraUnderTest(open_camera(server.url), SIZE)


@contextmanager
def usb(path: Path) -> Iterator[CameraUnderTest]:
    device = path / "video0"
    device.touch()
    controls = V4l2Controls(device, FakeKernel().ioctl)
    pictures = make_jpegs(6)

    def source(settings: CameraSettings, clock: Callable[[], float]) -> UvcSource:
        return UvcSource(settings, clock, open_capture=lambda number: FakeCapture(pictures), controls=controls)

    yield CameraUnderTest(ThreadedCamera(CameraSettings("uvc:0"), source), SIZE)


@contextmanager
def replay(path: Path) -> Iterator[CameraUnderTest]:
    recording = write_recording(path / "laser.mcap", 15)
    yield CameraUnderTest(ReplayCamera(open_playback(recording, speed=20.0)), RECORDED_SIZE, frames=15)


@contextmanager
def simulated(_: Path) -> Iterator[CameraUnderTest]:
    rig = ideal_rig().cropped(SIZE)
    scene = Scene("bed", (), Material((0.7, 0.7, 0.7), 0.05))
    workspace = Workspace(scene, rig, RoomLight((60.0, 60.0, 60.0)), seed=3)
    yield CameraUnderTest(SimulatedCamera(workspace, RollingMachine(), rate_hz=50.0), SIZE)


MAKERS: dict[str, Maker] = {
    "folder": folder,
    "paced folder": paced_folder,
    "video": video,
    "MJPEG over HTTP": mjpeg,
    "RTSP with JPEG": rtsp_jpeg,
    "RTSP with H.264": rtsp_h264,
    "USB": usb,
    "simulated": simulated,
    "replay": replay,
}


def write_pictures(path: Path, count: int) -> None:
    for number, jpeg in enumerate(make_jpegs(count)):
        (path / f"frame{number}.jpg").write_bytes(jpeg)


@pytest.fixture(params=list(MAKERS))
async def under_test(request: pytest.FixtureRequest, tmp_path: Path) -> AsyncIterator[CameraUnderTest]:
    with MAKERS[request.param](tmp_path) as made:
        async with asyncio.timeout(PATIENCE_S):
            yield made
            await made.camera.close()


@pytest.fixture
def camera(under_test: CameraUnderTest) -> Camera:
    return under_test.camera


async def take(camera: Camera, count: int) -> list[CameraFrame]:
    taken = []
    async for frame in camera.frames():
        taken.append(frame)
        if len(taken) == count:
            break
    return taken


def losses(frames: list[CameraFrame]) -> list[tuple[int, int]]:
    """Of each pair of neighbours: numbers that are missing between them, and growth of the drop counter."""
    pairs = pairwise(frames)
    return [(b.sequence - a.sequence - 1, b.dropped - a.dropped) for a, b in pairs]


class TestOpening:
    async def test_it_says_what_it_will_send(self, under_test: CameraUnderTest) -> None:
        info = await under_test.camera.open()
        assert info.image_size == under_test.image_size
        assert info.encoding in {"jpeg", "gray8", "bgr8"}
        assert info.rate_hz is None or info.rate_hz > 0
        assert info.name
        assert info.ends == (under_test.frames is not None)

    async def test_opening_twice_changes_nothing(self, camera: Camera) -> None:
        assert await camera.open() == await camera.open()
        assert len(await take(camera, 3)) == 3

    async def test_nothing_works_before_opening_and_after_closing(self, camera: Camera) -> None:
        for _ in range(2):
            assert camera.status().state == CameraState.CLOSED
            with pytest.raises(TransitionError, match="not open"):
                camera.frames()
            with pytest.raises(TransitionError, match="not open"):
                await camera.controls()
            with pytest.raises(TransitionError, match="not open"):
                await camera.set_control("gain", 1.0)
            await camera.open()
            await camera.close()

    async def test_closed_and_opened_again_it_counts_from_the_beginning(self, camera: Camera) -> None:
        await camera.open()
        await take(camera, 5)
        await camera.close()
        await camera.open()
        assert camera.status().delivered == 0
        frames = await take(camera, 2)
        assert frames[0].dropped == 0
        assert camera.status().delivered == 2

    async def test_opening_can_be_cancelled_and_tried_again(self, camera: Camera) -> None:
        opening = asyncio.create_task(camera.open())
        await asyncio.sleep(0)
        opening.cancel()
        with pytest.raises(asyncio.CancelledError):
            await opening
        assert camera.status().state == CameraState.CLOSED
        await camera.open()
        assert len(await take(camera, 2)) == 2

    async def test_closing_while_it_opens_ends_the_opening(self, camera: Camera) -> None:
        opening = asyncio.create_task(camera.open())
        await asyncio.sleep(0)
        await camera.close()
        # A camera that was faster than the closing has been opened, and closed.
        (outcome,) = await asyncio.gather(opening, return_exceptions=True)
        assert isinstance(outcome, DeviceError | CameraInfo)
        assert camera.status().state == CameraState.CLOSED

    async def test_closing_twice_or_unopened_does_nothing(self, camera: Camera) -> None:
        await camera.close()
        await camera.open()
        await camera.close()
        await camera.close()


class TestFrames:
    async def test_every_frame_is_what_was_announced(self, camera: Camera) -> None:
        info = await camera.open()
        for frame in await take(camera, 6):
            assert (frame.encoding, frame.image_size) == (info.encoding, info.image_size)
            assert isinstance(frame.data, bytes)
            width, height = info.image_size
            if frame.encoding == "jpeg":
                image = cv2.imdecode(np.frombuffer(frame.data, np.uint8), cv2.IMREAD_UNCHANGED)
                assert image is not None
                assert image.shape[:2] == (height, width)
            else:
                assert len(frame.data) == width * height * (3 if frame.encoding == "bgr8" else 1)

    async def test_neighbours_are_different_pictures(self, camera: Camera) -> None:
        await camera.open()
        frames = await take(camera, 5)
        assert all(a.data != b.data for a, b in pairwise(frames))

    async def test_times_ascend_and_lie_in_the_past_of_a_live_camera(self, camera: Camera) -> None:
        info = await camera.open()
        times_s = []
        async for frame in camera.frames():
            times_s.append(frame.host_time_s)
            if info.live and not info.ends:
                assert frame.host_time_s <= asyncio.get_running_loop().time()
            if len(times_s) == 6:
                break
        assert all(a < b for a, b in pairwise(times_s))

    async def test_what_is_missing_between_two_numbers_was_counted(self, camera: Camera) -> None:
        await camera.open()
        frames = await take(camera, 8)
        assert all(missing == counted >= 0 for missing, counted in losses(frames))

    async def test_a_slow_reader_loses_frames_of_a_live_camera_and_none_of_another(
        self, under_test: CameraUnderTest
    ) -> None:
        camera = under_test.camera
        info = await camera.open()
        iterator = camera.frames()
        frames = [await anext(iterator)]
        while under_test.frames is None and not camera.status().dropped:  # noqa: ASYNC110 - losses have no event
            await asyncio.sleep(0.01)
        frames += [await anext(iterator) for _ in range(9)]
        assert [missing for missing, _ in losses(frames)] == [counted for _, counted in losses(frames)]
        assert bool(frames[-1].dropped) == (info.live and not info.ends)
        assert camera.status().delivered == 10

    async def test_after_an_end_comes_no_frame_and_no_error(self, under_test: CameraUnderTest) -> None:
        camera = under_test.camera
        await camera.open()
        if under_test.frames is None:
            # There is no end to reach: the one way to end is to be closed.
            iterator = camera.frames()
            await anext(iterator)
            await camera.close()
        else:
            frames = [frame async for frame in camera.frames()]
            assert len(frames) == under_test.frames
            assert camera.status().state == CameraState.ENDED
            iterator = camera.frames()
        assert [frame async for frame in iterator] == []

    async def test_a_second_reader_is_refused_while_the_first_one_reads(self, camera: Camera) -> None:
        await camera.open()
        first = camera.frames()
        await anext(first)
        with pytest.raises(TransitionError, match="Somebody else reads"):
            camera.frames()
        assert (await anext(first)).sequence > 0

    async def test_after_break_somebody_else_can_read_on(self, camera: Camera) -> None:
        info = await camera.open()
        before = await take(camera, 3)
        after = await take(camera, 3)
        assert after[0].sequence > before[-1].sequence
        assert after[0].dropped == before[-1].dropped or not info.live
        if info.ends:
            assert after[0].sequence == before[-1].sequence + 1

    async def test_closing_ends_the_waiting_of_a_reader(self, camera: Camera) -> None:
        await camera.open()
        ended = asyncio.create_task(read_to_the_end(camera))
        await asyncio.sleep(0)
        await camera.close()
        await ended

    async def test_a_cancelled_reader_leaves_the_camera_usable(self, camera: Camera) -> None:
        await camera.open()
        reading = asyncio.create_task(read_to_the_end(camera))
        await asyncio.sleep(0)
        reading.cancel()
        await asyncio.gather(reading, return_exceptions=True)
        assert len(await take(camera, 2)) == 2


async def read_to_the_end(camera: Camera) -> None:
    async for _ in camera.frames():
        await asyncio.sleep(0)


class TestControls:
    async def test_each_lies_within_its_limits_and_takes_what_it_is_given(self, camera: Camera) -> None:
        await camera.open()
        for name, control in (await camera.controls()).items():
            assert control.low <= control.value <= control.high
            wanted = (control.low + control.high) / 2
            await camera.set_control(name, wanted)
            now = (await camera.controls())[name]
            assert abs(now.value - wanted) <= 0.01 * (control.high - control.low)

    async def test_values_outside_the_limits_change_nothing(self, camera: Camera) -> None:
        await camera.open()
        before = await camera.controls()
        for name, control in before.items():
            for value in (control.low - 1, control.high + 1, float("nan")):
                with pytest.raises(ControlError, match=name):
                    await camera.set_control(name, value)
        assert await camera.controls() == before

    async def test_a_control_that_it_has_not_is_refused_by_name(self, camera: Camera) -> None:
        await camera.open()
        with pytest.raises(ControlError, match="'moustache'"):
            await camera.set_control("moustache", 1.0)
