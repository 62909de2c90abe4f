"""Exposure, gain, focus and zoom of a USB camera on Linux, with their true limits.

OpenCV sets such values but tells neither limits nor units, so the kernel is asked: Linux Media Infrastructure API,
Video for Linux, "User Controls" and the ioctls QUERYCTRL, G_CTRL and S_CTRL.
"""

import os
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from twinline.devices.camera import Control
from twinline.errors import CameraError

Ioctl = Callable[[int, int, bytes], bytes]

# struct v4l2_queryctrl: id, type, name, minimum, maximum, step, default, flags, reserved.
_QUERY = struct.Struct("=II32siiiiI8x")
# struct v4l2_control: id, value.
_VALUE = struct.Struct("=Ii")


def _request(number: int, size: int) -> int:
    """Number of an ioctl of video devices that reads and writes so many bytes (_IOWR of the kernel's headers)."""
    return 3 << 30 | size << 16 | ord("V") << 8 | number


QUERYCTRL = _request(36, _QUERY.size)
G_CTRL = _request(27, _VALUE.size)
S_CTRL = _request(28, _VALUE.size)
_DISABLED, _READ_ONLY = 0x0001, 0x0004


@dataclass(frozen=True, slots=True)
class _Kind:
    """A control of the kernel: its id, its size in our unit, and the automatic that has to be off for it."""

    id: int
    step: float = 1.0
    unit: str = ""
    automatic: int = 0
    manual: int = 0


_KINDS: Mapping[str, _Kind] = {
    "exposure": _Kind(0x009A0902, step=0.1, unit="ms", automatic=0x009A0901, manual=1),
    "gain": _Kind(0x00980913, automatic=0x00980912),
    "focus": _Kind(0x009A090A, automatic=0x009A090C),
    "zoom": _Kind(0x009A090D),
    "brightness": _Kind(0x00980900),
}


class V4l2Controls:
    """The controls of one video device.

    Parameters
    ----------
    device
        ``/dev/video0`` or another one; opened for each call only.
    ioctl
        ``fcntl.ioctl``, or what stands in for it.
    """

    def __init__(self, device: Path, ioctl: Ioctl) -> None:
        self._device = device
        self._ioctl = ioctl

    def read(self) -> Mapping[str, Control]:
        """All controls of the device that are known here.

        Raises
        ------
        CameraError
            If the device is gone.
        """
        descriptor = self._open()
        try:
            found = {name: self._query(descriptor, kind) for name, kind in _KINDS.items()}
        finally:
            os.close(descriptor)
        return {name: control for name, control in found.items() if control is not None}

    def write(self, name: str, value: float) -> None:
        """Set a control, after turning off the automatic that would change it again.

        Raises
        ------
        CameraError
            If the device is gone, or refuses.
        """
        kind = _KINDS[name]
        descriptor = self._open()
        try:
            if kind.automatic and self._has(descriptor, kind.automatic):
                self._ioctl(descriptor, S_CTRL, _VALUE.pack(kind.automatic, kind.manual))
            self._ioctl(descriptor, S_CTRL, _VALUE.pack(kind.id, round(value / kind.step)))
        except OSError as error:
            raise CameraError(
                f"{self._device} refuses {name} {value:g} {kind.unit}".rstrip()
                + f" ({error.strerror}): try another value, or see whether another program has the camera."
            ) from error
        finally:
            os.close(descriptor)

    def _open(self) -> int:
        try:
            return os.open(self._device, os.O_RDWR | os.O_NONBLOCK)
        except OSError as error:
            raise CameraError(
                f"{self._device} cannot be opened ({error.strerror}): see whether the camera is plugged in."
            ) from error

    def _query(self, descriptor: int, kind: _Kind) -> Control | None:
        try:
            answer = _QUERY.unpack(self._ioctl(descriptor, QUERYCTRL, _query(kind.id)))
            _, _, _, low, high, _, _, flags = answer
            if flags & (_DISABLED | _READ_ONLY) or high <= low:
                return None
            _, value = _VALUE.unpack(self._ioctl(descriptor, G_CTRL, _VALUE.pack(kind.id, 0)))
        except OSError:
            # The kernel's way to say that the device has no such control.
            return None
        return Control(low * kind.step, high * kind.step, value * kind.step, kind.unit)

    def _has(self, descriptor: int, control_id: int) -> bool:
        try:
            flags = _QUERY.unpack(self._ioctl(descriptor, QUERYCTRL, _query(control_id)))[-1]
        except OSError:
            return False
        return not flags & (_DISABLED | _READ_ONLY)


def _query(control_id: int) -> bytes:
    return _QUERY.pack(control_id, 0, b"", 0, 0, 0, 0, 0)
