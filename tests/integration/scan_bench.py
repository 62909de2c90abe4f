"""A small simulated machine whose scans take seconds, and looks at what it truly did."""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import TypeVar

from twinline.devices.simulator.machine import SimulatedRig
from twinline.devices.simulator.machine_state import MachineState
from twinline.devices.simulator.simulated_board import MachineSettings
from twinline.devices.simulator.workspace import Workspace, build_workspace
from twinline.devices.virtual_time import run_virtual
from twinline.machines import SimulatedMachine, simulated_machine
from twinline.operations.passes.requests import LaserPassRequest, TofPassRequest
from twinline.operations.passes.scan_folder import ScanFolder
from twinline.operations.passes.session import ScanSession

Result = TypeVar("Result")

IMAGE_SIZE = (640, 360)
RATE_HZ = 25.0
LASER = LaserPassRequest(20.0, 70.0, 50.0)
TOF = TofPassRequest(0.0, 4.0, 40.0, 70.0, advance_mm=1.0, speed_mm_s=40.0)
PATIENCE_S = 600.0
"""Virtual seconds that nothing here may last: what does hangs."""


@cache
def workspace(scene: str = "steps") -> Workspace:
    """Things on the bed of a machine that reads out the middle of its sensor only."""
    return build_workspace(scene, SimulatedRig().cropped(IMAGE_SIZE), seed=3)


class Witness:
    """A `MachineState` that remembers where the cart was and which lasers shone whenever the camera looked."""

    def __init__(self, state: MachineState) -> None:
        self._state = state
        self.cart: dict[float, float] = {}
        self.lit: dict[float, frozenset[int]] = {}

    def cart_mm(self, host_time_s: float) -> float:
        """As the machine says, and kept."""
        self.cart[host_time_s] = self._state.cart_mm(host_time_s)
        return self.cart[host_time_s]

    def slide_mm(self, host_time_s: float) -> float:
        """As the machine says."""
        return self._state.slide_mm(host_time_s)

    def lasers(self, host_time_s: float) -> frozenset[int]:
        """As the machine says, and kept."""
        self.lit[host_time_s] = self._state.lasers(host_time_s)
        return self.lit[host_time_s]


@dataclass(eq=False)
class ScanBench:
    """A simulated machine with a session on it.

    Attributes
    ----------
    truth
        What was truly so at the middle of each exposure.
    phases
        What was reported, without repetitions.
    rows
        Rows of the ToF pass that were reported.
    """

    simulated: SimulatedMachine
    session: ScanSession
    truth: Witness
    phases: list[str] = field(default_factory=list)
    rows: int = 0

    def reported(self, phase: str, done: int, _total: int) -> None:
        """Take a report."""
        if phase == "ToF pass":
            self.rows = done
        if not self.phases or self.phases[-1] != phase:
            self.phases.append(phase)

    @property
    def dark(self) -> bool:
        """Whether truly no laser shines now."""
        return not self.simulated.board.lasers(asyncio.get_running_loop().time())

    async def until(self, condition: Callable[[], bool]) -> None:
        """Look every few milliseconds until something is so."""
        while not condition():  # noqa: ASYNC110  (a look from outside)
            await asyncio.sleep(0.004)

    async def until_cart(self, place_mm: float) -> None:
        """Wait until the lasers shine and the cart has truly come to a place."""
        board, now = self.simulated.board, asyncio.get_running_loop().time
        await self.until(lambda: bool(board.lasers(now())) and board.cart_mm(now()) >= place_mm)


def on_machine(
    folder: Path,
    play: Callable[[ScanBench], Awaitable[Result]],
    *,
    drift_ppm: float = 80.0,
    rate_hz: float = RATE_HZ,
    scene: str = "steps",
    resume: bool = False,
) -> Result:
    """Let something happen on a machine that was just switched on, in virtual time.

    Raises
    ------
    TimeoutError
        It hangs.
    """

    async def run() -> Result:
        simulated = simulated_machine(
            workspace(scene), settings=MachineSettings(clock_drift_ppm=drift_ppm), rate_hz=rate_hz, seed=5
        )
        witness = Witness(simulated.board)
        simulated.camera._machine = witness
        scan_folder = ScanFolder.reopen(folder) if resume else ScanFolder.create(folder)
        bench = ScanBench(simulated, ScanSession(simulated.machine, scan_folder), witness)
        bench.session = replace(bench.session, report=bench.reported)
        try:
            async with asyncio.timeout(PATIENCE_S):
                return await play(bench)
        finally:
            simulated.close()

    return run_virtual(run())
