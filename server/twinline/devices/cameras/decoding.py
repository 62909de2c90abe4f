"""Coded video to pictures: JPEG is handed on as it is, everything else is decoded to pixels."""

from collections.abc import Iterator
from typing import TypeAlias

import av
import numpy as np

from twinline.devices.camera import Encoding
from twinline.devices.cameras.jpeg import is_whole_jpeg
from twinline.devices.cameras.source import Lost

VideoPacket: TypeAlias = "av.Packet[av.VideoStream]"

_GREY_FORMATS = frozenset({"gray", "grayf32le", "gray10le", "gray12le", "gray16le"})


class PacketDecoder:
    """Turns the packets of one video stream into pictures.

    Attributes
    ----------
    encoding
        What the pictures will be.
    """

    def __init__(self, stream: av.VideoStream) -> None:
        context = stream.codec_context
        self.encoding: Encoding = "jpeg" if context.name == "mjpeg" else "bgr8"
        if self.encoding == "bgr8" and context.pix_fmt in _GREY_FORMATS:
            self.encoding = "gray8"
        self._context = context
        self._damaged = False
        if self.encoding == "jpeg":
            return
        # Several frames at once would hold frames back; several slices at once, and FFmpeg forgets their errors.
        context.thread_count = 1
        context.flags |= av.codec.context.Flags.low_delay
        # What a decoder fills in for damaged data is no measurement.
        context.options = {**context.options, "err_detect": "explode"}

    def pictures(self, packet: VideoPacket) -> Iterator[tuple[bytes | Lost, float | None]]:
        """Pictures that a packet completes, each with its time in the stream's seconds.

        Parameters
        ----------
        packet
            The next one; the empty packet at the end brings out what the decoder holds.
        """
        if self.encoding == "jpeg":
            if packet.size:
                yield self._whole(packet), _time_s(packet)
            return
        if packet.is_keyframe:
            self._damaged = False
        try:
            frames = packet.decode()
        except av.error.FFmpegError as error:
            # All that follows builds on the damaged picture, up to the next one that stands by itself.
            self._damaged = True
            yield Lost(f"it cannot be decoded ({error.strerror})"), _time_s(packet)
            return
        for frame in frames:
            assert isinstance(frame, av.VideoFrame)
            self._damaged = self._damaged or frame.is_corrupt or packet.is_corrupt
            time_s = None if frame.pts is None or frame.time_base is None else float(frame.pts * frame.time_base)
            yield (Lost("it builds on damaged data") if self._damaged else self._pixels(frame)), time_s

    def _whole(self, packet: VideoPacket) -> bytes | Lost:
        data = bytes(packet)
        return data if is_whole_jpeg(data) else Lost(f"its {len(data)} bytes are truncated or no JPEG")

    def _pixels(self, frame: av.VideoFrame) -> bytes:
        array = frame.to_ndarray(format="gray" if self.encoding == "gray8" else "bgr24")
        return np.ascontiguousarray(array, dtype=np.uint8).tobytes()


def _time_s(packet: VideoPacket) -> float | None:
    return None if packet.pts is None or packet.time_base is None else float(packet.pts * packet.time_base)
