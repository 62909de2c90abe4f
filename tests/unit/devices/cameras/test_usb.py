"""USB cameras, on a camera made of memory."""

import asyncio
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.unit.devices.cameras.fake_usb import EXPOSURE, EXPOSURE_AUTO, GAIN, FakeCapture, FakeKernel
from tests.unit.devices.cameras.pictures import SIZE, make_images, make_jpegs
from twinline.arrays import ByteArray
from twinline.devices.camera import CameraState
from twinline.devices.cameras.opening import open_camera
from twinline.devices.cameras.settings import CameraSettings
from twinline.devices.cameras.source import Lost, Picture
from twinline.devices.cameras.threaded import ThreadedCamera
from twinline.devices.cameras.uvc import UvcSource
from twinline.devices.cameras.v4l2_controls import V4l2Controls
from twinline.errors import CameraError, ControlError


def source_of(
    capture: FakeCapture, *, settings: CameraSettings | None = None, controls: V4l2Controls | None = None
) -> UvcSource:
    return UvcSource(
        settings or CameraSettings("uvc:0"), lambda: 0.0, open_capture=lambda number: capture, controls=controls
    )


def controls_of(kernel: FakeKernel, folder: Path) -> V4l2Controls:
    device = folder / "video0"
    device.touch()
    return V4l2Controls(device, kernel.ioctl)


def read(source: UvcSource, count: int) -> list[Picture | Lost | None]:
    return [source.read() for _ in range(count)]


class TestPictures:
    def test_jpeg_is_handed_on_byte_for_byte(self) -> None:
        jpegs = make_jpegs(3)
        source = source_of(FakeCapture(jpegs))
        info = source.connect()
        assert (info.encoding, info.image_size, info.rate_hz) == ("jpeg", SIZE, 100.0)
        assert [picture.data for picture in read(source, 3) if isinstance(picture, Picture)] == jpegs

    @pytest.mark.parametrize(("colour", "encoding"), [(True, "bgr8"), (False, "gray8")])
    def test_pixels_are_handed_on_row_by_row(self, colour: bool, encoding: str) -> None:
        images: Sequence[ByteArray] = [image if colour else image[:, :, 2] for image in make_images(3)]
        source = source_of(FakeCapture(images))
        assert source.connect().encoding == encoding
        taken = [picture.data for picture in read(source, 3) if isinstance(picture, Picture)]
        assert taken == [image.tobytes() for image in images] or taken == [images[n].tobytes() for n in (1, 2, 0)]

    def test_a_camera_begins_with_broken_pictures_and_these_are_passed_over(self) -> None:
        jpegs = make_jpegs(3)
        source = source_of(FakeCapture([jpegs[0][:200], b"\xff\xd8\xff\xd9", *jpegs[1:]]))
        source.connect()
        picture = source.read()
        assert isinstance(picture, Picture)
        assert picture.data == jpegs[1]

    def test_a_broken_picture_on_the_way_is_lost_and_the_next_one_is_not(self) -> None:
        jpegs = make_jpegs(3)
        other_size = make_jpegs(1, size=(64, 48))
        source = source_of(FakeCapture([jpegs[0], jpegs[1][:-10], *other_size, jpegs[2]]))
        source.connect()
        assert [type(item) for item in read(source, 4)] == [Picture, Lost, Lost, Picture]

    def test_what_was_asked_for_is_asked_of_the_camera(self) -> None:
        capture = FakeCapture(make_jpegs(1))
        settings = CameraSettings("uvc:0", image_size=(1280, 720), rate_hz=60.0, stall_s=2.5)
        source_of(capture, settings=settings).connect()
        assert capture.settings[cv2.CAP_PROP_FRAME_WIDTH] == 1280
        assert capture.settings[cv2.CAP_PROP_FRAME_HEIGHT] == 720
        assert capture.settings[cv2.CAP_PROP_FPS] == 60.0
        assert capture.settings[cv2.CAP_PROP_READ_TIMEOUT_MSEC] == 2500.0

    def test_the_driver_s_stamp_comes_along(self) -> None:
        source = source_of(FakeCapture(make_jpegs(2)))
        source.connect()
        stamps_s = [picture.camera_time_s for picture in read(source, 4) if isinstance(picture, Picture)]
        np.testing.assert_allclose(np.diff(np.array(stamps_s, float)), 0.01)


class TestFailures:
    def test_a_camera_that_cannot_be_opened_is_named(self) -> None:
        capture = FakeCapture(make_jpegs(1))
        capture.release()
        with pytest.raises(CameraError, match="USB camera 0 cannot be opened: see whether"):
            source_of(capture).connect()

    def test_a_camera_that_sends_nothing_is_told_from_one_that_is_missing(self) -> None:
        with pytest.raises(CameraError, match="sends no usable pictures"):
            source_of(FakeCapture([None])).connect()

    def test_a_device_that_is_not_there_is_named_with_those_that_are(self) -> None:
        with pytest.raises(CameraError, match="There is no USB camera /dev/video97: "):
            asyncio.run(open_camera("uvc:97").open())

    async def test_pulled_out_and_plugged_in_it_goes_on(self) -> None:
        jpegs = make_jpegs(4)
        captures = [FakeCapture([*jpegs, None, None, None]), FakeCapture(jpegs)]

        def source(settings: CameraSettings, clock: object) -> UvcSource:
            left = iter(captures)
            return UvcSource(
                settings, asyncio.get_running_loop().time, open_capture=lambda _: next(left), controls=None
            )

        camera = ThreadedCamera(CameraSettings("uvc:0", retry_s=(0.01, 0.02)), source)
        await camera.open()
        taken = 0
        async for _ in camera.frames():
            taken += 1
            if taken == 10:
                break
        status = camera.status()
        await camera.close()
        assert (status.state, status.reconnections) == (CameraState.STREAMING, 1)
        assert captures[0].released.is_set()
        assert captures[1].released.is_set()


class TestControls:
    def test_they_are_told_with_limits_and_units(self, tmp_path: Path) -> None:
        controls = controls_of(FakeKernel(), tmp_path).read()
        assert set(controls) == {"exposure", "gain"}
        exposure = controls["exposure"]
        assert (exposure.low, exposure.high, exposure.unit) == (0.1, 500.0, "ms")
        assert exposure.value == pytest.approx(15.7)

    def test_setting_the_exposure_turns_its_automatic_off(self, tmp_path: Path) -> None:
        kernel = FakeKernel()
        controls_of(kernel, tmp_path).write("exposure", 8.0)
        assert kernel.controls[EXPOSURE][2] == 80
        assert kernel.controls[EXPOSURE_AUTO][2] == 1

    def test_the_exposure_stands_in_every_frame(self, tmp_path: Path) -> None:
        source = source_of(FakeCapture(make_jpegs(2)), controls=controls_of(FakeKernel(), tmp_path))
        source.connect()
        source.set_control("exposure", 4.0)
        source.read()
        picture = source.read()
        assert isinstance(picture, Picture)
        assert picture.exposure_s == pytest.approx(0.004)

    def test_a_refusal_names_device_control_and_value(self, tmp_path: Path) -> None:
        kernel = FakeKernel(stuck=frozenset({GAIN}))
        with pytest.raises(CameraError, match=r"video0 refuses gain 20 \(Device or resource busy\)"):
            controls_of(kernel, tmp_path).write("gain", 20.0)

    async def test_a_camera_without_controls_says_so(self) -> None:
        camera = ThreadedCamera(CameraSettings("uvc:0"), lambda *_: source_of(FakeCapture(make_jpegs(2))))
        await camera.open()
        assert await camera.controls() == {}
        with pytest.raises(
            ControlError, match="USB camera 0 has no control 'gain': nothing can be set on it from here"
        ):
            await camera.set_control("gain", 1.0)
        await camera.close()
