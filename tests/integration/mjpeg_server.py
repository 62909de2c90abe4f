"""A small MJPEG camera for tests: HTTP on loopback, well-behaved unless told otherwise."""

import hashlib
import re
import socket
import time
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from tests.integration.loopback_server import LoopbackServer

_NONCE = "0123456789abcdef"


@dataclass(frozen=True)
class Behaviour:
    """How one connection goes. Frames are counted from 0 on each connection.

    Attributes
    ----------
    announced, sent
        Boundary in the header, and the line that really stands between the parts.
    lengths
        What the parts say of their length.
    boundary_first
        Whether the boundary of the next part follows a picture at once, as some cameras do.
    stamps
        Whether parts carry the camera's clock; it says ``1000 + index / rate``.
    damage
        What is sent in place of these frames: bytes, or how many bytes to cut off at the end.
    pieces
        Bytes per packet; 0 for a frame at once.
    """

    status: str = "200 OK"
    headers: Mapping[str, str] = field(default_factory=dict)
    content_type: str = "multipart/x-mixed-replace"
    announced: str = "frame"
    sent: str = "--frame"
    newline: bytes = b"\r\n"
    lengths: Literal["right", "none", "short", "long", "nonsense"] = "right"
    boundary_first: bool = False
    stamps: bool = False
    chunked: bool = False
    pieces: int = 0
    damage: Mapping[int, bytes | int] = field(default_factory=dict)
    skip: frozenset[int] = frozenset()
    hold_back_s: Mapping[int, float] = field(default_factory=dict)
    silent: bool = False
    drip: bool = False
    end_after: int | None = None
    stall_after: int | None = None


class MjpegServer(LoopbackServer):
    """Sends pictures again and again at a constant rate.

    Parameters
    ----------
    behaviours
        Of the first connection, the second, ...; the last one goes on.
    login
        ``user:password`` that it wants, in the way of ``auth``; where that is digest, basic is offered too.
    """

    def __init__(
        self,
        pictures: Sequence[bytes],
        *behaviours: Behaviour,
        rate_hz: float = 100.0,
        login: str = "",
        auth: Literal["basic", "digest"] = "basic",
    ) -> None:
        super().__init__()
        self.pictures = pictures
        self.behaviours = behaviours or (Behaviour(),)
        self.rate_hz = rate_hz
        self.login = login
        self.auth = auth
        self.requests: list[str] = []

    @property
    def url(self) -> str:
        login = f"{self.login}@" if self.login else ""
        return f"http://{login}127.0.0.1:{self.port}/stream?quality=90"

    def serve(self, sock: socket.socket, number: int) -> None:
        behaviour = self.behaviours[min(number, len(self.behaviours) - 1)]
        request = b""
        while b"\r\n\r\n" not in request:
            piece = sock.recv(4096)
            if not piece:
                return
            request += piece
        self.requests.append(request.decode())
        if behaviour.silent:
            self.stopping.wait(60.0)
        elif self.login and not self._is_welcome(request.decode()):
            kinds = ['Basic realm="camera"'] + ([_digest_challenge()] if self.auth == "digest" else [])
            lines = ["HTTP/1.1 401 Unauthorized", *(f"WWW-Authenticate: {kind}" for kind in kinds), "Content-Length: 0"]
            sock.sendall("\r\n".join([*lines, "", ""]).encode())
        else:
            sock.sendall(self._head(behaviour))
            if behaviour.status.startswith("200"):
                self._stream(sock, behaviour)

    def _stream(self, sock: socket.socket, behaviour: Behaviour) -> None:
        index = 0
        first = True
        begin_s = time.monotonic()
        while index != behaviour.end_after:
            if index == behaviour.stall_after:
                while not self.stopping.wait(0.02):
                    if behaviour.drip:
                        sock.sendall(b" ")
                return
            held_back_s = behaviour.hold_back_s.get(index, 0.0)
            if self.wait_until(begin_s, (index + 1) / self.rate_hz + held_back_s):
                return
            if index not in behaviour.skip:
                self._send(sock, behaviour, self._part(index, behaviour, first=first))
                first = False
            index += 1
        if behaviour.chunked:
            sock.sendall(b"0\r\n\r\n")

    def _part(self, index: int, behaviour: Behaviour, *, first: bool) -> bytes:
        body = self.pictures[index % len(self.pictures)]
        damage = behaviour.damage.get(index, b"")
        sent = damage if isinstance(damage, bytes) and index in behaviour.damage else body
        if isinstance(damage, int):
            sent = body[:-damage]
        length = {"right": len(sent), "short": len(body) // 2, "long": len(body) + 300}.get(behaviour.lengths)
        lines = [b"Content-Type: image/jpeg"]
        if behaviour.lengths == "nonsense":
            lines.append(b"Content-Length: many")
        elif length is not None:
            lines.append(b"Content-Length: %d" % length)
        if behaviour.stamps:
            lines.append(b"X-Timestamp: %.6f" % (1000.0 + index / self.rate_hz))
        newline = behaviour.newline
        delimiter = behaviour.sent.encode() + newline
        head = newline.join([*lines, b"", b""])
        if not behaviour.boundary_first:
            return delimiter + head + sent + newline
        return (delimiter if first else b"") + head + sent + newline + delimiter

    @staticmethod
    def _send(sock: socket.socket, behaviour: Behaviour, data: bytes) -> None:
        size = behaviour.pieces or len(data)
        for at in range(0, len(data), size):
            piece = data[at : at + size]
            sock.sendall(b"%x\r\n%s\r\n" % (len(piece), piece) if behaviour.chunked else piece)

    @staticmethod
    def _head(behaviour: Behaviour) -> bytes:
        lines = [f"HTTP/1.1 {behaviour.status}", *(f"{name}: {value}" for name, value in behaviour.headers.items())]
        boundary = f"; boundary={behaviour.announced}" if behaviour.announced else ""
        lines.append(f"Content-Type: {behaviour.content_type}{boundary}")
        lines.append("Transfer-Encoding: chunked" if behaviour.chunked else "Connection: close")
        return "\r\n".join([*lines, "", ""]).encode()

    def _is_welcome(self, request: str) -> bool:
        if self.auth == "basic":
            return f"Authorization: Basic {b64encode(self.login.encode()).decode()}\r\n" in request
        values = dict(re.findall(r'(\w+)="?([^",\r]*)"?', request.partition("Authorization: Digest ")[2]))
        user, _, password = self.login.partition(":")
        uri = request.split(" ")[1]
        secret = _md5(f"{user}:camera:{password}")
        expected = _md5(f"{secret}:{_NONCE}:{values.get('nc')}:{values.get('cnonce')}:auth:{_md5(f'GET:{uri}')}")
        return values.get("uri") == uri and values.get("response") == expected


def _digest_challenge() -> str:
    return f'Digest realm="camera", qop="auth", nonce="{_NONCE}", algorithm=MD5'


def _md5(text: str) -> str:
    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()
