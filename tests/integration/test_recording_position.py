"""The positions that a recording gives its frames, against where the simulated cart truly was."""

import asyncio
from pathlib import Path

import numpy as np
import pytest

from tests.unit.recording.recorded_passes import Shot, header
from twinline.devices.board import DEFAULT_CART, LaserPass, Telemetry
from twinline.devices.serial.driver import SerialBoard
from twinline.devices.simulator.cable import InProcessCable
from twinline.devices.simulator.simulated_board import MachineSettings, SimulatedBoard
from twinline.devices.virtual_time import run_virtual
from twinline.recording.capture import open_capture
from twinline.recording.pass_writer import PassWriter

BUDGET_MM = 0.05
PLAN = LaserPass(20.0, 320.0, speed_mm_s=50.0)
FRAME_S = 0.0411
"""Not a multiple of anything in the board."""


async def record(path: Path, rate_hz: int, drift_ppm: float) -> dict[float, float]:
    """Record a laser pass of the simulated machine, frames with their times only; where the cart truly was at each."""
    simulated = SimulatedBoard(MachineSettings(clock_drift_ppm=drift_ppm))
    board = SerialBoard(InProcessCable(simulated).connect)
    await board.open()
    await board.home("cart")
    await board.telemetry(rate_hz)
    truth: dict[float, float] = {}
    with PassWriter(path, header()) as writer:

        async def write_board() -> None:
            async for message in board.subscribe():
                if isinstance(message, Telemetry):
                    writer.telemetry(message)

        async def write_camera() -> None:
            while True:
                await asyncio.sleep(FRAME_S)
                time_s = asyncio.get_running_loop().time()
                truth[time_s] = simulated.cart_mm(time_s)
                writer.frame(Shot(len(truth), time_s, None, "gray8", b"\0", (1, 1)))

        tasks = [asyncio.create_task(write_board()), asyncio.create_task(write_camera())]
        await asyncio.sleep(0.3)
        await board.laser_pass(PLAN)
        await asyncio.sleep(0.3)
        tasks[1].cancel()
        await board.close()
        await asyncio.gather(*tasks, return_exceptions=True)
    simulated.close()
    return truth


@pytest.mark.parametrize(("rate_hz", "drift_ppm"), [(50, 0.0), (100, 40.0), (200, -40.0)])
def test_frames_lie_within_the_budget_of_where_the_cart_truly_was(
    tmp_path: Path, rate_hz: int, drift_ppm: float
) -> None:
    path = tmp_path / "laser.mcap"
    truth = run_virtual(record(path, rate_hz, drift_ppm))
    laser = open_capture(path).laser
    assert laser is not None
    assert len(laser) >= len(truth) - 2
    true_mm = np.array([truth[entry.time_s] for entry in laser.frames])
    errors_mm = np.abs(np.array([entry.cart_mm for entry in laser.frames]) - true_mm)
    in_range = (true_mm >= PLAN.from_mm) & (true_mm <= PLAN.to_mm)
    assert in_range.sum() > 140
    assert errors_mm[in_range].max() < 0.5 * BUDGET_MM
    # Before its first step is complete nobody knows how far the motor is in it.
    assert errors_mm.max() < BUDGET_MM + 0.5 * DEFAULT_CART.mm_per_step
