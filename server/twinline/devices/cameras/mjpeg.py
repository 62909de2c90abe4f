"""Cameras that send MJPEG over HTTP: their pictures are handed on as they came, byte for byte."""

import http.client
import re
import socket
import ssl
import threading
import urllib.request
from base64 import b64encode
from collections import deque
from collections.abc import Callable
from email.message import Message
from urllib.parse import urljoin

from twinline.devices.camera import CameraInfo
from twinline.devices.cameras.address import Address, explain, parse_address
from twinline.devices.cameras.jpeg import jpeg_size
from twinline.devices.cameras.multipart import MAX_PICTURE_BYTES, BrokenPart, MultipartParser, Part
from twinline.devices.cameras.settings import CameraSettings
from twinline.devices.cameras.source import Lost, NoControls, Picture
from twinline.errors import CameraError, SettingsError

_READ_BYTES = 64 * 1024
_MAX_REDIRECTS = 3
_BOUNDARY = re.compile(r"boundary\s*=\s*(\"[^\"]*\"|[^;\s]+)", re.IGNORECASE)
# Seconds on the camera's clock, as mjpg-streamer and its relatives send them; whole seconds would be of no use.
_TIMESTAMP_HEADERS = ("x-timestamp", "x-timestamp-s")


class MjpegSource(NoControls):
    """One HTTP connection to a camera.

    The decoders that come with OpenCV and FFmpeg would invent time stamps for such a stream, 40 ms apart; here frames
    carry the camera's own stamp where it sends one, and the time at which they came.

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
        self._first_address = parse_address(settings.url)
        self._address = self._first_address
        self._lock = threading.Lock()
        self._interrupted = False
        self._socket: socket.socket | None = None
        self._response: http.client.HTTPResponse | None = None
        self._parser = MultipartParser(None)
        self._ready: deque[Part | BrokenPart] = deque()
        self._size = (0, 0)
        self._last_part_s = 0.0

    # ------------------------------------------------------------------------------------------------------ connecting

    def connect(self) -> CameraInfo:
        """See `FrameSource.connect`."""
        self._address = self._first_address
        kind = self._request().headers.get("Content-Type", "")
        if not kind.lower().startswith("multipart/"):
            said = "a single picture" if kind.lower().startswith("image/") else kind or "something without a type"
            raise CameraError(
                f"{self._address} sends {said} instead of an MJPEG stream (multipart/x-mixed-replace): look up the "
                "address of the stream in the camera's manual."
            )
        boundary = _BOUNDARY.search(kind)
        self._parser = MultipartParser(boundary[1] if boundary else None)
        self._ready.clear()
        self._last_part_s = self._clock()
        broken: list[BrokenPart] = []
        while isinstance(part := self._next_part(), BrokenPart):
            broken.append(part)
            if len(broken) == 20:
                raise CameraError(
                    f"The first 20 pictures from {self._address} are broken (the last: {part.reason}): see whether a "
                    "browser shows the stream, and restart the camera."
                )
        self._size = jpeg_size(part.body) or (0, 0)
        self._ready.appendleft(part)
        return CameraInfo(self._size, None, "jpeg", name=str(self._first_address))

    def _request(self) -> http.client.HTTPResponse:
        """Ask for the stream: follows redirections, and answers a demand for a password once."""
        authorization = ""
        for _ in range(2 * (_MAX_REDIRECTS + 1)):
            response = self._ask(authorization)
            if response.status == 200:
                return response
            if response.status in {301, 302, 303, 307, 308}:
                self._address = self._redirected(response.headers.get("Location", ""))
                authorization = ""
                continue
            answer = self._answer(response.headers) if response.status == 401 and not authorization else ""
            if not answer:
                raise CameraError(f"{self._address} answers {_refusal(response, self._address)}.")
            authorization = answer
        raise CameraError(f"{self._first_address} redirects again and again: check the address.")

    def _ask(self, authorization: str) -> http.client.HTTPResponse:
        address = self._address
        try:
            connection = http.client.HTTPConnection(address.host, address.port)
            connection.sock = self._connected_socket(address)
            headers = {"User-Agent": "Twinline", "Accept": "multipart/x-mixed-replace, image/jpeg"}
            if authorization:
                headers["Authorization"] = authorization
            connection.request("GET", address.target, headers=headers)
            response = connection.getresponse()
        except http.client.HTTPException as error:
            raise CameraError(
                f"{address} does not answer in HTTP ({type(error).__name__}): check the port and the address."
            ) from error
        except OSError as error:
            raise explain(error, address, self._settings.connect_s) from error
        self._keep(response)
        return response

    def _keep(self, response: http.client.HTTPResponse | None) -> None:
        """Hold the answer that is read now, and close the one before; it has the socket."""
        if self._response is not None:
            self._response.close()
        self._response = response

    def _connected_socket(self, address: Address) -> socket.socket:
        """A connected socket that `interrupt` can reach at any time, also while it connects."""
        candidates = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_STREAM)
        for number, (family, kind, protocol, _, place) in enumerate(candidates, start=1):
            sock = socket.socket(family, kind, protocol)
            self._hold(sock)
            sock.settimeout(self._settings.connect_s)
            try:
                sock.connect(place)
                if address.scheme == "https":
                    sock = ssl.create_default_context().wrap_socket(sock, server_hostname=address.host)
                    self._hold(sock)
            except OSError:
                sock.close()
                if number == len(candidates):
                    raise
            else:
                return sock
        raise OSError(f"{address.host} has no address")

    def _hold(self, sock: socket.socket) -> None:
        with self._lock:
            if self._interrupted:
                sock.close()
                raise ConnectionAbortedError("closed while connecting")
            if self._socket is not None and self._socket is not sock:
                self._socket.close()
            self._socket = sock

    def _redirected(self, location: str) -> Address:
        before = self._address
        try:
            address = parse_address(urljoin(f"{before.scheme}://{before.place}{before.target}", location))
        except SettingsError as error:
            raise CameraError(f"{before} redirects to an address that cannot be used: {error.detail}") from error
        if address.scheme not in {"http", "https"}:
            raise CameraError(f"{before} redirects to {address}, which is not HTTP: use that address itself.")
        if (address.host, address.port) == (before.host, before.port):
            # The password is for this camera only, and is not handed to another host.
            return Address(address.scheme, address.host, address.port, address.target, before.user, before.password)
        return address

    def _answer(self, headers: Message) -> str:
        """The Authorization header for a camera that wants a password; empty if there is none, or no known way."""
        address = self._address
        if not address.user:
            return ""
        # Basic hands the password itself over, so that it comes last.
        challenges = headers.get_all("WWW-Authenticate", [])
        for challenge in sorted(challenges, key=lambda text: not text.lower().startswith("digest")):
            scheme, _, rest = challenge.partition(" ")
            if scheme.lower() == "basic":
                return "Basic " + b64encode(f"{address.user}:{address.password}".encode()).decode()
            if scheme.lower() == "digest":
                url = f"{address.scheme}://{address.place}{address.target}"
                passwords = urllib.request.HTTPPasswordMgrWithDefaultRealm()
                passwords.add_password(None, url, address.user, address.password)
                try:
                    values = urllib.request.parse_keqv_list(urllib.request.parse_http_list(rest))
                    digest = urllib.request.HTTPDigestAuthHandler(passwords)
                    answer = digest.get_authorization(urllib.request.Request(url), values)
                except (ValueError, OSError):
                    # A kind of digest that is not known here; there may be another challenge.
                    continue
                if answer:
                    return f"Digest {answer}"
        return ""

    # --------------------------------------------------------------------------------------------------------- reading

    def read(self) -> Picture | Lost | None:
        """See `FrameSource.read`."""
        part = self._next_part()
        if isinstance(part, BrokenPart):
            return Lost(part.reason)
        size = jpeg_size(part.body)
        if size != self._size:
            # Connecting again shows whether this was one stray picture or another setting.
            raise CameraError(f"{self._address} sent a picture of another size: see who changed the camera's settings.")
        return Picture(part.body, part.arrival_s, camera_time_s=_camera_time_s(part.headers))

    def _next_part(self) -> Part | BrokenPart:
        while not self._ready:
            data = self._receive()
            now_s = self._clock()
            self._ready.extend(self._parser.feed(data, now_s))
            if self._ready:
                self._last_part_s = now_s
            elif now_s - self._last_part_s > self._settings.stall_s:
                # A camera that sends a byte now and then is as dead as one that sends none.
                raise self._stalled()
            elif self._parser.waiting_bytes > MAX_PICTURE_BYTES:
                raise CameraError(
                    f"{self._address} sent {MAX_PICTURE_BYTES // 2**20} MiB without the end of a picture: see what a "
                    "browser shows, and restart the camera."
                )
        return self._ready.popleft()

    def _receive(self) -> bytes:
        assert self._response is not None
        assert self._socket is not None
        try:
            self._socket.settimeout(self._settings.stall_s)
            data = self._response.read1(_READ_BYTES)
        except TimeoutError as error:
            raise self._stalled() from error
        except (OSError, http.client.HTTPException, ValueError) as error:
            raise self._gone() from error
        if not data:
            raise self._gone()
        return data

    def _stalled(self) -> CameraError:
        return CameraError(
            f"{self._address} sent no picture for {self._settings.stall_s:g} s: check its power and the network.",
            code="camera-timeout",
        )

    def _gone(self) -> CameraError:
        return CameraError(
            f"{self._address} ended the stream: see whether it allows another viewer, or restart it.",
            code="camera-disconnected",
        )

    # --------------------------------------------------------------------------------------------------------- leaving

    def interrupt(self) -> None:
        """See `FrameSource.interrupt`."""
        with self._lock:
            self._interrupted = True
            if self._socket is None:
                return
            try:
                self._socket.shutdown(socket.SHUT_RDWR)
            except OSError:
                # Not connected yet, or no more: closing ends the first, and the second has ended.
                self._socket.close()

    def disconnect(self) -> None:
        """See `FrameSource.disconnect`."""
        self._keep(None)
        with self._lock:
            if self._socket is not None:
                self._socket.close()
                self._socket = None
        self._ready.clear()


def _refusal(response: http.client.HTTPResponse, address: Address) -> str:
    status = f"{response.status} {response.reason}".strip()
    if response.status in {401, 403} and not address.user:
        return f"{status}: it wants a user and password, given as {address.scheme}://USER:PASSWORD@{address.place}"
    if response.status in {401, 403}:
        return f"{status}: it does not accept this user and password"
    if response.status == 404:
        return f"{status}: there is no stream at this address; look it up in the camera's manual"
    return f"{status}: see what a browser shows there, and restart the camera"


def _camera_time_s(headers: dict[str, str]) -> float | None:
    for name in _TIMESTAMP_HEADERS:
        text = headers.get(name, "")
        if re.fullmatch(r"\d{1,12}\.\d{3,9}", text):
            return float(text)
    return None
