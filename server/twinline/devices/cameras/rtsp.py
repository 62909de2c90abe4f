"""Cameras that speak RTSP (most network cameras), through FFmpeg's client."""

import socket
from collections import deque
from collections.abc import Callable, Iterator

import av

from twinline.devices.camera import CameraInfo
from twinline.devices.cameras.address import explain, parse_address
from twinline.devices.cameras.decoding import PacketDecoder, VideoPacket
from twinline.devices.cameras.settings import CameraSettings
from twinline.devices.cameras.source import Lost, NoControls, Picture
from twinline.errors import CameraError

# A camera on the wire is not a film: nothing is kept back to play smoothly, and little is read before it begins.
_OPTIONS = {
    "rtsp_transport": "tcp",
    "fflags": "nobuffer",
    "flags": "low_delay",
    "probesize": "32768",
    "analyzeduration": "0",
    "allowed_media_types": "video",
}
_MAX_RATE_HZ = 1000.0


class RtspSource(NoControls):
    """One RTSP connection. MJPEG streams are handed on without decoding, with the camera's own time stamps.

    RTP is carried inside the RTSP connection (TCP), where nothing is lost or reordered on the way.

    Parameters
    ----------
    settings
        ``url``, ``connect_s`` and ``stall_s`` are used.
    clock
        Tells host time.
    """

    def __init__(self, settings: CameraSettings, clock: Callable[[], float]) -> None:
        self._settings = settings
        self._clock = clock
        self._address = parse_address(settings.url)
        self._interrupted = False
        self._container: av.container.InputContainer | None = None
        self._packets: Iterator[VideoPacket] = iter(())
        self._decoder: PacketDecoder | None = None
        self._ready: deque[Picture | Lost] = deque()
        self._last_picture_s = 0.0

    def connect(self) -> CameraInfo:
        """See `FrameSource.connect`."""
        self._container = container = self._open()
        if not container.streams.video:
            raise CameraError(f"{self._address} sends no video: choose another stream of the camera.")
        stream = container.streams.video[0]
        self._packets = container.demux(stream)
        self._decoder = PacketDecoder(stream)
        self._ready.clear()
        self._last_picture_s = self._clock()
        while isinstance(picture := self._next(), Lost):
            # Only what comes after the first picture is a loss.
            continue
        self._ready.appendleft(picture)
        size = (stream.codec_context.width, stream.codec_context.height)
        # Where the camera does not state its rate, FFmpeg gives that of the clock of its stamps.
        rate_hz = float(stream.average_rate or stream.guessed_rate or 0.0)
        known = 0.0 < rate_hz <= _MAX_RATE_HZ
        return CameraInfo(size, rate_hz if known else None, self._decoder.encoding, name=str(self._address))

    def read(self) -> Picture | Lost | None:
        """See `FrameSource.read`."""
        return self._next()

    def interrupt(self) -> None:
        """See `FrameSource.interrupt`: FFmpeg looks up when the next packet comes, or its time is over."""
        self._interrupted = True

    def disconnect(self) -> None:
        """See `FrameSource.disconnect`."""
        self._packets = iter(())
        self._ready.clear()
        self._decoder = None
        if self._container is not None:
            self._container.close()
            self._container = None

    def _open(self) -> av.container.InputContainer:
        address = self._address
        patience_s = self._settings.connect_s
        started_s = self._clock()
        try:
            # FFmpeg would call an unknown name an input/output error.
            socket.getaddrinfo(address.host, address.port, type=socket.SOCK_STREAM)
            return av.open(self._settings.url, "r", options=_OPTIONS, timeout=(patience_s, self._settings.stall_s))
        except (av.error.HTTPUnauthorizedError, av.error.HTTPForbiddenError) as error:
            if address.user:
                wanted = "does not accept this user and password: check them"
            else:
                wanted = f"wants a user and password: give them as {address.scheme}://USER:PASSWORD@{address.place}"
            raise CameraError(f"{address} {wanted}.") from error
        except av.error.HTTPNotFoundError as error:
            raise CameraError(
                f"{address} has no such stream (404): look up the path in the camera's manual."
            ) from error
        except (av.error.HTTPError, av.error.HTTPClientError) as error:
            raise CameraError(f"{address} refuses ({error.strerror}): see what its own page says.") from error
        except (av.error.FFmpegError, OSError) as error:
            if isinstance(error, OSError) and not isinstance(error, av.error.FFmpegError):
                raise explain(error, address, patience_s) from error
            raise self._explained(error, self._clock() - started_s) from error

    def _explained(self, error: Exception, waited_s: float) -> CameraError:
        """FFmpeg calls the end of its patience by different names; the time that went by tells."""
        if isinstance(error, OSError):
            return explain(error, self._address, self._settings.connect_s)
        if isinstance(error, av.error.ExitError) or waited_s >= 0.9 * self._settings.connect_s:
            return explain(TimeoutError(), self._address, self._settings.connect_s)
        return CameraError(
            f"{self._address} does not answer as an RTSP camera does ({type(error).__name__}): check the port "
            "and the address."
        )

    def _next(self) -> Picture | Lost:
        while not self._ready:
            if self._interrupted:
                raise CameraError(f"{self._address} was closed.", code="camera-disconnected")
            assert self._decoder is not None
            try:
                packet = next(self._packets, None)
            except av.error.ExitError as error:
                raise CameraError(
                    f"{self._address} sent no picture for {self._settings.stall_s:g} s: check its power and the "
                    "network.",
                    code="camera-timeout",
                ) from error
            except av.error.FFmpegError as error:
                raise self._gone() from error
            if packet is None or packet.size == 0:
                raise self._gone()
            arrival_s = self._clock()
            for data, time_s in self._decoder.pictures(packet):
                if not isinstance(data, Lost):
                    self._last_picture_s = arrival_s
                self._ready.append(data if isinstance(data, Lost) else Picture(data, arrival_s, time_s))
            # Decoders wait in silence for a key frame, some cameras send one in ten seconds, some none.
            if arrival_s - self._last_picture_s > 2 * self._settings.stall_s:
                raise self._undecodable(2 * self._settings.stall_s)
        return self._ready.popleft()

    def _undecodable(self, waited_s: float) -> CameraError:
        return CameraError(
            f"Nothing from {self._address} could be decoded for {waited_s:g} s: set the camera to H.264 or MJPEG with "
            "a key frame every second, and restart it."
        )

    def _gone(self) -> CameraError:
        return CameraError(
            f"{self._address} ended the stream: see whether it allows another viewer, or restart it.",
            code="camera-disconnected",
        )
