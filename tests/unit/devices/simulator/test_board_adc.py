"""Readings of the distance sensor in the telemetry."""

import asyncio

import numpy as np
import pytest

from twinline.arrays import FloatArray
from twinline.devices.board import Telemetry
from twinline.devices.serial.driver import SerialBoard
from twinline.devices.serial.protocol_gen import ADC_FULL_SCALE, Flag
from twinline.devices.simulator.cable import InProcessCable
from twinline.devices.simulator.simulated_board import SimulatedBoard
from twinline.devices.virtual_time import VirtualTimeLoop


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, object]]:
    return "asyncio", {"loop_factory": VirtualTimeLoop}


class Slope:
    """A sensor whose count is a line over the slide, and which remembers when it was asked."""

    def __init__(self) -> None:
        self.times_s: list[float] = []

    def __call__(self, cart_mm: FloatArray, slide_mm: FloatArray, host_time_s: FloatArray) -> FloatArray:
        assert cart_mm.shape == slide_mm.shape == host_time_s.shape
        self.times_s.extend(host_time_s.tolist())
        return np.asarray(2000.0 + 10.0 * slide_mm)


async def sampled(adc: Slope, samples: int) -> tuple[list[Telemetry], SimulatedBoard]:
    machine = SimulatedBoard(adc=adc)
    async with SerialBoard(InProcessCable(machine).connect) as board:
        await board.telemetry(100, samples=samples)
        messages = board.subscribe()
        await board.move("slide", 20.0, 20.0)
        await board.status()
        await asyncio.sleep(0.1)
    machine.close()
    return [message async for message in messages if isinstance(message, Telemetry)], machine


@pytest.mark.parametrize("samples", [1, 4])
async def test_each_reading_is_the_mean_of_a_thousand_conversions_a_second(samples: int) -> None:
    adc = Slope()
    lines, _ = await sampled(adc, samples)
    # The slide begins 30 mm from its switch, so that its count 0 is there.
    middle = lines[len(lines) // 2 : len(lines) // 2 + 5]
    for line in middle:
        readings = [*line.earlier_adc, line.adc]
        assert len(readings) == samples
        for number, reading in enumerate(readings):
            # A mean is as old as the middle of its conversions: the speed is 0.02 mm/ms.
            age_ms = (samples - 1 - number) * 10.0 / samples + (10 // samples - 1) / 2.0
            assert reading / 16 == pytest.approx(2000.0 + 10.0 * (30.0 + line.slide_mm - 0.02 * age_ms), abs=0.25)
        assert not line.flags & (Flag.ADC_BROKEN | Flag.ADC_CLIPPED)


async def test_the_sensor_is_never_asked_about_the_past() -> None:
    adc = Slope()
    await sampled(adc, 1)
    assert len(adc.times_s) > 500
    assert all(after > before for before, after in zip(adc.times_s, adc.times_s[1:], strict=False))


async def test_without_a_sensor_the_input_reads_as_an_open_wire() -> None:
    machine = SimulatedBoard()
    async with SerialBoard(InProcessCable(machine).connect) as board:
        status = await board.status()
        assert status.adc == ADC_FULL_SCALE
        await board.telemetry(50)
        line = await anext(board.subscribe())
        assert isinstance(line, Telemetry)
        assert Flag.ADC_BROKEN | Flag.ADC_CLIPPED in line.flags
    machine.close()
