"""What is asked of a pass: the area, the speed, the pitch."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import isfinite
from typing import Any, Self

from twinline.devices.board import Drive
from twinline.errors import InputError


def _require(fields: Mapping[str, float]) -> None:
    for name, value in fields.items():
        if not isfinite(value):
            raise InputError(f"{name} must be a number of millimetres or millimetres per second, not {value}.")


@dataclass(frozen=True)
class LaserPassRequest:
    """A laser pass: the cart crosses an area at constant speed while the camera looks.

    Attributes
    ----------
    from_mm, to_mm
        Ends of the area, as positions of the cart in commanded millimetres.
    speed_mm_s
        Speed of the cart; with the camera's rate it makes the distance between lines.
    alternating
        Let the lasers take turns, for rigs whose stripes cross or could be taken for each other.
    background
        Take one frame with the lasers off before the pass begins.
    """

    from_mm: float
    to_mm: float
    speed_mm_s: float = 12.5
    alternating: bool = False
    background: bool = True

    def __post_init__(self) -> None:
        _require({"from_mm": self.from_mm, "to_mm": self.to_mm, "speed_mm_s": self.speed_mm_s})
        if self.from_mm == self.to_mm:
            raise InputError(f"A laser pass from {self.from_mm:g} mm to the same place has no length; give two ends.")
        if self.speed_mm_s <= 0:
            raise InputError(f"The speed of a laser pass must be above 0 mm/s, not {self.speed_mm_s:g}.")

    @property
    def length_mm(self) -> float:
        """Length of the area along the travel."""
        return abs(self.to_mm - self.from_mm)

    @property
    def direction(self) -> float:
        """+1 or -1."""
        return 1.0 if self.to_mm > self.from_mm else -1.0

    def to_json(self) -> dict[str, Any]:
        """As it is kept with the recording."""
        return asdict(self)

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> Self:
        """From what `to_json` gave."""
        return cls(**value)


@dataclass(frozen=True)
class TofPassRequest:
    """A ToF pass: the slide sweeps to and fro while the cart advances row by row.

    Attributes
    ----------
    from_mm, to_mm
        First row, and the place that no row is beyond; positions of the cart.
    slide_from_mm, slide_to_mm
        Ends of the sweeps.
    advance_mm
        Distance between rows.
    speed_mm_s
        Speed of the sweeps.
    """

    from_mm: float
    to_mm: float
    slide_from_mm: float
    slide_to_mm: float
    advance_mm: float = 2.0
    speed_mm_s: float = 20.0

    def __post_init__(self) -> None:
        _require(asdict(self))
        if self.slide_from_mm == self.slide_to_mm:
            raise InputError(
                f"Sweeps of the slide from {self.slide_from_mm:g} mm to the same place have no length; give two ends."
            )
        if self.advance_mm <= 0 or self.speed_mm_s <= 0:
            raise InputError(
                f"A ToF pass needs an advance and a speed above 0, not {self.advance_mm:g} mm and "
                f"{self.speed_mm_s:g} mm/s."
            )

    def row_places_mm(self, cart: Drive) -> tuple[float, ...]:
        """Where the rows lie: the board advances by whole steps of the cart.

        Parameters
        ----------
        cart
            The cart's drive.
        """
        step_mm = cart.mm_per_step
        first, last = round(self.from_mm / step_mm), round(self.to_mm / step_mm)
        advance = max(1, round(self.advance_mm / step_mm))
        rows = range(abs(last - first) // advance + 1)
        return tuple((first + int(self.direction) * row * advance) * step_mm for row in rows)

    @property
    def width_mm(self) -> float:
        """Length of a sweep."""
        return abs(self.slide_to_mm - self.slide_from_mm)

    @property
    def direction(self) -> float:
        """+1 or -1."""
        return 1.0 if self.to_mm >= self.from_mm else -1.0

    def to_json(self) -> dict[str, Any]:
        """As it is kept with the recording."""
        return asdict(self)

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> Self:
        """From what `to_json` gave."""
        return cls(**value)


@dataclass(frozen=True)
class ScanRequest:
    """Which passes a scan has; None leaves one out."""

    laser: LaserPassRequest | None
    tof: TofPassRequest | None
