"""The simulated camera against a machine whose movement is a formula, under virtual time."""

import asyncio
from collections.abc import Coroutine
from dataclasses import replace
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
import pytest

from twinline.arrays import ByteArray
from twinline.devices.camera import CameraFrame, CameraState
from twinline.devices.simulator.camera import CameraFaults, SimulatedCamera
from twinline.devices.simulator.machine import SimulatedRig, ideal_rig
from twinline.devices.simulator.renderer import RoomLight
from twinline.devices.simulator.scenes import Scene
from twinline.devices.simulator.workspace import Workspace
from twinline.devices.simulator.world import Material
from twinline.devices.virtual_time import run_virtual
from twinline.errors import CameraError, ControlError, SettingsError, TransitionError

SIZE = (160, 300)
SPEED_MM_S = 20.0


class RollingMachine:
    """A cart that rolls evenly with both lasers on, from host time 1000 s."""

    def __init__(self) -> None:
        self.asked_s: list[float] = []
        self.on = frozenset({1, 2})

    def cart_mm(self, host_time_s: float) -> float:
        self.asked_s.append(host_time_s)
        return SPEED_MM_S * (host_time_s - 1000.0)

    def slide_mm(self, host_time_s: float) -> float:
        return 0.0

    def lasers(self, host_time_s: float) -> frozenset[int]:
        return self.on


def workspace(seed: int = 3) -> Workspace:
    rig: SimulatedRig = ideal_rig().cropped(SIZE)
    return Workspace(Scene("bed", (), Material((0.7, 0.7, 0.7), 0.05)), rig, RoomLight((60.0, 60.0, 60.0)), seed)


def camera_of(machine: RollingMachine | None = None, **options: Any) -> SimulatedCamera:
    return SimulatedCamera(workspace(), machine or RollingMachine(), **options)


async def take(camera: SimulatedCamera, count: int) -> list[CameraFrame]:
    taken: list[CameraFrame] = []
    async for frame in camera.frames():
        taken.append(frame)
        if len(taken) == count:
            break
    return taken


def run(main: Coroutine[Any, Any, None]) -> None:
    run_virtual(main)


def picture(frame: CameraFrame) -> ByteArray:
    image = cv2.imdecode(np.frombuffer(frame.data, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return np.asarray(image, dtype=np.uint8)


def test_frames_come_at_the_stated_rate_and_show_the_machine_in_mid_exposure() -> None:
    async def main() -> None:
        machine = RollingMachine()
        camera = camera_of(machine)
        info = await camera.open()
        assert (info.image_size, info.rate_hz, info.encoding, info.live) == (SIZE, 25.0, "jpeg", True)
        frames = await take(camera, 6)
        await camera.close()
        times = np.array([frame.host_time_s for frame in frames])
        np.testing.assert_allclose(np.diff(times), 0.04, atol=1e-9)
        assert [frame.sequence for frame in frames] == list(range(frames[0].sequence, frames[0].sequence + 6))
        assert set(times) <= set(machine.asked_s)
        for frame in frames:
            cart = machine.cart_mm(frame.host_time_s)
            expected = camera._workspace.renderer.render(frame.sequence, cart, machine.on)
            _, data = cv2.imencode(".jpg", expected, [cv2.IMWRITE_JPEG_QUALITY, 80])
            assert frame.data == data.tobytes()

    run(main())


def test_virtual_time_stands_still_while_a_picture_is_made() -> None:
    async def main() -> None:
        loop = asyncio.get_running_loop()
        camera = camera_of()
        await camera.open()
        start = loop.time()
        frames = await take(camera, 10)
        # The tenth frame is ready half a period, nine periods, half an exposure and the read-out after the start.
        assert loop.time() - start == pytest.approx(0.02 + 0.36 + 0.004 + 0.012, abs=1e-6)
        assert frames[-1].dropped == 0
        await camera.close()

    run(main())


def test_pixels_are_delivered_without_compression_on_demand() -> None:
    async def main() -> None:
        camera = camera_of(encoding="bgr8")
        info = await camera.open()
        frame = (await take(camera, 1))[0]
        await camera.close()
        assert info.encoding == frame.encoding == "bgr8"
        assert len(frame.data) == 3 * SIZE[0] * SIZE[1]

    run(main())


def test_exposure_and_gain_change_the_picture_and_the_quality_its_size() -> None:
    async def main() -> None:
        camera = camera_of()
        await camera.open()
        levels, sizes = {}, {}
        for name, value in (("exposure", 8.0), ("exposure", 16.0), ("gain", 6.0206), ("quality", 30.0)):
            await camera.set_control(name, value)
            frame = (await take(camera, 1))[0]
            levels[name, value] = picture(frame)[:40].mean()
            sizes[name, value] = len(frame.data)
            assert (await camera.controls())[name].value == value
        await camera.close()
        base = levels["exposure", 8.0]
        assert levels["exposure", 16.0] == pytest.approx(2 * base, rel=0.03)
        assert levels["gain", 6.0206] == pytest.approx(4 * base, rel=0.03)
        assert sizes["quality", 30.0] < 0.7 * sizes["gain", 6.0206]

    run(main())


def test_a_higher_frame_rate_shortens_an_exposure_that_no_longer_fits() -> None:
    async def main() -> None:
        camera = camera_of()
        await camera.open()
        await camera.set_control("exposure", 30.0)
        await camera.set_control("frame_rate", 100.0)
        assert (await camera.controls())["exposure"].value == pytest.approx(9.5)
        frames = await take(camera, 4)
        assert np.diff([frame.host_time_s for frame in frames])[1:] == pytest.approx(0.01)
        await camera.close()

    run(main())


@pytest.mark.parametrize(("name", "value", "words"), [("iris", 1.0, "exposure"), ("gain", 99.0, "between 0 and 30 dB")])
def test_a_control_that_does_not_exist_or_fit_changes_nothing(name: str, value: float, words: str) -> None:
    async def main() -> None:
        camera = camera_of()
        await camera.open()
        before = await camera.controls()
        with pytest.raises(ControlError, match=words):
            await camera.set_control(name, value)
        assert await camera.controls() == before
        await camera.close()

    run(main())


def test_lost_frames_are_counted_and_leave_gaps_in_the_numbers() -> None:
    async def main() -> None:
        camera = camera_of(faults=CameraFaults(lost_share=0.4))
        await camera.open()
        frames = await take(camera, 20)
        await camera.close()
        for before, after in pairwise(frames):
            missing = after.sequence - before.sequence - 1
            assert missing == after.dropped - before.dropped
            assert after.host_time_s - before.host_time_s == pytest.approx(0.04 * (missing + 1))
        assert 4 < frames[-1].dropped - frames[0].dropped < 30

    run(main())


def test_late_frames_arrive_late_with_the_time_of_their_exposure() -> None:
    async def main() -> None:
        loop = asyncio.get_running_loop()
        camera = camera_of(faults=CameraFaults(late_share=0.3, late_s=0.15))
        await camera.open()
        delays, times = [], []
        async for frame in camera.frames():
            delays.append(loop.time() - frame.host_time_s)
            times.append(frame.host_time_s)
            if len(times) == 15:
                break
        await camera.close()
        np.testing.assert_allclose(np.diff(times), 0.04, atol=1e-9)
        assert min(delays) == pytest.approx(0.016, abs=1e-6)
        assert max(delays) > 0.15

    run(main())


def test_a_camera_whose_cable_comes_out_waits_and_goes_on_when_it_is_in_again() -> None:
    async def main() -> None:
        camera = camera_of()
        await camera.open()
        frames = camera.frames()
        first = await anext(frames)
        camera.faults = CameraFaults(gone=True)
        waiting = asyncio.ensure_future(anext(frames))
        await asyncio.sleep(1.0)
        assert not waiting.done()
        assert camera.status().state is CameraState.WAITING
        assert "cable" in str(camera.status().detail)
        camera.faults = CameraFaults()
        second = await waiting
        assert second.host_time_s > first.host_time_s + 0.9
        assert second.sequence == first.sequence + 1 + second.dropped - first.dropped
        assert (camera.status().state, camera.status().reconnections) == (CameraState.STREAMING, 1)
        await camera.close()

    run(main())


def test_no_camera_at_all_is_said_when_opening() -> None:
    async def main() -> None:
        camera = camera_of(faults=CameraFaults(gone=True))
        with pytest.raises(CameraError, match="cable"):
            await camera.open()
        assert camera.status().state is CameraState.CLOSED
        with pytest.raises(TransitionError):
            camera.frames()

    run(main())


def test_a_dim_and_a_dead_laser_show_in_the_picture() -> None:
    async def main() -> None:
        camera = camera_of()
        await camera.open()
        healthy = picture((await take(camera, 1))[0])[..., 2].astype(int)
        camera.faults = replace(camera.faults, laser_power={1: 0.3, 2: 0.0})
        faulty = picture((await take(camera, 1))[0])[..., 2].astype(int)
        await camera.close()
        # Laser 1 is seen in the lower half of the picture, laser 2 in the upper.
        assert healthy[160:].max() > 150
        assert 60 < faulty[160:].max() < healthy[160:].max() - 60
        assert healthy[:140].max() > 150
        assert faulty[:140].max() < 70

    run(main())


def test_closing_ends_an_iteration_that_waits() -> None:
    async def main() -> None:
        camera = camera_of(rate_hz=0.5)
        await camera.open()
        frames = camera.frames()
        waiting = asyncio.ensure_future(anext(frames, None))
        await asyncio.sleep(0)
        await camera.close()
        assert await waiting is None
        await camera.close()

    run(main())


def test_nothing_is_rendered_while_nobody_looks() -> None:
    async def main() -> None:
        machine = RollingMachine()
        camera = camera_of(machine)
        await camera.open()
        await asyncio.sleep(2.0)
        assert machine.asked_s == []
        frame = (await take(camera, 1))[0]
        assert frame.dropped == 0
        assert frame.sequence >= 49
        await camera.close()

    run(main())


@pytest.mark.parametrize("options", [{"rate_hz": 0.0}, {"quality": 0}, {"encoding": "gray8"}])
def test_impossible_settings_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match="frames/s"):
        camera_of(**options)


@pytest.mark.parametrize("faults", [{"lost_share": 1.5}, {"late_s": -1.0}, {"laser_power": {1: -0.1}}])
def test_impossible_faults_are_refused(faults: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match="between 0 and"):
        CameraFaults(**faults)
