"""USB cameras (UVC), through OpenCV."""

import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np

from twinline.arrays import ByteArray
from twinline.devices.camera import CameraInfo, Control, Encoding
from twinline.devices.cameras.jpeg import START, is_whole_jpeg, jpeg_size
from twinline.devices.cameras.settings import CameraSettings
from twinline.devices.cameras.source import Lost, Picture
from twinline.devices.cameras.v4l2_controls import V4l2Controls
from twinline.errors import CameraError, SettingsError

_MJPG = float(cv2.VideoWriter.fourcc(*"MJPG"))
_GREY = float(cv2.VideoWriter.fourcc(*"GREY"))
_FIRST_PICTURES = 20
# A camera that is plugged in and silent makes each attempt wait as long as reading may wait.
_FAILURES_IN_A_ROW = 3


class Capture(Protocol):
    """The part of `cv2.VideoCapture` that is used."""

    def isOpened(self) -> bool: ...  # noqa: D102, N802 - OpenCV's names
    def set(self, propId: int, value: float) -> bool: ...  # noqa: D102
    def get(self, propId: int) -> float: ...  # noqa: D102
    def read(self) -> tuple[bool, Any]: ...  # noqa: D102
    def release(self) -> None: ...  # noqa: D102


class UvcSource:
    """One USB camera. On Linux its MJPEG pictures are handed on without decoding, and it has controls.

    Parameters
    ----------
    settings
        ``url`` is ``uvc:0`` or ``uvc:/dev/video0``; ``image_size``, ``rate_hz`` and ``stall_s`` are used.
    clock
        Tells host time.
    open_capture
        Opens the camera of that number.
    controls
        Its controls; None where the system offers none.
    """

    def __init__(
        self,
        settings: CameraSettings,
        clock: Callable[[], float],
        *,
        open_capture: Callable[[int], Capture],
        controls: V4l2Controls | None,
    ) -> None:
        self._settings = settings
        self._clock = clock
        self._number = camera_number(settings.url)
        self._open_capture = open_capture
        self._controls = controls
        self._capture: Capture | None = None
        self._encoding: Encoding = "bgr8"
        self._size = (0, 0)
        self._exposure_s: float | None = None
        self._first: Picture | None = None
        self._failures = 0

    def connect(self) -> CameraInfo:
        """See `FrameSource.connect`."""
        self._capture = capture = self._open_capture(self._number)
        if not capture.isOpened():
            raise CameraError(
                f"USB camera {self._number} cannot be opened: see whether it is plugged in, and whether another "
                "program has it."
            )
        self._configure(capture)
        self._exposure_s = self._read_exposure_s()
        self._failures = 0
        image = self._first_image(capture)
        raw_jpeg = _as_jpeg(image)
        if raw_jpeg is None and not (image.ndim == 2 and capture.get(cv2.CAP_PROP_FOURCC) == _GREY):
            # Other pixels, in the camera's own layout, are OpenCV's to convert.
            capture.set(cv2.CAP_PROP_CONVERT_RGB, 1)
            image = self._first_image(capture)
        self._encoding = "jpeg" if raw_jpeg is not None else "gray8" if image.ndim == 2 else "bgr8"
        self._size = _size_of(image, raw_jpeg)
        first = self._picture(image)
        self._first = first if isinstance(first, Picture) else None
        rate_hz = capture.get(cv2.CAP_PROP_FPS)
        return CameraInfo(
            self._size, rate_hz if rate_hz > 0 else None, self._encoding, name=f"USB camera {self._number}"
        )

    def read(self) -> Picture | Lost | None:
        """See `FrameSource.read`."""
        if self._first is not None:
            first, self._first = self._first, None
            return first
        assert self._capture is not None
        delivered, image = self._capture.read()
        if delivered:
            self._failures = 0
            return self._picture(image)
        self._failures += 1
        if self._failures < _FAILURES_IN_A_ROW:
            return Lost("the driver did not deliver it")
        raise CameraError(
            f"USB camera {self._number} sends no pictures any more: see whether it is plugged in, and whether the bus "
            "has enough power for it.",
            code="camera-disconnected",
        )

    def interrupt(self) -> None:
        """See `FrameSource.interrupt`: the driver answers when the next frame comes, or its time is over."""

    def disconnect(self) -> None:
        """See `FrameSource.disconnect`."""
        self._first = None
        if self._capture is not None:
            self._capture.release()
            self._capture = None

    def controls(self) -> Mapping[str, Control]:
        """See `FrameSource.controls`."""
        return {} if self._controls is None else self._controls.read()

    def set_control(self, name: str, value: float) -> None:
        """See `FrameSource.set_control`."""
        assert self._controls is not None
        self._controls.write(name, value)
        self._exposure_s = self._read_exposure_s()

    def _configure(self, capture: Capture) -> None:
        """Ask for what is wanted; cameras and systems that cannot do it go on with what they can."""
        # Uncompressed pictures of this size do not fit through USB 2 at full rate.
        capture.set(cv2.CAP_PROP_FOURCC, _MJPG)
        if self._settings.image_size is not None:
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, self._settings.image_size[0])
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, self._settings.image_size[1])
        if self._settings.rate_hz is not None:
            capture.set(cv2.CAP_PROP_FPS, self._settings.rate_hz)
        capture.set(cv2.CAP_PROP_READ_TIMEOUT_MSEC, 1000 * self._settings.stall_s)
        capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)

    def _first_image(self, capture: Capture) -> ByteArray:
        """The first picture that is whole; cameras begin with broken ones."""
        for _ in range(_FIRST_PICTURES):
            delivered, image = capture.read()
            if not delivered:
                break
            if not _is_broken_jpeg(image):
                return np.asarray(image, dtype=np.uint8)
        raise CameraError(
            f"USB camera {self._number} sends no usable pictures: plug it in again, if possible without a hub."
        )

    def _picture(self, image: ByteArray) -> Picture | Lost:
        arrival_s = self._clock()
        assert self._capture is not None
        stamp_ms = self._capture.get(cv2.CAP_PROP_POS_MSEC)
        camera_time_s = stamp_ms / 1000.0 if stamp_ms > 0 else None
        jpeg = _as_jpeg(image) if self._encoding == "jpeg" else None
        if self._encoding == "jpeg" and jpeg is None:
            return Lost("it is truncated or no JPEG")
        size = _size_of(image, jpeg)
        data = np.ascontiguousarray(image).tobytes() if jpeg is None else jpeg
        if size != self._size:
            return Lost(f"it is {size[0]} x {size[1]} px, not {self._size[0]} x {self._size[1]} px")
        return Picture(data, arrival_s, camera_time_s, self._exposure_s)

    def _read_exposure_s(self) -> float | None:
        control = self.controls().get("exposure")
        return None if control is None else control.value / 1000.0


def _size_of(image: ByteArray, jpeg: bytes | None) -> tuple[int, int]:
    size = None if jpeg is None else jpeg_size(jpeg)
    return size or (image.shape[1], image.shape[0])


def _as_jpeg(image: ByteArray) -> bytes | None:
    """The JPEG that OpenCV hands over as one row (or column) of bytes; None for pixels, and if it is broken."""
    if image.size < 4 or max(image.shape) != image.size or image.reshape(-1)[:2].tobytes() != START:
        return None
    data = image.reshape(-1).tobytes()
    return data if is_whole_jpeg(data) else None


def _is_broken_jpeg(image: ByteArray) -> bool:
    """Whether this is one row of bytes that is no whole JPEG; no camera has one row of pixels."""
    return image.size == max(image.shape) and _as_jpeg(image) is None


def camera_number(url: str) -> int:
    """The number in ``uvc:0`` or ``uvc:/dev/video0``.

    Raises
    ------
    SettingsError
        If there is none.
    """
    text = url.removeprefix("uvc:").removeprefix("/dev/video")
    if not (text.isascii() and text.isdigit()):
        raise SettingsError(f"The USB camera {url!r} has no number: write uvc:0 for the first one.")
    return int(text)


def system_uvc_source(settings: CameraSettings, clock: Callable[[], float]) -> UvcSource:
    """The USB camera of that number on this system."""
    device = Path(f"/dev/video{camera_number(settings.url)}")
    if not sys.platform.startswith("linux"):
        return UvcSource(settings, clock, open_capture=cv2.VideoCapture, controls=None)
    import fcntl

    def open_capture(number: int) -> Capture:
        _require_device(device)
        return cv2.VideoCapture(number, cv2.CAP_V4L2)

    return UvcSource(settings, clock, open_capture=open_capture, controls=V4l2Controls(device, fcntl.ioctl))


def _require_device(device: Path) -> None:
    """Say what OpenCV would not: whether the device is missing or forbidden."""
    if not device.exists():
        others = sorted(str(path) for path in device.parent.glob("video*"))
        there = f"there are {', '.join(others)}" if others else "no camera is plugged in"
        raise CameraError(f"There is no USB camera {device}: {there}.")
    if not os.access(device, os.R_OK | os.W_OK):
        raise CameraError(f"{device} may not be opened: add this user to the group video, and log in again.")
