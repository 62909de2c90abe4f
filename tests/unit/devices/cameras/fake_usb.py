"""A USB camera made of memory: what OpenCV and the kernel would show of one."""

import errno
import struct
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from twinline.arrays import ByteArray
from twinline.devices.cameras.v4l2_controls import G_CTRL, QUERYCTRL, S_CTRL

EXPOSURE, EXPOSURE_AUTO, GAIN = 0x009A0902, 0x009A0901, 0x00980913


class FakeCapture:
    """Stands in for `cv2.VideoCapture`: gives the pictures in turn, at a rate.

    Parameters
    ----------
    pictures
        JPEG bytes, or pixels; None where the driver fails.
    """

    def __init__(self, pictures: Sequence[bytes | ByteArray | None], *, rate_hz: float = 100.0) -> None:
        self.pictures = pictures
        self.rate_hz = rate_hz
        self.settings: dict[int, float] = {cv2.CAP_PROP_CONVERT_RGB: 1.0}
        self.released = threading.Event()
        self._count = 0

    def isOpened(self) -> bool:  # noqa: N802 - OpenCV's name
        return not self.released.is_set()

    def set(self, propId: int, value: float) -> bool:
        self.settings[propId] = value
        return True

    def get(self, propId: int) -> float:
        if propId == cv2.CAP_PROP_POS_MSEC:
            return 1000.0 * (500.0 + self._count / self.rate_hz)
        if propId == cv2.CAP_PROP_FOURCC:
            grey = isinstance(self.pictures[0], np.ndarray) and self.pictures[0].ndim == 2
            return float(cv2.VideoWriter.fourcc(*("GREY" if grey else "MJPG")))
        return self.rate_hz if propId == cv2.CAP_PROP_FPS else 0.0

    def read(self) -> tuple[bool, Any]:
        self.released.wait(1.0 / self.rate_hz)
        picture = self.pictures[self._count % len(self.pictures)]
        self._count += 1
        if picture is None or self.released.is_set():
            return False, None
        if isinstance(picture, np.ndarray):
            return True, picture
        raw = np.frombuffer(picture, np.uint8)
        if self.settings[cv2.CAP_PROP_CONVERT_RGB]:
            return True, cv2.imdecode(raw, cv2.IMREAD_COLOR)
        return True, raw[None, :]

    def release(self) -> None:
        self.released.set()


@dataclass
class FakeKernel:
    """Answers the kernel's calls about controls: id -> [low, high, value]."""

    controls: dict[int, list[int]] = field(
        default_factory=lambda: {EXPOSURE: [1, 5000, 157], EXPOSURE_AUTO: [0, 3, 3], GAIN: [0, 255, 16]}
    )
    stuck: frozenset[int] = frozenset()

    def ioctl(self, descriptor: int, request: int, data: bytes) -> bytes:
        (number,) = struct.unpack_from("=I", data)
        if number not in self.controls:
            raise OSError(errno.EINVAL, "Invalid argument")
        low, high, value = self.controls[number]
        if request == QUERYCTRL:
            return struct.pack("=II32siiiiI8x", number, 1, b"control", low, high, 1, low, 0)
        if request == G_CTRL:
            return struct.pack("=Ii", number, value)
        assert request == S_CTRL
        if number in self.stuck:
            raise OSError(errno.EBUSY, "Device or resource busy")
        self.controls[number][2] = struct.unpack("=Ii", data)[1]
        return data
