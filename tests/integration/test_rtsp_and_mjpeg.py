"""Network cameras against real servers on loopback: what they send, and everything that goes wrong with them."""

import asyncio
import re
import socket
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from itertools import pairwise
from typing import Literal

import cv2
import numpy as np
import pytest

from tests.integration.mjpeg_server import Behaviour, MjpegServer
from tests.integration.rtsp_server import Misbehaviour, RtspServer, Stream, h264_stream, jpeg_stream
from tests.unit.devices.cameras.pictures import SIZE, make_images, make_jpegs
from twinline.arrays import ByteArray
from twinline.devices.camera import Camera, CameraFrame, CameraState
from twinline.devices.cameras.opening import open_camera
from twinline.devices.cameras.settings import CameraSettings
from twinline.errors import CameraError

JPEGS = make_jpegs(8)
# A few frames of patience: stalls are found quickly, and a loaded machine is not taken for one.
STALL_S = 1.5


def settings_of(url: str, *, stall_s: float = 30.0) -> CameraSettings:
    """Settings with patience enough for any machine where silence is not what is tested."""
    return CameraSettings(url, connect_s=30.0, stall_s=stall_s, retry_s=(0.02, 0.1), queue_frames=200)


@asynccontextmanager
async def opened(settings: CameraSettings) -> AsyncIterator[Camera]:
    camera = open_camera(settings)
    try:
        await camera.open()
        yield camera
    finally:
        await camera.close()


async def take(camera: Camera, count: int) -> list[CameraFrame]:
    taken = []
    async for frame in camera.frames():
        taken.append(frame)
        if len(taken) == count:
            break
    return taken


async def refusal(settings: CameraSettings) -> CameraError:
    camera = open_camera(settings)
    with pytest.raises(CameraError) as caught:
        await camera.open()
    assert camera.status().state == CameraState.CLOSED
    assert caught.value.detail.endswith(".")
    return caught.value


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])


def camera_threads() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "camera"]


def red_row(image: ByteArray) -> int:
    """Row of the line in a test picture."""
    return int(image[:, :, 2].sum(axis=1, dtype=int).argmax())


class TestMjpegPictures:
    @pytest.mark.parametrize(
        "behaviour",
        [
            Behaviour(),
            Behaviour(announced="--frame"),
            Behaviour(announced="wrong"),
            Behaviour(announced=""),
            Behaviour(sent="frame"),
            Behaviour(newline=b"\n"),
            Behaviour(lengths="none"),
            Behaviour(lengths="none", pieces=700),
            Behaviour(lengths="short"),
            Behaviour(lengths="long"),
            Behaviour(lengths="nonsense"),
            Behaviour(boundary_first=True),
            Behaviour(boundary_first=True, lengths="none"),
            Behaviour(chunked=True),
            Behaviour(chunked=True, pieces=1000, lengths="none"),
        ],
        ids=str,
    )
    async def test_every_picture_comes_byte_for_byte_however_it_is_wrapped(self, behaviour: Behaviour) -> None:
        with MjpegServer(JPEGS, behaviour) as server:
            async with opened(settings_of(server.url)) as camera:
                frames = await take(camera, 12)
        first = JPEGS.index(frames[0].data)
        assert [frame.data for frame in frames] == [JPEGS[(first + n) % len(JPEGS)] for n in range(12)]
        assert frames[-1].dropped == 0
        assert {(frame.encoding, frame.image_size) for frame in frames} == {("jpeg", SIZE)}

    @pytest.mark.parametrize(
        "damage",
        [50, 4000, b"", b"no picture", b"\0" * 3000, JPEGS[0][:2000] + JPEGS[1]],
        ids=lambda value: str(value)[:20],
    )
    async def test_a_broken_picture_is_counted_and_the_rest_is_kept(self, damage: bytes | int) -> None:
        with MjpegServer(JPEGS, Behaviour(damage={20: damage, 23: damage})) as server:
            async with opened(settings_of(server.url)) as camera:
                frames = await take(camera, 28)
        losses = [b.sequence - a.sequence - 1 for a, b in pairwise(frames)]
        assert frames[-1].dropped == 2
        assert sorted(losses)[-3:] == [0, 1, 1]
        assert all(frame.data in JPEGS for frame in frames)

    async def test_the_camera_s_own_stamps_take_out_what_the_network_adds(self) -> None:
        behaviour = Behaviour(stamps=True, hold_back_s={15: 0.2, 25: 0.2})
        with MjpegServer(JPEGS, behaviour, rate_hz=50.0) as server:
            async with opened(settings_of(server.url)) as camera:
                frames = await take(camera, 35)
        steps_s = np.diff([frame.host_time_s for frame in frames])
        # The offset of the clocks is found better and better, which can only make a step shorter.
        assert steps_s.max() < 0.02 + 1e-6

    async def test_a_gap_in_the_stamps_is_a_loss(self) -> None:
        behaviour = Behaviour(stamps=True, skip=frozenset({20, 25, 26}))
        with MjpegServer(JPEGS, behaviour) as server:
            async with opened(settings_of(server.url)) as camera:
                frames = await take(camera, 30)
        assert frames[-1].dropped == 3

    @pytest.mark.parametrize("auth", ["basic", "digest"])
    async def test_a_password_is_given_in_the_way_that_the_camera_wants(self, auth: Literal["basic", "digest"]) -> None:
        with MjpegServer(JPEGS, login="operator:s3cr3t", auth=auth) as server:
            async with opened(settings_of(server.url)) as camera:
                assert len(await take(camera, 2)) == 2
        assert f"Authorization: {auth.capitalize()} " in server.requests[-1]

    async def test_a_redirection_is_followed(self) -> None:
        with MjpegServer(JPEGS) as target:
            elsewhere = Behaviour(status="302 Found", headers={"Location": f"{target.url}&moved=1"})
            with MjpegServer(JPEGS, elsewhere) as server:
                async with opened(settings_of(server.url)) as camera:
                    assert len(await take(camera, 2)) == 2
        assert "moved=1" in target.requests[0]

    async def test_the_password_of_one_camera_is_not_given_to_another(self) -> None:
        with MjpegServer(JPEGS, login="operator:s3cr3t") as target:
            elsewhere = Behaviour(status="302 Found", headers={"Location": f"http://127.0.0.1:{target.port}/stream"})
            with MjpegServer(JPEGS, elsewhere) as server:
                error = await refusal(settings_of(server.url.replace("http://", "http://operator:s3cr3t@")))
        assert "wants a user and password" in error.detail
        assert not any("Authorization" in request for request in target.requests)


class TestMjpegTrouble:
    @pytest.mark.parametrize(
        ("behaviour", "words"),
        [
            (Behaviour(status="404 Not Found"), "404 Not Found: there is no stream at this address"),
            (Behaviour(status="503 Service Unavailable"), "503 Service Unavailable"),
            (Behaviour(content_type="text/html"), "sends text/html"),
            (Behaviour(content_type="image/jpeg"), "a single picture instead of an MJPEG stream"),
            (Behaviour(damage=dict.fromkeys(range(40), b"no picture")), "The first 20 pictures .* are broken"),
            (Behaviour(end_after=0), "ended the stream"),
            (Behaviour(status="302 Found", headers={"Location": "ftp://x/"}), "redirects to an address that cannot"),
            (Behaviour(status="302 Found", headers={"Location": "/"}), "redirects again and again"),
        ],
        ids=lambda value: value if isinstance(value, str) else "",
    )
    async def test_a_camera_that_sends_something_else_is_refused_with_cause_and_next_step(
        self, behaviour: Behaviour, words: str
    ) -> None:
        with MjpegServer(JPEGS, behaviour) as server:
            error = await refusal(settings_of(server.url))
        assert re.search(words, error.detail)

    @pytest.mark.parametrize("login", ["", "operator:wrong@"])
    async def test_a_missing_or_wrong_password_is_told_without_showing_it(self, login: str) -> None:
        with MjpegServer(JPEGS, login="operator:s3cr3t") as server:
            error = await refusal(settings_of(f"http://{login}127.0.0.1:{server.port}/stream"))
        assert "401" in error.detail
        assert ("does not accept this user and password" if login else "wants a user and password") in error.detail
        assert "wrong" not in error.detail

    async def test_nobody_at_that_port_is_told_at_once(self) -> None:
        error = await refusal(settings_of(f"http://127.0.0.1:{free_port()}/"))
        assert "nothing listens" in error.detail
        assert error.code == "camera-disconnected"

    async def test_something_else_at_that_port_is_told_from_a_camera(self) -> None:
        with RtspServer(jpeg_stream(JPEGS)) as server:
            error = await refusal(settings_of(f"http://127.0.0.1:{server.port}/"))
        assert "does not answer in HTTP" in error.detail

    async def test_silence_while_connecting_is_given_up_after_the_time_that_was_set(self) -> None:
        with MjpegServer(JPEGS, Behaviour(silent=True)) as server:
            error = await refusal(CameraSettings(server.url, connect_s=0.2))
        assert error.code == "camera-timeout"
        assert "did not answer within 0.2 s" in error.detail

    @pytest.mark.parametrize("drip", [False, True])
    async def test_a_stream_that_falls_silent_is_connected_again(self, drip: bool) -> None:
        with MjpegServer(JPEGS, Behaviour(stall_after=10, drip=drip), Behaviour()) as server:
            async with opened(settings_of(server.url, stall_s=STALL_S)) as camera:
                frames = await take(camera, 20)
                assert camera.status().reconnections == 1
        assert [frame.sequence for frame in frames] == list(range(frames[0].sequence, frames[0].sequence + 20))
        assert all(a.host_time_s < b.host_time_s for a, b in pairwise(frames))

    async def test_a_cut_connection_is_made_again_as_often_as_needed(self) -> None:
        with MjpegServer(
            JPEGS, Behaviour(end_after=10), Behaviour(end_after=0), Behaviour(end_after=12), Behaviour()
        ) as server:
            async with opened(settings_of(server.url)) as camera:
                await take(camera, 30)
                assert camera.status().reconnections == 2
            assert server.connections == 4

    async def test_a_camera_that_was_switched_off_is_found_again(self) -> None:
        with MjpegServer(JPEGS, Behaviour(), Behaviour(status="503 Service Unavailable"), Behaviour()) as server:
            async with opened(settings_of(server.url)) as camera:
                iterator = camera.frames()
                await anext(iterator)
                server.disconnect_all()
                while camera.status().reconnections == 0:
                    await anext(iterator)
                assert camera.status().state == CameraState.STREAMING

    async def test_one_picture_of_another_size_is_survived_and_a_new_setting_is_not(self) -> None:
        (other,) = make_jpegs(1, size=(64, 48))
        with MjpegServer(JPEGS, Behaviour(damage={10: other}), Behaviour()) as server:
            async with opened(settings_of(server.url)) as camera:
                assert {frame.image_size for frame in await take(camera, 20)} == {SIZE}
        with MjpegServer(
            JPEGS, Behaviour(damage={10: other}), Behaviour(damage=dict.fromkeys(range(50), other))
        ) as server:
            async with opened(settings_of(server.url)) as camera:
                with pytest.raises(CameraError, match=r"64 x 48 px in jpeg .* 160 x 120 px"):
                    await take(camera, 40)

    async def test_closing_while_a_camera_keeps_silent_does_not_wait_for_it(self) -> None:
        with MjpegServer(JPEGS, Behaviour(silent=True)) as server:
            camera = open_camera(settings_of(server.url))
            opening = asyncio.create_task(camera.open())
            while not server.requests:  # noqa: ASYNC110 - the server knows no loop
                await asyncio.sleep(0.001)
            await camera.close()
            with pytest.raises(CameraError, match="closed while it was connecting"):
                await opening
            assert camera_threads() == []

    async def test_closing_a_stream_that_has_fallen_silent_does_not_wait_for_it(self) -> None:
        with MjpegServer(JPEGS, Behaviour(stall_after=3)) as server:
            camera = open_camera(settings_of(server.url))
            await camera.open()
            reading = asyncio.create_task(take(camera, 100))
            await asyncio.sleep(0.05)
            await camera.close()
            assert len(await reading) < 4
            assert camera_threads() == []

    async def test_cancelling_the_opening_lets_go_of_the_connection(self) -> None:
        with MjpegServer(JPEGS, Behaviour(silent=True), Behaviour()) as server:
            camera = open_camera(settings_of(server.url))
            opening = asyncio.create_task(camera.open())
            while not server.requests:  # noqa: ASYNC110 - the server knows no loop
                await asyncio.sleep(0.001)
            opening.cancel()
            with pytest.raises(asyncio.CancelledError):
                await opening
            assert camera_threads() == []
            await camera.open()
            assert len(await take(camera, 2)) == 2
            await camera.close()

    async def test_closing_ends_an_attempt_that_nobody_answers(self) -> None:
        # A listener that accepts nothing and whose queue is full lets everybody wait.
        with (
            socket.create_server(("127.0.0.1", 0), backlog=0) as listener,
            socket.socket() as first,
            socket.socket() as second,
        ):
            for sock in (first, second):
                sock.setblocking(False)
                sock.connect_ex(listener.getsockname())
            camera = open_camera(settings_of(f"http://127.0.0.1:{listener.getsockname()[1]}/"))
            opening = asyncio.create_task(camera.open())
            await asyncio.sleep(0.05)
            await camera.close()
            with pytest.raises(CameraError, match="closed while it was connecting"):
                await opening
            assert camera_threads() == []


class TestRtsp:
    async def test_jpeg_is_handed_on_with_the_very_pixels_of_the_camera(self) -> None:
        with RtspServer(jpeg_stream(JPEGS), rate_hz=50.0) as server:
            async with opened(settings_of(server.url)) as camera:
                frames = await take(camera, 10)
        assert {frame.encoding for frame in frames} == {"jpeg"}
        originals = [decode(jpeg) for jpeg in JPEGS]
        first = next(n for n, image in enumerate(originals) if np.array_equal(decode(frames[0].data), image))
        for number, frame in enumerate(frames):
            np.testing.assert_array_equal(decode(frame.data), originals[(first + number) % len(JPEGS)])

    async def test_h264_is_decoded_frame_by_frame_in_order(self) -> None:
        images = make_images(30)
        with RtspServer(h264_stream(images), rate_hz=50.0) as server:
            async with opened(settings_of(server.url)) as camera:
                frames = await take(camera, 20)
        assert {(frame.encoding, frame.image_size) for frame in frames} == {("bgr8", SIZE)}
        rows = [red_row(np.frombuffer(frame.data, np.uint8).reshape(SIZE[1], SIZE[0], 3)) for frame in frames]
        original = [red_row(image) for image in images]
        # Colour is coded at half the resolution: the brightest row of a line of three may be any of them.
        fits = [
            all(abs(row - original[(first + number) % 30]) <= 2 for number, row in enumerate(rows))
            for first in range(30)
        ]
        assert any(fits)

    @pytest.mark.parametrize("coding", ["jpeg", "h264"])
    async def test_time_stamps_are_the_camera_s_and_not_those_of_the_network(self, coding: str) -> None:
        stream = jpeg_stream(JPEGS) if coding == "jpeg" else h264_stream(make_images(10))
        with RtspServer(stream, rate_hz=50.0) as server:
            server.misbehaviour = Misbehaviour(hold_back={25: 0.2, 35: 0.2})
            async with opened(settings_of(server.url)) as camera:
                frames = await take(camera, 40)
        # Stamps of 90 kHz. The offset of the clocks is found better and better, which can only make a step shorter.
        assert np.diff([frame.host_time_s for frame in frames]).max() < 0.02 + 2e-5

    async def test_a_lost_packet_of_jpeg_costs_that_frame_and_is_counted(self) -> None:
        with RtspServer(jpeg_stream(make_jpegs(8, size=(320, 240))), rate_hz=50.0) as server:
            server.misbehaviour = Misbehaviour(lose_packet_of=frozenset({25, 30}))
            async with opened(settings_of(server.url)) as camera:
                frames = await take(camera, 40)
        assert frames[-1].dropped == 2

    async def test_after_a_lost_packet_of_h264_nothing_that_builds_on_it_is_delivered(self) -> None:
        images = make_images(40, size=(320, 240))
        with RtspServer(h264_stream(images, key_every=10), rate_hz=50.0) as server:
            server.misbehaviour = Misbehaviour(lose_packet_of=frozenset({34}))
            async with opened(settings_of(server.url)) as camera:
                frames = await take(camera, 45)
        # Frames 34 to 39 hang on the one that was hit; 40 stands by itself.
        assert frames[-1].dropped == 6

    @pytest.mark.parametrize("how", ["end", "stall"])
    async def test_a_stream_that_ends_or_falls_silent_is_connected_again(self, how: str) -> None:
        with RtspServer(jpeg_stream(JPEGS), rate_hz=50.0) as server:
            server.misbehaviour = Misbehaviour(
                end_after=20 if how == "end" else None, stall_after=20 if how == "stall" else None
            )
            async with opened(settings_of(server.url, stall_s=30.0 if how == "end" else STALL_S)) as camera:
                server.misbehaviour = Misbehaviour()
                frames = await take(camera, 40)
                assert camera.status().reconnections == 1
        assert [frame.sequence for frame in frames] == list(range(frames[0].sequence, frames[0].sequence + 40))
        assert all(a.host_time_s < b.host_time_s for a, b in pairwise(frames))

    @pytest.mark.parametrize(
        ("status", "words"),
        [
            ("404 Not Found", "has no such stream"),
            ("403 Forbidden", "wants a user and password"),
            ("503 Service Unavailable", "refuses"),
            ("461 Unsupported Transport", "refuses"),
        ],
    )
    async def test_a_refusal_is_told_with_its_cause(self, status: str, words: str) -> None:
        with RtspServer(jpeg_stream(JPEGS)) as server:
            server.misbehaviour = Misbehaviour(status=status)
            error = await refusal(settings_of(server.url))
        assert words in error.detail
        assert server.url in error.detail

    async def test_a_password_is_given_when_asked_for_and_never_shown(self) -> None:
        with RtspServer(jpeg_stream(JPEGS), login="operator:s3cr3t") as server:
            async with opened(settings_of(server.url)) as camera:
                assert len(await take(camera, 2)) == 2
            error = await refusal(settings_of(server.url.replace("s3cr3t", "wr0ng")))
            assert "does not accept this user and password" in error.detail
            assert "wr0ng" not in error.detail

    async def test_nobody_at_that_port_and_somebody_who_keeps_silent_are_told_apart(self) -> None:
        error = await refusal(settings_of(f"rtsp://127.0.0.1:{free_port()}/live"))
        assert "nothing listens" in error.detail
        with RtspServer(jpeg_stream(JPEGS)) as server:
            server.misbehaviour = Misbehaviour(silent=True)
            error = await refusal(CameraSettings(server.url, connect_s=0.3))
        assert error.code == "camera-timeout"
        assert "did not answer within 0.3 s" in error.detail

    async def test_something_else_at_that_port_is_told_from_a_camera(self) -> None:
        with MjpegServer(JPEGS) as server:
            error = await refusal(CameraSettings(f"rtsp://127.0.0.1:{server.port}/live", connect_s=2.0))
        assert f"rtsp://127.0.0.1:{server.port}/live" in error.detail

    async def test_a_stream_without_key_frames_is_given_up_with_what_to_set(self) -> None:
        with RtspServer(without_key_frames(), rate_hz=50.0) as server:
            error = await refusal(settings_of(server.url, stall_s=0.3))
        assert "Nothing from" in error.detail
        assert "key frame every second" in error.detail

    async def test_closing_ends_the_waiting_for_a_key_frame(self) -> None:
        with RtspServer(without_key_frames(), rate_hz=50.0) as server:
            camera = open_camera(settings_of(server.url))
            opening = asyncio.create_task(camera.open())
            while "PLAY" not in server.methods:  # noqa: ASYNC110 - the server knows no loop
                await asyncio.sleep(0.01)
            await camera.close()
            with pytest.raises(CameraError, match="closed while it was connecting"):
                await opening
            assert camera_threads() == []

    async def test_closing_says_goodbye_to_the_camera(self) -> None:
        with RtspServer(jpeg_stream(JPEGS), rate_hz=50.0) as server:
            async with opened(settings_of(server.url)) as camera:
                await take(camera, 3)
        assert server.methods[-1] == "TEARDOWN"


def without_key_frames() -> Stream:
    stream = h264_stream(make_images(30), key_every=10)
    frames = [frame for number, frame in enumerate(stream.frames) if number % 10]
    return Stream("h264", frames, stream.parameter_sets)


def decode(jpeg: bytes) -> ByteArray:
    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return np.asarray(image, dtype=np.uint8)
