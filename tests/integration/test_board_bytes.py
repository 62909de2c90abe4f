"""Real bytes through a pseudo-terminal and through TCP, and programs that are ended with the lasers on."""

import asyncio
import signal
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from twinline.devices.serial.driver import SerialBoard
from twinline.devices.serial.port import port
from twinline.devices.simulator.board_ports import PtyPort, TcpPort
from twinline.devices.simulator.faults import Faults
from twinline.devices.simulator.simulated_board import SimulatedBoard
from twinline.errors import LinkError

PROGRAM = Path(__file__).with_name("laser_program.py")
STEP_MM = 0.10053
PATIENCE_S = 60.0


@asynccontextmanager
async def served(kind: str, folder: Path) -> AsyncIterator[tuple[SimulatedBoard, str]]:
    """A simulated board behind a port, and the port's URL."""
    machine = SimulatedBoard()
    if kind == "pty":
        terminal = PtyPort(machine, folder / "board")
        yield machine, terminal.url
        terminal.close()
    else:
        server = TcpPort(machine)
        await server.open()
        yield machine, server.url
        await server.close()
    machine.close()


def shining(machine: SimulatedBoard) -> bool:
    return bool(machine.lasers(asyncio.get_running_loop().time()))


async def until_dark(machine: SimulatedBoard) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while shining(machine):  # noqa: ASYNC110  (a look from outside)
            await asyncio.sleep(0.005)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["pty", "tcp"])
async def test_300_single_steps_over_a_bad_cable_are_300_steps(kind: str, tmp_path: Path) -> None:
    async with served(kind, tmp_path) as (machine, url), SerialBoard(port(url)) as board:
        machine.faults = Faults(corrupt_to_board=0.005, corrupt_to_host=0.005)
        for step in range(1, 301):
            await board.move("cart", step * STEP_MM, 10.0)
        assert machine.counts()[0] == 300


@pytest.mark.parametrize("kind", ["pty", "tcp"])
async def test_a_pulled_cable_darkens_and_a_plugged_one_is_found_again(kind: str, tmp_path: Path) -> None:
    async with served(kind, tmp_path) as (machine, url), SerialBoard(port(url)) as board:
        await board.lasers(frozenset({1, 2}))
        moving = asyncio.create_task(board.move("cart", 90.0, 10.0))
        await asyncio.sleep(0.1)
        machine.faults = Faults(unplugged=True)
        with pytest.raises(LinkError):
            await asyncio.wait_for(moving, PATIENCE_S)
        await until_dark(machine)
        machine.faults = Faults()
        async with asyncio.timeout(PATIENCE_S):
            while True:
                try:
                    await board.move("cart", 1.0, 20.0)
                    break
                except LinkError:
                    await asyncio.sleep(0.05)


async def test_a_port_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match="nothing-here"):
        await SerialBoard(port(str(tmp_path / "nothing-here"))).open()


async def test_two_programs_cannot_have_one_port(tmp_path: Path) -> None:
    async with served("pty", tmp_path) as (_, url), SerialBoard(port(url)):
        with pytest.raises(LinkError, match="lock"):
            await SerialBoard(port(url)).open()


@pytest.mark.parametrize(
    ("manner", "number"),
    [
        ("careful", signal.SIGTERM),
        ("careful", signal.SIGINT),
        ("careless", signal.SIGINT),
        ("careless", signal.SIGKILL),
    ],
)
async def test_a_program_that_is_ended_leaves_no_laser_on(manner: str, number: signal.Signals, tmp_path: Path) -> None:
    async with served("pty", tmp_path) as (machine, url):
        program = await asyncio.create_subprocess_exec(
            sys.executable, PROGRAM, url, manner, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.DEVNULL
        )
        assert program.stdout is not None
        assert await asyncio.wait_for(program.stdout.readline(), PATIENCE_S) == b"on\n"
        assert shining(machine)
        program.send_signal(number)
        await asyncio.wait_for(program.wait(), PATIENCE_S)
        if number is not signal.SIGKILL:
            # Its last words are in the terminal's buffer; only one that was killed needs the heartbeat's deadline.
            await asyncio.sleep(0.02)
            assert not shining(machine)
        await until_dark(machine)
