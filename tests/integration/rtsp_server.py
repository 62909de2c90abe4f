"""A small RTSP server for tests: the real protocol (RFC 2326) over real sockets, RTP interleaved in its connection.

It sends JPEG (RFC 2435) or H.264 (RFC 6184), and misbehaves on request. It listens on loopback only.
"""

import itertools
import re
import socket
import struct
import threading
import time
from base64 import b64encode
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import BinaryIO, Literal

import av
import numpy as np

from tests.integration.loopback_server import LoopbackServer, shut_down
from twinline.arrays import ByteArray

_CLOCK_HZ = 90_000
_PAYLOAD_BYTES = 1400
_JPEG_TYPE = 26
_H264_TYPE = 96

RtpPayloads = Sequence[bytes]


@dataclass
class Stream:
    """A coded video: the RTP payloads of each frame."""

    coding: Literal["jpeg", "h264"]
    frames: Sequence[RtpPayloads]
    parameter_sets: str = ""

    @property
    def sdp(self) -> str:
        lines = ["v=0", "o=- 1 1 IN IP4 127.0.0.1", "s=test", "c=IN IP4 0.0.0.0", "t=0 0", "a=control:*"]
        if self.coding == "jpeg":
            lines += [f"m=video 0 RTP/AVP {_JPEG_TYPE}", f"a=rtpmap:{_JPEG_TYPE} JPEG/{_CLOCK_HZ}"]
        else:
            lines += [f"m=video 0 RTP/AVP {_H264_TYPE}", f"a=rtpmap:{_H264_TYPE} H264/{_CLOCK_HZ}"]
            lines += [f"a=fmtp:{_H264_TYPE} packetization-mode=1;sprop-parameter-sets={self.parameter_sets}"]
        return "\r\n".join([*lines, "a=control:track0", ""])


def jpeg_stream(pictures: Sequence[bytes]) -> Stream:
    """Packets for baseline JPEG pictures with 4:2:0 colour, as OpenCV writes them."""
    return Stream("jpeg", [_jpeg_payloads(picture) for picture in pictures])


def _jpeg_payloads(picture: bytes) -> RtpPayloads:
    tables, position, scan = b"", 2, b""
    width = height = 0
    while not scan:
        marker, length = picture[position + 1], int.from_bytes(picture[position + 2 : position + 4], "big")
        segment = picture[position + 4 : position + 2 + length]
        if marker == 0xDB:
            for at in range(0, len(segment), 65):
                tables += segment[at + 1 : at + 65]
        elif marker == 0xC0:
            height, width = struct.unpack(">HH", segment[1:5])
            assert segment[7] == 0x22, "RTP type 1 is 4:2:0"
        elif marker == 0xDA:
            scan = picture[position + 2 + length : -2]
        position += 2 + length
    payloads = []
    for offset in range(0, len(scan), _PAYLOAD_BYTES):
        head = struct.pack(">I", offset) + bytes([1, 255, width // 8, height // 8])
        quantization = struct.pack(">BBH", 0, 0, len(tables)) + tables if offset == 0 else b""
        payloads.append(head + quantization + scan[offset : offset + _PAYLOAD_BYTES])
    return payloads


def h264_stream(images: Sequence[ByteArray], *, key_every: int = 10) -> Stream:
    """Encode grey or colour pictures; a key frame every few, so that a decoder may begin anywhere."""
    height, width = images[0].shape[:2]
    codec = av.CodecContext.create("libx264", "w")
    assert isinstance(codec, av.VideoCodecContext)
    codec.width, codec.height, codec.pix_fmt = width, height, "yuv420p"
    codec.gop_size = key_every
    codec.options = {"preset": "ultrafast", "tune": "zerolatency", "crf": "18", "x264-params": "repeat-headers=1"}
    packets = []
    for image in images:
        kind = "gray" if image.ndim == 2 else "bgr24"
        packets += codec.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format=kind))
    packets += codec.encode(None)
    units = [_nal_units(bytes(packet)) for packet in packets]
    sets = [b64encode(unit).decode() for unit in units[0] if unit[0] & 0x1F in {7, 8}]
    frames = [[payload for unit in frame for payload in _h264_payloads(unit)] for frame in units]
    return Stream("h264", frames, ",".join(sets))


def _nal_units(data: bytes) -> list[bytes]:
    return [unit for unit in re.split(rb"\x00?\x00\x00\x01", data) if unit]


def _h264_payloads(unit: bytes) -> RtpPayloads:
    if len(unit) <= _PAYLOAD_BYTES:
        return [unit]
    pieces = [unit[at : at + _PAYLOAD_BYTES] for at in range(1, len(unit), _PAYLOAD_BYTES)]
    last = len(pieces) - 1
    indicator = unit[0] & 0xE0 | 28
    return [
        bytes([indicator, (number == 0) << 7 | (number == last) << 6 | unit[0] & 0x1F]) + piece
        for number, piece in enumerate(pieces)
    ]


@dataclass
class Misbehaviour:
    """What goes wrong, and when. Frames are counted per connection, from 0."""

    status: str = ""
    silent: bool = False
    end_after: int | None = None
    stall_after: int | None = None
    lose_packet_of: frozenset[int] = frozenset()
    hold_back: dict[int, float] = field(default_factory=dict)


class RtspServer(LoopbackServer):
    """Serves a stream to any number of clients, each from its beginning, again and again, at a constant rate."""

    def __init__(self, stream: Stream, *, rate_hz: float = 25.0, login: str = "") -> None:
        super().__init__()
        self.stream = stream
        self.rate_hz = rate_hz
        self.login = login
        self.misbehaviour = Misbehaviour()
        self.methods: list[str] = []

    @property
    def url(self) -> str:
        login = f"{self.login}@" if self.login else ""
        return f"rtsp://{login}127.0.0.1:{self.port}/live"

    def serve(self, sock: socket.socket, number: int) -> None:
        sending = threading.Lock()
        done = threading.Event()
        sender: threading.Thread | None = None
        try:
            with sock.makefile("rb") as reader:
                while request := self._read_request(reader):
                    method, headers = request
                    self.methods.append(method)
                    if self.misbehaviour.silent:
                        self.stopping.wait(60.0)
                        return
                    with sending:
                        sock.sendall(self._response(method, headers))
                    if method == "PLAY" and sender is None and not self.misbehaviour.status:
                        sender = threading.Thread(target=self._send, args=(sock, sending, done), name="rtsp-sender")
                        sender.start()
                    if method == "TEARDOWN":
                        return
        finally:
            done.set()
            if sender is not None:
                sender.join()

    @staticmethod
    def _read_request(reader: BinaryIO) -> tuple[str, dict[str, str]] | None:
        while True:
            line = reader.readline()
            if not line:
                return None
            if line[:1] == b"$":
                # A receiver's report: two more bytes of head are in the line or behind it; its length is in them.
                head = line + reader.read(max(0, 4 - len(line)))
                length = int.from_bytes(head[2:4], "big")
                reader.read(max(0, length - (len(head) - 4)))
                continue
            method = line.split(b" ", 1)[0].decode("latin-1")
            headers = {}
            while (line := reader.readline()) not in {b"\r\n", b""}:
                name, _, value = line.decode("latin-1").partition(":")
                headers[name.strip().lower()] = value.strip()
            return method, headers

    def _response(self, method: str, headers: dict[str, str]) -> bytes:
        lines = [f"CSeq: {headers.get('cseq', '0')}"]
        body = ""
        status = "200 OK"
        expected = "Basic " + b64encode(self.login.encode()).decode()
        if method != "OPTIONS" and self.login and headers.get("authorization") != expected:
            status = "401 Unauthorized"
            lines.append('WWW-Authenticate: Basic realm="camera"')
        elif method != "OPTIONS" and self.misbehaviour.status:
            status = self.misbehaviour.status
        elif method == "OPTIONS":
            lines.append("Public: OPTIONS, DESCRIBE, SETUP, PLAY, TEARDOWN, GET_PARAMETER")
        elif method == "DESCRIBE":
            body = self.stream.sdp
            lines += [f"Content-Base: rtsp://127.0.0.1:{self.port}/live/", "Content-Type: application/sdp"]
        elif method == "SETUP" and "interleaved" not in headers.get("transport", ""):
            status = "461 Unsupported Transport"
        elif method == "SETUP":
            lines += ["Transport: RTP/AVP/TCP;unicast;interleaved=0-1", "Session: 12345678;timeout=60"]
        else:
            lines.append("Session: 12345678")
        if body:
            lines.append(f"Content-Length: {len(body)}")
        return ("\r\n".join([f"RTSP/1.0 {status}", *lines, "", ""]) + body).encode()

    def _send(self, sock: socket.socket, sending: threading.Lock, done: threading.Event) -> None:
        misbehaviour = self.misbehaviour
        numbers = itertools.count(1000)
        begin_s = time.monotonic()
        for index, payloads in self._endless():
            if index == misbehaviour.end_after:
                shut_down(sock)
                return
            if index == misbehaviour.stall_after:
                return
            held_back_s = misbehaviour.hold_back.get(index, 0.0)
            if self.wait_until(begin_s, (index + 1) / self.rate_hz + held_back_s) or done.is_set():
                return
            stamp = round(index * _CLOCK_HZ / self.rate_hz) + 4_000_000
            with sending:
                try:
                    sock.sendall(self._packets(index, payloads, stamp, numbers))
                except OSError:
                    return

    def _endless(self) -> Iterator[tuple[int, RtpPayloads]]:
        return enumerate(itertools.cycle(self.stream.frames))

    def _packets(self, index: int, payloads: RtpPayloads, stamp: int, numbers: Iterator[int]) -> bytes:
        kind = _JPEG_TYPE if self.stream.coding == "jpeg" else _H264_TYPE
        data = b""
        for number, payload in enumerate(payloads):
            last = number == len(payloads) - 1
            head = struct.pack(">BBHII", 0x80, last << 7 | kind, next(numbers) & 0xFFFF, stamp, 0x7717)
            packet = head + payload
            if not (index in self.misbehaviour.lose_packet_of and number == len(payloads) // 2):
                data += b"$\x00" + struct.pack(">H", len(packet)) + packet
        return data
