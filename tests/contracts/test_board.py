"""Every kind of board keeps the same promises."""

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from tests.contracts.board_contract import Bench, BoardContract
from twinline.devices.serial.driver import SerialBoard
from twinline.devices.serial.port import port
from twinline.devices.serial.streams import Connect
from twinline.devices.simulator.axis import Mechanics
from twinline.devices.simulator.board_ports import PtyPort, TcpPort
from twinline.devices.simulator.cable import InProcessCable
from twinline.devices.simulator.simulated_board import MachineSettings, SimulatedBoard
from twinline.devices.virtual_time import VirtualTimeLoop

# The slide begins near its switch, so that homing is quick where time is real.
SLIDE = Mechanics(0.005, switches_mm=(0.0, 210.0), stops_mm=(-6.0, 216.0), start_mm=1.0)


def machine() -> SimulatedBoard:
    return SimulatedBoard(MachineSettings(slide=SLIDE, clock_drift_ppm=30.0))


def bench_of(simulated: SimulatedBoard, connect: Connect) -> Bench:
    def now() -> float:
        return asyncio.get_running_loop().time()

    return Bench(
        SerialBoard(connect),
        shining=lambda: simulated.lasers(now()),
        cart_mm=lambda: simulated.cart_mm(now()),
        moving=lambda: simulated.moving,
    )


class TestSerialOverInProcessCable(BoardContract):
    @pytest.fixture
    def anyio_backend(self) -> tuple[str, dict[str, object]]:
        return "asyncio", {"loop_factory": VirtualTimeLoop}

    @pytest.fixture
    async def bench(
        self,
    ) -> AsyncIterator[Bench]:
        simulated = machine()
        yield bench_of(simulated, InProcessCable(simulated).connect)
        simulated.close()


@pytest.mark.slow
class TestSerialOverPseudoTerminal(BoardContract):
    @pytest.fixture
    async def bench(self, tmp_path: Path) -> AsyncIterator[Bench]:
        simulated = machine()
        terminal = PtyPort(simulated, tmp_path / "board")
        yield bench_of(simulated, port(terminal.url))
        terminal.close()
        simulated.close()


@pytest.mark.slow
class TestSerialOverTcp(BoardContract):
    @pytest.fixture
    async def bench(
        self,
    ) -> AsyncIterator[Bench]:
        simulated = machine()
        server = TcpPort(simulated)
        await server.open()
        yield bench_of(simulated, port(server.url))
        await server.close()
        simulated.close()
