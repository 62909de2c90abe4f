"""The driver against the simulated board, in virtual time."""

import asyncio
from collections.abc import AsyncIterator
from dataclasses import replace
from itertools import pairwise
from math import pi

import pytest

from twinline.devices.board import BoardEvent, LaserPass, LinkChange, Telemetry
from twinline.devices.serial.codec import TIME_WRAP_US
from twinline.devices.serial.driver import SerialBoard
from twinline.devices.serial.protocol_gen import EVENTS_KEPT, EventKind, Latch
from twinline.devices.serial.requests import PATIENCE_S
from twinline.devices.serial.streams import ByteStream, Chunk
from twinline.devices.simulator.axis import Mechanics
from twinline.devices.simulator.cable import InProcessCable
from twinline.devices.simulator.faults import Faults
from twinline.devices.simulator.simulated_board import MachineSettings, SimulatedBoard
from twinline.devices.virtual_time import VirtualTimeLoop
from twinline.errors import DeviceError, DeviceTimeoutError, LinkError, MotionError, RefusedError

STEP_MM = 0.10053
NOISY = Faults(corrupt_to_board=0.005, corrupt_to_host=0.005)


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, object]]:
    return "asyncio", {"loop_factory": VirtualTimeLoop}


@pytest.fixture
async def machine() -> AsyncIterator[SimulatedBoard]:
    simulated = SimulatedBoard()
    yield simulated
    simulated.close()


@pytest.fixture
async def board(machine: SimulatedBoard) -> AsyncIterator[SerialBoard]:
    async with SerialBoard(InProcessCable(machine).connect) as serial_board:
        yield serial_board


def now_s() -> float:
    return asyncio.get_running_loop().time()


@pytest.mark.parametrize("seed", range(4))
async def test_300_single_steps_over_a_bad_cable_are_300_steps(seed: int) -> None:
    machine = SimulatedBoard()
    async with SerialBoard(InProcessCable(machine, seed=seed).connect) as board:
        machine.faults = NOISY
        begin_s = now_s()
        for step in range(1, 301):
            await board.move("cart", step * STEP_MM, 10.0)
            assert machine.counts()[0] == step
        assert machine.counts()[0] == 300
        assert machine.cart_mm(now_s()) == pytest.approx(300 * STEP_MM)
        assert now_s() - begin_s < 60.0
    machine.close()


async def test_every_event_comes_once_and_in_order_over_a_bad_cable(
    machine: SimulatedBoard, board: SerialBoard
) -> None:
    messages = board.subscribe()
    machine.faults = Faults(corrupt_to_board=0.01, corrupt_to_host=0.01)
    for step in range(1, 101):
        await board.move("cart", step * STEP_MM, 10.0)
    machine.faults = Faults()
    await asyncio.sleep(0.5)
    await board.close()
    events = [message async for message in messages if isinstance(message, BoardEvent)]
    assert [event.kind for event in events] == [EventKind.MOTION_END] * 100
    assert all(after.n == before.n + 1 for before, after in pairwise(events))


async def test_a_burst_of_events_over_a_very_bad_cable_comes_whole_and_soon(
    machine: SimulatedBoard, board: SerialBoard
) -> None:
    messages = board.subscribe()
    pressed: list[int] = []
    machine.faults = Faults(corrupt_to_host=0.01)
    for number in range(300):
        machine.faults = replace(machine.faults, low_switch=number % 2 == 0)
        pressed.append(1 - number % 2)
        await asyncio.sleep(0.02)
    machine.faults = replace(machine.faults, corrupt_to_host=0.0)
    await asyncio.sleep(0.2)
    end_s = now_s()
    await board.close()
    events = [message async for message in messages if isinstance(message, BoardEvent)]
    assert [event.b for event in events if event.kind is EventKind.LIMIT] == pressed
    assert all(after.n == before.n + 1 for before, after in pairwise(events))
    assert all(event.host_time_s < end_s for event in events)


async def test_a_gap_in_the_events_is_filled_before_the_next_heartbeat(
    machine: SimulatedBoard, board: SerialBoard
) -> None:
    messages = board.subscribe()
    # Just after a heartbeat, so that none of them can be what fills the gap.
    await asyncio.sleep(0.11)
    machine.faults = Faults(lose_to_host=1.0, low_switch=True)
    await asyncio.sleep(0.01)
    machine.faults = Faults(low_switch=False)
    begin_s = now_s()
    events = [await anext(messages) for _ in range(2)]
    assert [event.b for event in events if isinstance(event, BoardEvent)] == [1, 0]
    assert now_s() - begin_s < 0.04


async def test_the_loss_of_the_newest_event_shows_with_the_next_heartbeat(
    machine: SimulatedBoard, board: SerialBoard
) -> None:
    moving = asyncio.create_task(board.move("cart", STEP_MM, 10.0))
    # The single step takes 21 ms: the answer passes, and what comes at the end of the step is lost.
    await asyncio.sleep(0.01)
    machine.faults = Faults(lose_to_host=1.0)
    await asyncio.sleep(0.03)
    machine.faults = Faults()
    assert not moving.done()
    await asyncio.wait_for(moving, 0.3)


async def test_a_movement_whose_events_are_gone_for_good_fails(machine: SimulatedBoard, board: SerialBoard) -> None:
    moving = asyncio.create_task(board.move("cart", 90.0, 20.0))
    await asyncio.sleep(0.05)
    machine.faults = Faults(lose_to_host=1.0)
    for number in range(EVENTS_KEPT + 5):
        machine.faults = replace(machine.faults, low_switch=number % 2 == 0)
    await asyncio.sleep(0.3)
    machine.faults = Faults()
    with pytest.raises(DeviceError) as lost:
        await moving
    assert lost.value.code == "events-lost"


@pytest.mark.parametrize("after_ms", range(0, 14, 2))
async def test_stopping_overtakes_commands_that_are_being_sent_again(
    machine: SimulatedBoard, board: SerialBoard, after_ms: int
) -> None:
    moving = asyncio.create_task(board.move("cart", 50.0, 20.0))
    waiting = asyncio.create_task(board.move("slide", 5.0, 20.0))
    await asyncio.sleep(after_ms / 1000)
    machine.faults = Faults(lose_to_board=1.0)
    await asyncio.sleep(0.1)
    stopping = asyncio.create_task(board.stop())
    await asyncio.sleep(0.01)
    machine.faults = Faults()
    await stopping
    for task in (moving, waiting):
        with pytest.raises((RefusedError, MotionError)) as refusal:
            await task
        assert refusal.value.code == "stopped"
    await asyncio.sleep(1.0)
    assert not machine.moving
    # What had begun before may have been braked; nothing began afterwards.
    assert machine.counts()[0] < 100


async def test_a_line_that_the_board_complains_of_is_sent_again_at_once(
    machine: SimulatedBoard, board: SerialBoard
) -> None:
    await asyncio.sleep(0.02)
    machine.faults = Faults(corrupt_to_board=0.1)
    asking = [asyncio.create_task(board.status()) for _ in range(5)]
    await asyncio.sleep(0.006)
    machine.faults = Faults()
    begin_s = now_s()
    await asyncio.gather(*asking)
    assert now_s() - begin_s < PATIENCE_S / 2


async def test_a_port_has_one_user(machine: SimulatedBoard) -> None:
    cable = InProcessCable(machine)
    async with SerialBoard(cable.connect) as first:
        with pytest.raises(LinkError, match="another"):
            await SerialBoard(cable.connect).open()
        await first.status()
    async with SerialBoard(cable.connect) as second:
        await second.status()


async def test_requests_fail_at_once_when_the_cable_is_pulled(machine: SimulatedBoard, board: SerialBoard) -> None:
    machine.faults = Faults(lose_to_board=1.0)
    waiting = [asyncio.create_task(board.status()) for _ in range(3)]
    await asyncio.sleep(0.01)
    begin_s = now_s()
    machine.faults = Faults(unplugged=True)
    for task in waiting:
        with pytest.raises(LinkError):
            await task
    with pytest.raises(LinkError):
        await board.status()
    assert now_s() - begin_s < 0.01


@pytest.mark.parametrize("restarted", [False, True])
async def test_a_cable_that_comes_back_is_used_again_with_the_same_telemetry(
    machine: SimulatedBoard, board: SerialBoard, restarted: bool
) -> None:
    await board.telemetry(20)
    messages = board.subscribe()
    machine.faults = Faults(unplugged=True)
    await asyncio.sleep(30.0)
    if restarted:
        machine.reset()
    machine.faults = Faults()
    await asyncio.sleep(6.0)
    await board.close()
    seen = [message async for message in messages]
    states = [message.state for message in seen if isinstance(message, LinkChange)]
    assert states == ["down", "up", "closed"]
    assert sum(isinstance(message, Telemetry) for message in seen) > 15


async def test_what_happened_while_the_cable_was_out_is_told_afterwards(
    machine: SimulatedBoard, board: SerialBoard
) -> None:
    await board.lasers(frozenset({1}))
    messages = board.subscribe()
    machine.faults = Faults(unplugged=True)
    await asyncio.sleep(3.0)
    machine.faults = Faults()
    await asyncio.sleep(3.0)
    assert not (await board.status()).latch
    await board.close()
    events = [message async for message in messages if isinstance(message, BoardEvent)]
    latches = [event.a for event in events if event.kind is EventKind.LATCH]
    assert latches == [Latch.HEARTBEAT, Latch.NONE]


async def test_a_restart_of_the_board_is_noticed_even_if_its_event_is_lost(
    machine: SimulatedBoard, board: SerialBoard
) -> None:
    messages = board.subscribe()
    moving = asyncio.create_task(board.move("cart", 90.0, 20.0))
    await asyncio.sleep(0.1)
    machine.faults = Faults(lose_to_host=1.0)
    machine.reset()
    await asyncio.sleep(0.06)
    machine.faults = Faults()
    with pytest.raises(LinkError) as lost:
        await moving
    assert lost.value.code == "board-restarted"
    await asyncio.sleep(1.0)
    await board.close()
    boots = [m async for m in messages if isinstance(m, BoardEvent) and m.kind is EventKind.BOOT]
    assert len(boots) == 1


async def test_an_emergency_stop_must_be_released_and_reset(machine: SimulatedBoard, board: SerialBoard) -> None:
    machine.faults = Faults(e_stop=True)
    with pytest.raises(RefusedError) as refusal:
        await board.reset()
    assert refusal.value.code == "e-stop-active"
    machine.faults = Faults()
    for command in (board.lasers(frozenset({1})), board.move("cart", 1.0, 10.0)):
        with pytest.raises(RefusedError) as refusal:
            await command
        assert refusal.value.code == "latched"
    await board.reset()
    await board.move("cart", 1.0, 10.0)


async def test_the_slide_does_not_go_further_into_a_pressed_switch(machine: SimulatedBoard, board: SerialBoard) -> None:
    with pytest.raises(MotionError) as end:
        await board.move("slide", -60.0, 40.0)
    assert end.value.code == "limit"
    assert -5.0 < machine.slide_mm(now_s()) < -3.0
    with pytest.raises(RefusedError) as refusal:
        await board.move("slide", -60.0, 40.0)
    assert refusal.value.code == "limit-active"
    await board.move("slide", 0.0, 40.0)


async def test_steps_lost_on_the_slide_are_told_at_the_switch(machine: SimulatedBoard, board: SerialBoard) -> None:
    await board.home("slide")
    await board.move("slide", 20.0, 20.0)
    messages = board.subscribe()
    moving = asyncio.create_task(board.move("slide", 40.0, 20.0))
    await asyncio.sleep(0.5)
    machine.faults = Faults(stalled=frozenset({"slide"}))
    await asyncio.sleep(0.05)
    machine.faults = Faults()
    await moving
    await board.move("slide", 0.0, 20.0)
    await board.close()
    drifts = [m.b for m in [m async for m in messages] if isinstance(m, BoardEvent) and m.kind is EventKind.DRIFT]
    assert drifts == [pytest.approx(0.05 * 20.0 / 0.005, abs=5)]


async def test_another_protocol_is_refused() -> None:
    machine = SimulatedBoard(MachineSettings(protocol_hash="0BADF00D"))
    board = SerialBoard(InProcessCable(machine).connect)
    with pytest.raises(DeviceError, match="0BADF00D") as mismatch:
        await board.open()
    assert mismatch.value.code == "firmware-mismatch"
    machine.close()


class SilentStream:
    """A port with nothing at the other end."""

    async def read(self) -> Chunk:
        never: asyncio.Future[Chunk] = asyncio.get_running_loop().create_future()
        return await never

    def write(self, data: bytes) -> None:
        pass

    async def close(self) -> None:
        pass


async def test_a_silent_port_is_given_up_after_a_second() -> None:
    async def connect() -> ByteStream:
        return SilentStream()

    begin_s = now_s()
    with pytest.raises(DeviceTimeoutError, match="HELLO"):
        await SerialBoard(connect).open()
    assert now_s() - begin_s < 1.5


async def test_a_board_without_cable_cannot_be_opened(machine: SimulatedBoard) -> None:
    machine.faults = Faults(unplugged=True)
    with pytest.raises(LinkError, match="pulled"):
        await SerialBoard(InProcessCable(machine).connect).open()


async def test_positions_of_telemetry_are_true_to_a_twentieth_of_a_millimetre() -> None:
    cart = Mechanics(STEP_MM, ripple_mm=0.0)
    machine = SimulatedBoard(MachineSettings(cart=cart, clock_drift_ppm=60.0, clock_start_us=TIME_WRAP_US - 6_000_000))
    async with SerialBoard(InProcessCable(machine).connect) as board:
        await board.home("cart")
        await board.telemetry(100)
        messages = board.subscribe()
        passing = asyncio.create_task(board.laser_pass(LaserPass(0.0, 300.0, 50.0)))
        errors: list[float] = []
        while not passing.done() or len(errors) < 100:
            message = await anext(messages)
            if isinstance(message, Telemetry):
                errors.append(message.cart_mm - machine.cart_mm(message.host_time_s))
        await passing
    machine.close()
    assert len(errors) > 600
    # While the speed changes, half a step is unknown; then a sixteenth (0.006 mm) and 60 ppm of 1 s (0.003 mm) are.
    assert max(map(abs, errors)) < 0.05
    assert max(map(abs, errors[60:-60])) < 0.012


async def test_a_ripple_of_the_drive_shows_in_the_machine_and_not_in_the_counts() -> None:
    cart = Mechanics(STEP_MM, scale_error=0.002, ripple_mm=0.05, ripple_period_mm=40.0 * pi)
    machine = SimulatedBoard(MachineSettings(cart=cart))
    async with SerialBoard(InProcessCable(machine).connect) as board:
        await board.move("cart", 300 * STEP_MM, 50.0)
        assert (await board.status()).cart_mm == pytest.approx(300 * STEP_MM)
        assert machine.cart_mm(now_s()) == pytest.approx(300 * STEP_MM * 1.002 + 0.05, abs=0.002)
    machine.close()


async def test_no_task_outlives_the_board(machine: SimulatedBoard) -> None:
    before = asyncio.all_tasks()
    board = SerialBoard(InProcessCable(machine).connect)
    await board.open()
    await board.close()
    await asyncio.sleep(0)
    assert asyncio.all_tasks() == before
