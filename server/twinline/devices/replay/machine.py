"""The machine that stands in for the recorded one between its passes."""

from twinline.devices.board import BoardInfo
from twinline.devices.replay.descriptions import board_info
from twinline.devices.replay.playback import Playback
from twinline.devices.serial.driver import SerialBoard
from twinline.devices.simulator.axis import Mechanics
from twinline.devices.simulator.cable import InProcessCable
from twinline.devices.simulator.simulated_board import MachineSettings, SimulatedBoard

_BEYOND_MM = 10.0


def machine_for(playback: Playback) -> tuple[SerialBoard, SimulatedBoard]:
    """A simulated machine with the drives of the recorded one, and the driver that it is reached by.

    To be made under a running event loop. Whoever made it closes the simulated board after the driver.
    """
    info = board_info(playback.recordings[0].header.settings, "")
    simulated = SimulatedBoard(_settings(info))
    return SerialBoard(InProcessCable(simulated).connect, drives=info.drives), simulated


def _settings(info: BoardInfo) -> MachineSettings:
    cart, slide = info.drives["cart"], info.drives["slide"]
    # Its switches stand at the ends of the travel, a little beyond what may be asked for.
    switches_mm = (slide.low_mm, slide.high_mm + _BEYOND_MM)
    return MachineSettings(
        cart=Mechanics(cart.mm_per_step),
        slide=Mechanics(
            slide.mm_per_step,
            switches_mm=switches_mm,
            stops_mm=(switches_mm[0] - _BEYOND_MM, switches_mm[1] + _BEYOND_MM),
            start_mm=slide.low_mm + 1.0,
        ),
    )
