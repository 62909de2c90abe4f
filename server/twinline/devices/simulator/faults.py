"""What can go wrong with the simulated board and its cable, on demand."""

from dataclasses import dataclass

from twinline.devices.board import Axis
from twinline.errors import SettingsError


@dataclass(frozen=True)
class Faults:
    """What is wrong now; set it as ``board.faults = replace(board.faults, e_stop=True)``.

    Attributes
    ----------
    corrupt_to_board, corrupt_to_host
        Share of the bytes that arrive as others.
    lose_to_board, lose_to_host
        Share of the bytes that do not arrive.
    unplugged
        The cable is pulled.
    stalled
        Axes whose motors lose every step.
    low_switch, high_switch
        What a limit switch tells regardless of the slide: True pressed, False released, None the truth.
    e_stop
        The emergency stop is pressed.
    dead_lasers
        Lasers that stay dark although they are switched on.
    """

    corrupt_to_board: float = 0.0
    corrupt_to_host: float = 0.0
    lose_to_board: float = 0.0
    lose_to_host: float = 0.0
    unplugged: bool = False
    stalled: frozenset[Axis] = frozenset()
    low_switch: bool | None = None
    high_switch: bool | None = None
    e_stop: bool = False
    dead_lasers: frozenset[int] = frozenset()

    def __post_init__(self) -> None:
        for name in ("corrupt_to_board", "corrupt_to_host", "lose_to_board", "lose_to_host"):
            share = getattr(self, name)
            if not 0.0 <= share <= 1.0:
                raise SettingsError(f"The simulated fault {name} is a share of bytes from 0 to 1, not {share}.")
