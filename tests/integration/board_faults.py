"""Faults of the board and its cable in the middle of a movement with light: what happens, and what the user reads."""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace

from twinline.devices.board import AXES, Board, LaserPass, TofRaster
from twinline.devices.serial.driver import SerialBoard
from twinline.devices.simulator.axis import Mechanics
from twinline.devices.simulator.cable import InProcessCable
from twinline.devices.simulator.faults import Faults
from twinline.devices.simulator.simulated_board import MachineSettings, SimulatedBoard
from twinline.devices.virtual_time import run_virtual
from twinline.errors import TwinlineError

FAULT_AFTER_S = 1.0
PATIENCE_S = 60.0
"""Longer than anything here may take: what is not over by then hangs."""
SLIDE = Mechanics(0.005, switches_mm=(0.0, 210.0), stops_mm=(-6.0, 216.0), start_mm=5.0)
LASER_PASS, RASTER, HOMING = "laser pass", "ToF pass", "homing the slide"
Inject = Callable[[SimulatedBoard], None]
Way = Callable[[Board], Awaitable[None]]


@dataclass(frozen=True)
class Outcome:
    """How a fault ended.

    Attributes
    ----------
    code, reads
        The error's code and sentence; empty where the work was completed.
    dark_after_ms
        Time from the fault until no laser shone, rounded up to 10 ms; None where none shone when it came, or where the
        pass went on as it should.
    moved_on_mm
        How far the cart truly went from the fault to its end.
    again
        Whether, the fault gone and the remedy applied, a movement and the lasers work again.
    """

    code: str
    reads: str
    dark_after_ms: int | None
    moved_on_mm: float
    again: bool


@dataclass(frozen=True)
class Fault:
    """A fault, when it comes, and what is to be done after it.

    Attributes
    ----------
    name
        For the table.
    during
        What is going on.
    inject
        Brings it about.
    remedy
        What the user does once the cause is gone, for the table.
    repair
        Lets the cause go.
    cure
        The remedy as commands.
    """

    name: str
    during: str
    inject: Inject
    remedy: str = ""
    repair: Inject = lambda machine: setattr(machine, "faults", Faults())
    cure: Way | None = None


def change(**changes: object) -> Inject:
    """A change of the faults."""

    def inject(machine: SimulatedBoard) -> None:
        machine.faults = replace(machine.faults, **changes)  # type: ignore[arg-type]

    return inject


async def reset(board: Board) -> None:
    """Release the latch."""
    await board.reset()


async def reset_and_home(board: Board) -> None:
    """Release the latch and find the positions again."""
    await board.reset()
    await home(board)


async def home(board: Board) -> None:
    """Find the positions."""
    for axis in AXES:
        await board.home(axis)


def pull_briefly(machine: SimulatedBoard) -> None:
    """Pull the cable for a fifth of a second."""
    machine.faults = Faults(unplugged=True)
    asyncio.get_running_loop().call_later(0.2, change(unplugged=False), machine)


FAULTS = (
    Fault(
        "1 byte in 200 corrupted, both ways", LASER_PASS, change(corrupt_to_board=0.005, corrupt_to_host=0.005)
    ),
    Fault("1 byte in 200 lost, both ways", LASER_PASS, change(lose_to_board=0.005, lose_to_host=0.005)),
    Fault("cable pulled", LASER_PASS, change(unplugged=True), "plug it"),
    Fault("cable pulled and plugged again at once", LASER_PASS, pull_briefly),
    Fault("nothing reaches the board any more", LASER_PASS, change(lose_to_board=1.0), "mend the cable"),
    Fault("nothing comes from the board any more", LASER_PASS, change(lose_to_host=1.0), "mend the cable"),
    Fault("board restarts", LASER_PASS, lambda machine: machine.reset(), "home both axes", cure=home),
    Fault("board's program hangs", LASER_PASS, lambda machine: machine.hang(), "home both axes", cure=home),
    Fault(
        "emergency stop pressed", LASER_PASS, change(e_stop=True), "release it, reset, home both axes",
        cure=reset_and_home,
    ),
    Fault("laser 1 dead", LASER_PASS, change(dead_lasers=frozenset({1})), "replace it"),
    Fault("cart's motor stalls", LASER_PASS, change(stalled=frozenset({"cart"})), "home the cart", cure=home),
    Fault("slide's motor stalls", RASTER, change(stalled=frozenset({"slide"})), "home the slide", cure=home),
    Fault("low limit switch stays pressed", RASTER, change(low_switch=True), "mend the switch"),
    Fault(
        "both limit switches pressed", RASTER, change(low_switch=True, high_switch=True),
        "mend the wires, reset, home both axes", cure=reset_and_home,
    ),
    Fault("low limit switch never closes", HOMING, change(low_switch=False), "mend the switch, home", cure=home),
    Fault("low limit switch never opens", HOMING, change(low_switch=True), "mend the switch, home", cure=home),
    Fault("slide's motor stalls", HOMING, change(stalled=frozenset({"slide"})), "mend the motor, home", cure=home),
)  # fmt: skip


def outcome(fault: Fault) -> Outcome:
    """Let a fault happen, in virtual time.

    Raises
    ------
    TimeoutError
        Something hangs.
    """
    return run_virtual(_happen(fault))


async def _happen(fault: Fault) -> Outcome:
    loop = asyncio.get_running_loop()
    machine = SimulatedBoard(MachineSettings(slide=SLIDE))
    board = SerialBoard(InProcessCable(machine, seed=20261122).connect)
    async with asyncio.timeout(PATIENCE_S), board:
        await home(board)
        work = loop.create_task(_work(board, fault.during))
        await asyncio.sleep(0.02 if fault.during == HOMING else FAULT_AFTER_S)
        begin_s = loop.time()
        shone = bool(machine.lasers(begin_s))
        place_mm = machine.cart_mm(begin_s)
        fault.inject(machine)
        dark = loop.create_task(_dark_after(machine, begin_s))
        error = await _error_of(work)
        dark_after_ms = await dark
        await asyncio.sleep(3.0)
        moved_on_mm = machine.cart_mm(loop.time()) - place_mm
        fault.repair(machine)
        again = await _works_again(board, machine, fault.cure)
        await board.close()
        again = again and not machine.lasers(loop.time()) and not machine.moving
    machine.close()
    completed = error is None
    return Outcome(
        code="" if error is None else error.code,
        reads="" if error is None else error.detail,
        dark_after_ms=None if completed or not shone else dark_after_ms,
        moved_on_mm=round(moved_on_mm, 1),
        again=again,
    )


async def _work(board: Board, during: str) -> None:
    if during == LASER_PASS:
        await board.laser_pass(LaserPass(10.0, 150.0, 50.0))
    elif during == RASTER:
        await board.raster(TofRaster(0.0, 3.0, 1.0, 1.0, 20.0, 20.0))
    else:
        await board.home("slide")


async def _dark_after(machine: SimulatedBoard, begin_s: float) -> int:
    while machine.lasers(asyncio.get_running_loop().time()):  # noqa: ASYNC110  (a look from outside, each millisecond)
        await asyncio.sleep(0.001)
    passed_ms = (asyncio.get_running_loop().time() - begin_s) * 1000.0
    return -int(-passed_ms // 10) * 10


async def _error_of(work: "asyncio.Task[None]") -> TwinlineError | None:
    try:
        await work
    except TwinlineError as error:
        return error
    return None


async def _works_again(board: Board, machine: SimulatedBoard, cure: Way | None) -> bool:
    await asyncio.sleep(8.0)
    if cure is not None:
        await cure(board)
    place_mm = (await board.status()).cart_mm
    await board.lasers(frozenset({1, 2}))
    shining = machine.lasers(asyncio.get_running_loop().time()) == {1, 2}
    await board.lasers(frozenset())
    before_mm = machine.cart_mm(asyncio.get_running_loop().time())
    await board.move("cart", place_mm - 5.0, 20.0)
    moved_mm = machine.cart_mm(asyncio.get_running_loop().time()) - before_mm
    return shining and abs(moved_mm + 5.0) < 0.11
