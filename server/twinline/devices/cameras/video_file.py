"""A video that plays as a camera."""

from collections.abc import Callable, Iterator
from pathlib import Path

import cv2

from twinline.devices.camera import CameraInfo, Encoding
from twinline.devices.cameras.jpeg import is_whole_jpeg, jpeg_size
from twinline.devices.cameras.settings import CameraSettings
from twinline.devices.cameras.source import Lost, NoControls, Picture
from twinline.errors import CameraError, FrameError
from twinline.recording.video import VideoIndex, index_video, read_video

_MJPG = cv2.VideoWriter.fourcc(*"MJPG")


class VideoFileSource(NoControls):
    """One video file. Frames carry the file's own times, or those of ``rate_hz`` where that is set.

    Motion JPEG is handed on without decoding. Everything else is decoded as it is for captures.

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
        self._path = Path(settings.url)
        self._pictures: Iterator[bytes | Lost] = iter(())
        self._index: VideoIndex | None = None
        self._rate_hz = 0.0
        self._next = 0

    def connect(self) -> CameraInfo:
        """See `FrameSource.connect`."""
        try:
            self._index = index = index_video(self._path)
        except FrameError as error:
            raise CameraError(error.detail) from error
        self._rate_hz = self._settings.rate_hz or index.rate_hz or 25.0
        self._next = 0
        encoding: Encoding = "jpeg" if self._is_motion_jpeg(index) else "bgr8"
        self._pictures = self._packets(index) if encoding == "jpeg" else self._decoded(index)
        return CameraInfo(index.size, self._rate_hz, encoding, self._path.name, live=self._settings.paced, ends=True)

    def read(self) -> Picture | Lost | None:
        """See `FrameSource.read`."""
        try:
            picture = next(self._pictures, None)
        except FrameError as error:
            raise CameraError(error.detail) from error
        number, self._next = self._next, self._next + 1
        if picture is None or isinstance(picture, Lost):
            return picture
        return Picture(picture, self._clock(), self._time_s(number))

    def interrupt(self) -> None:
        """See `FrameSource.interrupt`: reading a file does not wait for anything."""

    def disconnect(self) -> None:
        """See `FrameSource.disconnect`."""
        self._pictures = iter(())

    def _time_s(self, number: int) -> float:
        times_us = None if self._index is None else self._index.times_us
        if times_us is None or self._settings.rate_hz or number >= len(times_us):
            return number / self._rate_hz
        return float(times_us[number]) * 1e-6

    def _is_motion_jpeg(self, index: VideoIndex) -> bool:
        return next(self._packets(index), None) is not None

    def _packets(self, index: VideoIndex) -> Iterator[bytes | Lost]:
        """The coded pictures; nothing if they are no JPEG."""
        capture = cv2.VideoCapture(str(self._path), cv2.CAP_FFMPEG)
        try:
            if int(capture.get(cv2.CAP_PROP_FOURCC)) != _MJPG or not capture.set(cv2.CAP_PROP_FORMAT, -1):
                return
            while True:
                delivered, packet = capture.read()
                if not delivered:
                    return
                data = packet.tobytes()
                whole = is_whole_jpeg(data) and jpeg_size(data) == index.size
                yield data if whole else Lost(f"its {len(data)} bytes are truncated or no JPEG of this size")
        finally:
            capture.release()

    def _decoded(self, index: VideoIndex) -> Iterator[bytes | Lost]:
        for number, image in read_video(self._path, index, range(index.count)):
            yield Lost(f"frame {number} cannot be decoded") if image is None else image.tobytes()
