"""A recording as camera and board: what comes out is what went in, when its turn comes, under any clock."""

import asyncio
from collections.abc import AsyncIterator
from itertools import pairwise
from pathlib import Path

import pytest

from tests.unit.recording.recorded_passes import (
    FRAME_S,
    START_S,
    Happening,
    Kind,
    header,
    jpeg,
    line,
    shot,
    write_recording,
)
from twinline.devices.board import (
    AXES,
    DEFAULT_CART,
    DEFAULT_SLIDE,
    BoardEvent,
    BoardInfo,
    BoardMessage,
    LaserPass,
    Telemetry,
)
from twinline.devices.camera import CameraFrame
from twinline.devices.replay.board import ReplayBoard
from twinline.devices.replay.camera import ReplayCamera
from twinline.devices.replay.descriptions import board_info, board_settings
from twinline.devices.replay.machine import machine_for
from twinline.devices.replay.playback import Playback, open_playback
from twinline.devices.serial.protocol_gen import Flag
from twinline.devices.virtual_time import run_virtual
from twinline.errors import CaptureError, MotionError, RefusedError
from twinline.recording.capture import open_capture
from twinline.recording.pass_reader import open_recording
from twinline.recording.pass_writer import PassWriter
from twinline.recording.stored import StoredEncoding

PLAN = LaserPass(0.0, 10.0, 25.0)
FRAMES = 10


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "laser.mcap", FRAMES)


def now_s() -> float:
    return asyncio.get_running_loop().time()


async def collect(messages: AsyncIterator[BoardMessage]) -> list[BoardMessage]:
    return [message async for message in messages]


def board_of(playback: Playback) -> ReplayBoard:
    return ReplayBoard(playback, machine_for(playback)[0])


async def opened(board: ReplayBoard) -> None:
    await board.open()
    for axis in AXES:
        await board.home(axis)


class TestCamera:
    def test_frames_are_those_of_the_recording_to_the_last_bit(self, path: Path) -> None:
        async def main() -> None:
            camera = ReplayCamera(open_playback(path))
            await camera.open()
            frames = [frame async for frame in camera.frames()]
            assert [frame.data for frame in frames] == [jpeg(number) for number in range(FRAMES)]
            assert [frame.host_time_s for frame in frames] == [shot(number).host_time_s for number in range(FRAMES)]
            assert [(f.sequence, f.exposure_s, f.dropped) for f in frames] == [(n, 0.004, 0) for n in range(FRAMES)]

        run_virtual(main())

    @pytest.mark.parametrize("speed", [0.5, 1.0, 4.0])
    def test_frames_come_when_their_turn_comes(self, path: Path, speed: float) -> None:
        async def main() -> list[float]:
            camera = ReplayCamera(open_playback(path, speed=speed))
            await camera.open()
            begun_s = now_s()
            return [now_s() - begun_s async for _ in camera.frames()]

        expected = [number * FRAME_S / speed for number in range(FRAMES)]
        assert run_virtual(main()) == pytest.approx(expected, abs=1e-9)

    def test_as_fast_as_possible_no_time_passes(self, path: Path) -> None:
        async def main() -> float:
            camera = ReplayCamera(open_playback(path, speed=float("inf")))
            await camera.open()
            begun_s = now_s()
            assert len([frame async for frame in camera.frames()]) == FRAMES
            return now_s() - begun_s

        assert run_virtual(main()) == 0.0

    @pytest.mark.parametrize("encoding", ["gray8", "bgr8"])
    def test_pixels_come_as_pixels(self, tmp_path: Path, encoding: StoredEncoding) -> None:
        path = tmp_path / "pixels.mcap"
        with PassWriter(path, header()) as writer:
            writer.frame(shot(5, encoding))

        async def main() -> None:
            camera = ReplayCamera(Playback([open_recording(path)]))
            assert (await camera.open()).encoding == encoding
            (frame,) = [frame async for frame in camera.frames()]
            assert frame.data == shot(5, encoding).data

        run_virtual(main())

    def test_a_damaged_frame_is_counted_as_dropped(self, path: Path) -> None:
        frames = open_recording(path).parts["laser"]
        data = bytearray(path.read_bytes())
        data[frames[4].picture.at.offset + 40] ^= 1
        path.write_bytes(data)

        async def main() -> None:
            camera = ReplayCamera(open_playback(path))
            await camera.open()
            frames = [frame async for frame in camera.frames()]
            assert [(f.sequence, f.dropped) for f in frames] == [(n, int(n > 4)) for n in range(FRAMES) if n != 4]
            assert camera.status().dropped == 1

        run_virtual(main())

    def test_a_capture_folder_is_to_be_imported_first(self, tmp_path: Path) -> None:
        from tests.unit.reconstruction.small_pass import Pass, write_pass

        folder = write_pass(tmp_path / "folder", Pass().with_frames(2, 4.0))
        with pytest.raises(CaptureError, match="import it first"):
            open_playback(folder)


class TestBoard:
    def test_telemetry_and_events_are_those_of_the_recording_to_the_last_bit(self, path: Path) -> None:
        async def main() -> None:
            board = board_of(open_playback(path))
            await board.open()
            messages = asyncio.create_task(collect(board.subscribe()))
            await asyncio.sleep(10.0)
            await board.close()
            got = await messages
            lines = [message for message in got if isinstance(message, Telemetry)]
            wanted = [line(number) for number in range(len(lines))]
            assert len(lines) == 43
            for name in ("n", "host_time_s", "board_time_s", "cart_mm", "slide_mm", "adc", "flags", "earlier_adc"):
                assert [getattr(a, name) for a in lines] == [getattr(b, name) for b in wanted]
            assert [m.kind for m in got if isinstance(m, BoardEvent)] == ["scan-start", "motion-end"]
            assert lines[0].flags == Flag.LASER_1 | Flag.LASER_2

        run_virtual(main())

    def test_a_pass_ends_where_the_recorded_one_did(self, path: Path) -> None:
        async def main() -> None:
            playback = open_playback(path, armed=True)
            board, camera = board_of(playback), ReplayCamera(playback)
            await opened(board)
            await camera.open()
            frames: list[int] = []

            async def watch() -> None:
                async for frame in camera.frames():
                    frames[:] = [*frames, frame.sequence]

            watching = asyncio.create_task(watch())
            messages = board.subscribe()
            await board.move("cart", 20.0, 25.0)
            assert (await board.status()).cart_mm == pytest.approx(20.0, abs=0.06)
            await asyncio.sleep(5.0)
            assert frames == []
            await board.laser_pass(PLAN)
            assert frames == list(range(FRAMES))
            with pytest.raises(RefusedError) as caught:
                await board.laser_pass(PLAN)
            assert caught.value.code == "nothing-recorded"
            await camera.close()
            await board.close()
            await watching
            heard = await collect(messages)
            # Between the passes the machine that stands in is heard, during the pass only the recording.
            kinds = [message.kind for message in heard if isinstance(message, BoardEvent)]
            assert kinds[:3] == ["motion-end", "scan-start", "motion-end"]
            assert [m.host_time_s for m in heard if isinstance(m, Telemetry)] == [
                line(n).host_time_s for n in range(43)
            ]

        run_virtual(main())

    def test_a_pass_that_was_stopped_is_stopped_again(self, tmp_path: Path) -> None:
        path = tmp_path / "stopped.mcap"
        with PassWriter(path, header()) as writer:
            writer.telemetry(line(0))
            writer.event(Happening(3, START_S + 0.01, 0.0, Kind.MOTION_END, 0.0, 0.0, a=1, b=3))

        async def main() -> None:
            board = board_of(open_playback(path, armed=True))
            await opened(board)
            with pytest.raises(MotionError) as caught:
                await board.laser_pass(PLAN)
            assert caught.value.code == "e-stop"
            await board.close()

        run_virtual(main())

    def test_while_a_pass_plays_other_movements_are_refused_and_stop_ends_it(self, path: Path) -> None:
        async def main() -> None:
            board = board_of(open_playback(path, armed=True))
            await opened(board)
            playing = asyncio.create_task(board.laser_pass(PLAN))
            await asyncio.sleep(0.1)
            with pytest.raises(RefusedError) as refused:
                await board.move("cart", 1.0, 1.0)
            assert refused.value.code == "busy"
            with pytest.raises(RefusedError) as refused:
                await board.laser_pass(PLAN)
            assert refused.value.code == "busy"
            assert (await board.status()).lasers == {1, 2}
            await board.stop()
            with pytest.raises(MotionError) as stopped:
                await playing
            assert stopped.value.code == "stopped"
            assert (await board.status()).lasers == frozenset()
            await board.close()

        run_virtual(main())

    def test_places_beyond_the_axis_are_refused(self, path: Path) -> None:
        async def main() -> None:
            board = board_of(open_playback(path))
            await opened(board)
            with pytest.raises(RefusedError) as caught:
                await board.move("slide", 201.0, 10.0)
            assert caught.value.code == "out-of-range"
            await board.close()

        run_virtual(main())


def test_what_a_replay_records_gives_the_same_capture_to_the_last_bit(path: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.mcap"

    async def main() -> None:
        playback = open_playback(path, speed=3.0, armed=True)
        board, camera = board_of(playback), ReplayCamera(playback)
        await opened(board)
        await camera.open()
        with PassWriter(copy, header()) as writer:

            async def write_board() -> None:
                async for message in board.subscribe():
                    if isinstance(message, Telemetry):
                        writer.telemetry(message)

            async def write_camera() -> None:
                async for frame in camera.frames():
                    writer.frame(frame)

            tasks = [asyncio.create_task(write_board()), asyncio.create_task(write_camera())]
            await asyncio.sleep(0)
            await board.laser_pass(PLAN)
            await asyncio.sleep(1.0)
            await camera.close()
            await board.close()
            await asyncio.gather(*tasks)

    run_virtual(main())
    original, replayed = open_capture(path).laser, open_capture(copy).laser
    assert original is not None
    assert replayed is not None
    for a, b in zip(original.frames, replayed.frames, strict=True):
        assert (a.time_s, a.cart_mm, a.lasers) == (b.time_s, b.cart_mm, b.lasers)
        assert a.stored is not None
        assert b.stored is not None
        assert a.stored.raw_bytes() == b.stored.raw_bytes()


def test_driven_by_the_clock_a_replay_never_falls_silent_and_gives_the_same_pictures_and_places(
    tmp_path: Path,
) -> None:
    path, copy = tmp_path / "laser.mcap", tmp_path / "copy.mcap"
    with PassWriter(path, header()) as writer:
        writer.frame(shot(200), "laser/off")
        # The cart runs up for two seconds before the first frame that was kept.
        for number in range(300):
            writer.telemetry(line(number))
        for number in range(50, 60):
            writer.frame(shot(number))
        writer.event(Happening(1, line(280).host_time_s, line(280).board_time_s, Kind.MOTION_END, 0.0, 0.0, a=1))

    async def main() -> None:
        playback = open_playback(path, armed=True, stamps="loop")
        board, camera = board_of(playback), ReplayCamera(playback)
        await opened(board)
        await camera.open()
        frames: list[CameraFrame] = []
        lines: list[Telemetry] = []

        keep, hear = frames.append, lines.append

        async def watch_camera() -> None:
            async for frame in camera.frames():
                keep(frame)

        async def watch_board() -> None:
            async for message in board.subscribe():
                if isinstance(message, Telemetry):
                    hear(message)

        tasks = [asyncio.create_task(watch_camera()), asyncio.create_task(watch_board())]
        await asyncio.sleep(1.0)
        assert {frame.data for frame in frames} == {jpeg(200)}
        begun_s = now_s()
        await board.laser_pass(PLAN)
        ended_s = now_s()
        await asyncio.sleep(1.0)
        await camera.close()
        await board.close()
        await asyncio.gather(*tasks)
        times = [frame.host_time_s for frame in frames]
        assert all(0.0 < b - a < 0.1 for a, b in pairwise(times))
        assert [frame.sequence for frame in frames] == list(range(len(frames)))
        kept = [frame for frame in frames if frame.data != jpeg(200)]
        assert all(begun_s < frame.host_time_s < ended_s for frame in kept)
        assert all(begun_s <= line.host_time_s <= ended_s + 1.0 for line in lines)
        with PassWriter(copy, header()) as writer:
            for sample in lines:
                writer.telemetry(sample)
            for frame in kept:
                writer.frame(frame)

    run_virtual(main())
    original, replayed = open_capture(path).laser, open_capture(copy).laser
    assert original is not None
    assert replayed is not None
    for a, b in zip(original.frames, replayed.frames, strict=True):
        assert a.cart_mm == pytest.approx(b.cart_mm, abs=1e-9)
        assert a.stored is not None
        assert b.stored is not None
        assert a.stored.raw_bytes() == b.stored.raw_bytes()


def test_before_a_pass_the_picture_goes_by_the_lasers_that_are_on(tmp_path: Path) -> None:
    path = tmp_path / "laser.mcap"
    with PassWriter(path, header()) as writer:
        writer.frame(shot(9), "laser/off", lasers=frozenset())
        for number in range(4):
            writer.frame(shot(number), lasers=frozenset({1 + number % 2}))
            writer.telemetry(line(number))

    async def main() -> None:
        playback = open_playback(path, armed=True, stamps="loop")
        board, camera = board_of(playback), ReplayCamera(playback)
        await board.open()
        await camera.open()
        frames = camera.frames()
        for on, number in ((set(), 9), ({1}, 0), ({2}, 1), (set(), 9)):
            await board.lasers(frozenset(on))
            assert (await anext(frames)).data == jpeg(number)
        await board.lasers(frozenset({1}))
        await board.stop()
        assert (await anext(frames)).data == jpeg(9)
        await camera.close()
        await board.close()

    run_virtual(main())


def test_the_board_is_described_as_it_was() -> None:
    drives = {"cart": DEFAULT_CART, "slide": DEFAULT_SLIDE}
    info = BoardInfo("nucleo", "1.2", "ABCD", 7, drives, frozenset({1}), has_adc=False, max_telemetry_hz=200)  # type: ignore[arg-type]
    assert board_info({"board": board_settings(info)}, "other") == info
    assert board_info({}, "replay of x").name == "replay of x"
    assert board_info({"board": {"drives": 3}}, "replay of x").name == "replay of x"
