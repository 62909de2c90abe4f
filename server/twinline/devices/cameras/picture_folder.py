"""A folder of pictures that plays as a camera."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from twinline.devices.camera import CameraInfo, Encoding
from twinline.devices.cameras.jpeg import is_whole_jpeg, jpeg_size
from twinline.devices.cameras.settings import CameraSettings
from twinline.devices.cameras.source import Lost, NoControls, Picture
from twinline.errors import CameraError, FrameError
from twinline.recording.images import PICTURE_SUFFIXES, read_image

_DEFAULT_RATE_HZ = 25.0
_JPEG_SUFFIXES = frozenset({".jpg", ".jpeg"})


class PictureFolderSource(NoControls):
    """The PNG and JPEG files of a folder, by name, with numbers in their natural order (2 before 10).

    If all are JPEG they are handed on as they are, otherwise as pixels.

    Parameters
    ----------
    settings
        ``url`` is the path; ``rate_hz`` and ``paced`` are used.
    clock
        Tells host time.
    """

    def __init__(self, settings: CameraSettings, clock: Callable[[], float]) -> None:
        self._settings = settings
        self._clock = clock
        self._folder = Path(settings.url)
        self._rate_hz = settings.rate_hz or _DEFAULT_RATE_HZ
        self._paths: list[Path] = []
        self._next = 0
        self._encoding: Encoding = "jpeg"
        self._size = (0, 0)

    def connect(self) -> CameraInfo:
        """See `FrameSource.connect`."""
        try:
            paths = [path for path in self._folder.iterdir() if path.suffix.lower() in PICTURE_SUFFIXES]
        except OSError as error:
            raise CameraError(f"{self._folder} cannot be read ({error.strerror}): check the path.") from error
        if not paths:
            raise CameraError(f"{self._folder} holds no PNG or JPEG pictures: choose another folder.")
        self._paths = sorted(paths, key=_natural_order)
        self._next = 0
        self._encoding, self._size = self._first_usable()
        return CameraInfo(
            self._size, self._rate_hz, self._encoding, self._folder.name, live=self._settings.paced, ends=True
        )

    def read(self) -> Picture | Lost | None:
        """See `FrameSource.read`."""
        if self._next == len(self._paths):
            return None
        path = self._paths[self._next]
        time_s = self._next / self._rate_hz
        self._next += 1
        if self._encoding == "jpeg":
            data, size = _jpeg(path)
        else:
            data, size = self._pixels(path)
        if isinstance(data, bytes) and size != self._size:
            data = Lost(f"{path.name} is {size[0]} x {size[1]} px, not {self._size[0]} x {self._size[1]} px")
        return data if isinstance(data, Lost) else Picture(data, self._clock(), camera_time_s=time_s)

    def interrupt(self) -> None:
        """See `FrameSource.interrupt`: reading a file does not wait for anything."""

    def disconnect(self) -> None:
        """See `FrameSource.disconnect`."""

    def _first_usable(self) -> tuple[Encoding, tuple[int, int]]:
        reason = ""
        only_jpeg = all(path.suffix.lower() in _JPEG_SUFFIXES for path in self._paths)
        for path in self._paths:
            try:
                image = read_image(path)
            except FrameError as error:
                reason = reason or error.detail
                continue
            size = (image.shape[1], image.shape[0])
            if only_jpeg:
                return "jpeg", size
            return ("gray8" if image.ndim == 2 else "bgr8"), size
        raise CameraError(f"None of the {len(self._paths)} pictures in {self._folder} can be used: {reason}")

    def _pixels(self, path: Path) -> tuple[bytes | Lost, tuple[int, int]]:
        try:
            image = read_image(path)
        except FrameError as error:
            return Lost(error.detail.rstrip(".")), (0, 0)
        if self._encoding == "bgr8" and image.ndim == 2:
            image = np.repeat(image[:, :, None], 3, axis=2)
        elif self._encoding == "gray8" and image.ndim == 3:
            return Lost(f"{path.name} is in colour, and the first picture is grey"), (0, 0)
        return image.tobytes(), (image.shape[1], image.shape[0])


def _jpeg(path: Path) -> tuple[bytes | Lost, tuple[int, int]]:
    try:
        data = path.read_bytes()
    except OSError as error:
        return Lost(f"{path.name} cannot be read: {error.strerror}"), (0, 0)
    size = jpeg_size(data)
    if size is None or not is_whole_jpeg(data):
        return Lost(f"{path.name} is truncated or no JPEG"), (0, 0)
    return data, size


def _natural_order(path: Path) -> list[tuple[int, str]]:
    return [(int(part) if part.isdecimal() else 0, part) for part in re.split(r"(\d+)", path.name)]
