"""Folders of pictures and videos that play as cameras."""

import asyncio
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from tests.integration.mjpeg_server import MjpegServer
from tests.unit.devices.cameras.pictures import SIZE, make_images, make_jpegs
from twinline.devices.camera import CameraFrame, CameraInfo
from twinline.devices.cameras.opening import open_camera
from twinline.devices.cameras.settings import CameraSettings
from twinline.errors import CameraError


async def play(
    path: Path, *, paced: bool = False, rate_hz: float | None = None
) -> tuple[CameraInfo, list[CameraFrame]]:
    camera = open_camera(CameraSettings(str(path), paced=paced, rate_hz=rate_hz, queue_frames=64))
    try:
        info = await camera.open()
        return info, [frame async for frame in camera.frames()]
    finally:
        await camera.close()


def write_video(path: Path, code: str, count: int) -> None:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*code), 25.0, SIZE)
    for image in make_images(count):
        writer.write(image)
    writer.release()


def write_motion_jpeg(path: Path, jpegs: list[bytes]) -> None:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mjpeg", rate=25)
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height = SIZE
        stream.pix_fmt = "yuvj420p"
        for number, jpeg in enumerate(jpegs):
            packet = av.Packet(jpeg)
            packet.stream, packet.time_base = stream, Fraction(1, 25)
            packet.pts = packet.dts = number
            container.mux(packet)


def spacings_s(frames: list[CameraFrame]) -> list[float]:
    times_s = [frame.host_time_s for frame in frames]
    return [round(float(step_s), 6) for step_s in np.diff(times_s)]


class TestFolder:
    async def test_jpeg_files_are_handed_on_byte_for_byte_in_the_order_of_their_numbers(self, tmp_path: Path) -> None:
        jpegs = make_jpegs(12)
        for number, jpeg in enumerate(jpegs):
            (tmp_path / f"frame{number}.jpg").write_bytes(jpeg)
        info, frames = await play(tmp_path, rate_hz=50.0)
        assert (info.encoding, info.image_size, info.rate_hz) == ("jpeg", SIZE, 50.0)
        assert [frame.data for frame in frames] == jpegs
        assert spacings_s(frames) == [0.02] * 11

    async def test_pictures_of_other_kinds_come_as_pixels(self, tmp_path: Path) -> None:
        images = make_images(2)
        cv2.imwrite(str(tmp_path / "a.png"), images[0])
        cv2.imwrite(str(tmp_path / "b.jpg"), images[1])
        cv2.imwrite(str(tmp_path / "c.png"), images[0][:, :, 2])
        info, frames = await play(tmp_path)
        assert info.encoding == "bgr8"
        assert frames[0].data == images[0].tobytes()
        assert frames[2].data == np.repeat(images[0][:, :, 2:], 3, axis=2).tobytes()

    async def test_broken_pictures_and_other_sizes_are_counted_and_the_rest_is_kept(self, tmp_path: Path) -> None:
        jpegs = make_jpegs(5)
        broken = {1: jpegs[1][:-20], 3: make_jpegs(1, size=(32, 24))[0]}
        for number, jpeg in enumerate(jpegs):
            (tmp_path / f"{number}.jpg").write_bytes(broken.get(number, jpeg))
        _, frames = await play(tmp_path)
        assert [frame.data for frame in frames] == [jpegs[0], jpegs[2], jpegs[4]]
        assert [(frame.sequence, frame.dropped) for frame in frames] == [(0, 0), (2, 1), (4, 2)]
        assert spacings_s(frames) == [0.08, 0.08]

    async def test_a_folder_of_nothing_but_broken_pictures_names_the_first_reason(self, tmp_path: Path) -> None:
        (tmp_path / "a.png").write_bytes(b"")
        with pytest.raises(CameraError, match=r"None of the 1 pictures .* can be used: .*a\.png is empty"):
            await play(tmp_path)


class TestVideo:
    async def test_motion_jpeg_is_handed_on_without_decoding(self, tmp_path: Path) -> None:
        write_video(tmp_path / "pass.avi", "MJPG", 8)
        info, frames = await play(tmp_path / "pass.avi")
        assert (info.encoding, info.image_size, info.rate_hz) == ("jpeg", SIZE, 25.0)
        with av.open(str(tmp_path / "pass.avi")) as container:
            packets = [bytes(packet) for packet in container.demux(video=0) if packet.size]
        assert [frame.data for frame in frames] == packets

    async def test_a_broken_picture_in_motion_jpeg_is_counted_and_the_rest_is_kept(self, tmp_path: Path) -> None:
        jpegs = make_jpegs(6)
        write_motion_jpeg(tmp_path / "pass.avi", [jpegs[0], jpegs[1], jpegs[2][:-30], *jpegs[3:]])
        _, frames = await play(tmp_path / "pass.avi")
        assert [frame.data for frame in frames] == [*jpegs[:2], *jpegs[3:]]
        assert [frame.dropped for frame in frames] == [0, 0, 1, 1, 1]

    async def test_other_codings_come_as_pixels_with_the_file_s_own_times(self, tmp_path: Path) -> None:
        write_video(tmp_path / "pass.mp4", "mp4v", 8)
        info, frames = await play(tmp_path / "pass.mp4")
        assert (info.encoding, info.live, info.ends) == ("bgr8", False, True)
        assert spacings_s(frames) == [0.04] * 7
        shown = [np.frombuffer(frame.data, np.uint8).reshape(SIZE[1], SIZE[0], 3) for frame in frames]
        for image, original in zip(shown, make_images(8), strict=True):
            assert int(image[:, :, 2].sum(axis=1).argmax()) == pytest.approx(
                int(original[:, :, 2].sum(axis=1, dtype=int).argmax()), abs=2
            )

    async def test_another_rate_can_be_chosen(self, tmp_path: Path) -> None:
        write_video(tmp_path / "pass.mp4", "mp4v", 4)
        info, frames = await play(tmp_path / "pass.mp4", rate_hz=10.0)
        assert info.rate_hz == 10.0
        assert spacings_s(frames) == [0.1] * 3

    async def test_a_paced_video_plays_to_its_end_like_a_camera(self, tmp_path: Path) -> None:
        write_video(tmp_path / "pass.mp4", "mp4v", 6)
        info, frames = await play(tmp_path / "pass.mp4", paced=True, rate_hz=200.0)
        assert (info.live, info.ends) == (True, True)
        assert [frame.sequence for frame in frames] == list(range(6))
        assert spacings_s(frames) == [0.005] * 5

    async def test_no_frame_of_a_paced_video_comes_before_its_time(self, tmp_path: Path) -> None:
        write_video(tmp_path / "pass.mp4", "mp4v", 8)
        camera = open_camera(CameraSettings(str(tmp_path / "pass.mp4"), rate_hz=50.0))
        await camera.open()
        early_s = [frame.host_time_s - asyncio.get_running_loop().time() async for frame in camera.frames()]
        await camera.close()
        # A timer may end a tick of the clock too early.
        assert max(early_s) < 0.001

    async def test_after_a_pause_a_paced_video_goes_on_from_now(self, tmp_path: Path) -> None:
        write_video(tmp_path / "pass.mp4", "mp4v", 12)
        camera = open_camera(CameraSettings(str(tmp_path / "pass.mp4"), rate_hz=25.0))
        await camera.open()
        async for _ in camera.frames():
            break
        await asyncio.sleep(1.6)
        resumed_s = asyncio.get_running_loop().time()
        frames = [frame async for frame in camera.frames()]
        await camera.close()
        assert frames[-1].sequence == 11
        assert frames[-1].host_time_s > resumed_s

    async def test_a_truncated_video_gives_what_is_there(self, tmp_path: Path) -> None:
        write_video(tmp_path / "whole.avi", "MJPG", 10)
        data = (tmp_path / "whole.avi").read_bytes()
        (tmp_path / "cut.avi").write_bytes(data[: len(data) // 2])
        _, frames = await play(tmp_path / "cut.avi")
        assert 2 <= len(frames) <= 6

    @pytest.mark.parametrize("data", [b"", b"no video at all" * 50, b"#EXTM3U\n#EXTINF:1,\n/etc/hostname\n"])
    async def test_a_file_that_is_no_video_is_refused(self, tmp_path: Path, data: bytes) -> None:
        (tmp_path / "pass.mp4").write_bytes(data)
        with pytest.raises(CameraError, match=r"pass\.mp4 is not a video that can be read"):
            await play(tmp_path / "pass.mp4")

    async def test_a_playlist_does_not_make_it_call_other_addresses(self, tmp_path: Path) -> None:
        with MjpegServer(make_jpegs(1)) as server:
            lines = ["#EXTM3U", "#EXT-X-TARGETDURATION:1", "#EXTINF:1,", f"http://127.0.0.1:{server.port}/pass.ts"]
            (tmp_path / "pass.m3u8").write_text("\n".join([*lines, "#EXT-X-ENDLIST", ""]))
            with pytest.raises(CameraError, match=r"pass\.m3u8"):
                await play(tmp_path / "pass.m3u8")
        assert server.connections == 0
