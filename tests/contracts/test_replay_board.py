"""A recording that plays as a board keeps the promises of every board: its passes are recorded first, then replayed."""

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from tests.contracts.board_contract import DARK, Bench, BoardContract
from tests.unit.recording.recorded_passes import header
from twinline.devices.board import AXES, Board, BoardEvent, LaserPass, Telemetry, TofRaster
from twinline.devices.replay.board import ReplayBoard
from twinline.devices.replay.descriptions import board_settings, plan_settings
from twinline.devices.replay.machine import machine_for
from twinline.devices.replay.playback import Playback
from twinline.devices.serial.driver import SerialBoard
from twinline.devices.simulator.cable import InProcessCable
from twinline.devices.simulator.simulated_board import SimulatedBoard
from twinline.devices.virtual_time import VirtualTimeLoop, run_virtual
from twinline.recording.pass_header import PassKind
from twinline.recording.pass_reader import Recording, open_recording
from twinline.recording.pass_writer import PassWriter

# The passes that the contract asks for, with the telemetry that it asks for.
PLANS: tuple[tuple[str, LaserPass | TofRaster, int], ...] = (
    ("steady", LaserPass(5.0, 15.0, 20.0), 100),
    ("turns", LaserPass(5.0, 15.0, 20.0, (frozenset({1}), frozenset({2}), DARK), 0.05), 200),
    ("raster", TofRaster(1.0, 3.0, 1.0, 2.0, 6.0, 20.0), 0),
)


async def record(path: Path, plan: LaserPass | TofRaster, rate_hz: int) -> None:
    """Record a pass of the simulated machine."""
    simulated = SimulatedBoard()
    board = SerialBoard(InProcessCable(simulated).connect)
    info = await board.open()
    for axis in AXES:
        await board.home(axis)
    await board.telemetry(rate_hz)
    messages = board.subscribe()
    settings = {"board": board_settings(info), "plan": plan_settings(plan)}
    kind: PassKind = "laser" if isinstance(plan, LaserPass) else "tof"
    with PassWriter(path, header(kind, settings=settings)) as writer:
        await drive(board, plan)
        await board.close()
        async for message in messages:
            if isinstance(message, Telemetry):
                writer.telemetry(message)
            elif isinstance(message, BoardEvent):
                writer.event(message)
    simulated.close()


async def drive(board: Board, plan: LaserPass | TofRaster) -> None:
    await (board.laser_pass(plan) if isinstance(plan, LaserPass) else board.raster(plan))


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Recording]:
    folder = tmp_path_factory.mktemp("passes")
    for name, plan, rate_hz in PLANS:
        run_virtual(record(folder / f"{name}.mcap", plan, rate_hz))
    return [open_recording(folder / f"{name}.mcap") for name, _, _ in PLANS]


class TestReplay(BoardContract):
    @pytest.fixture
    def anyio_backend(self) -> tuple[str, dict[str, object]]:
        return "asyncio", {"loop_factory": VirtualTimeLoop}

    @pytest.fixture
    async def bench(self, recordings: list[Recording]) -> AsyncIterator[Bench]:
        playback = Playback(recordings, armed=True)
        machine, simulated = machine_for(playback)

        def now() -> float:
            return asyncio.get_running_loop().time()

        yield Bench(
            ReplayBoard(playback, machine),
            shining=lambda: simulated.lasers(now()),
            cart_mm=lambda: simulated.cart_mm(now()),
            moving=lambda: simulated.moving,
        )
        simulated.close()

    async def test_a_pass_is_heard_as_it_was_recorded_to_the_last_bit(
        self, bench: Bench, recordings: list[Recording]
    ) -> None:
        board = bench.board
        await board.open()
        for axis in AXES:
            await board.home(axis)
        # The second plan is asked for first: the recording is found by it.
        recording, plan = recordings[1], PLANS[1][1]
        assert recording.header.settings["plan"] == plan_settings(plan)
        messages = board.subscribe()
        await drive(board, plan)
        await board.close()
        heard = [message async for message in messages if isinstance(message, Telemetry)]
        lines = [recording.telemetry.line(index) for index in range(len(heard))]
        assert len(heard) > 100
        for name in ("n", "host_time_s", "board_time_s", "cart_mm", "slide_mm", "adc", "flags"):
            assert [getattr(message, name) for message in heard] == [getattr(line, name) for line in lines]
