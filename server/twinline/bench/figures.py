"""What a bench has found: figures, what they are compared with, and whether that is good enough."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from twinline.arrays import FloatArray

Verdict = Literal["meets the aim", "meets the must", "MISSES THE MUST", ""]


@dataclass(frozen=True)
class Quartiles:
    """Median and quartiles over the rounds."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, values: FloatArray) -> "Quartiles":
        """Of a sample of any shape."""
        low, median, high = np.percentile(values, [25, 50, 75])
        return cls(float(median), float(low), float(high))

    def scaled(self, factor: float) -> "Quartiles":
        """In another unit."""
        return Quartiles(self.median * factor, self.low * factor, self.high * factor)


@dataclass(frozen=True)
class Ratio:
    """A figure over another one, round by round.

    Attributes
    ----------
    against
        Name of the other figure.
    must, aim
        Largest ratio that is accepted, and that is aimed at; None where nothing was promised.
    """

    against: str
    value: Quartiles
    must: float | None = None
    aim: float | None = None

    @property
    def verdict(self) -> Verdict:
        """By the median; empty where nothing was promised."""
        if self.must is None:
            return ""
        if self.aim is not None and self.value.median <= self.aim:
            return "meets the aim"
        return "meets the must" if self.value.median <= self.must else "MISSES THE MUST"


@dataclass(frozen=True)
class Figure:
    """One line of the report; ``unit`` is that of ``value``: us, ms, s, MB or mm."""

    name: str
    value: Quartiles
    unit: str
    ratios: tuple[Ratio, ...] = ()


@dataclass(frozen=True)
class Section:
    """Figures that were measured together, and how."""

    key: str
    title: str
    method: str
    rounds: int
    figures: tuple[Figure, ...]

    def figure(self, name: str) -> Figure:
        """The figure of that name.

        Raises
        ------
        KeyError
            There is none.
        """
        for figure in self.figures:
            if figure.name == name:
                return figure
        raise KeyError(name)


@dataclass(frozen=True)
class Machine:
    """What the figures were measured on.

    Attributes
    ----------
    caches
        Size of each level as one core sees it, such as "L2 2048K".
    """

    processor: str
    cores: int
    caches: tuple[str, ...]
    system: str
    versions: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Report:
    """A whole run; ``date`` is that of the run, in UTC, as YYYY-MM-DD."""

    date: str
    machine: Machine
    sections: tuple[Section, ...]

    @property
    def missed(self) -> tuple[str, ...]:
        """Names of the figures that miss a must."""
        return tuple(
            f"{section.title}: {figure.name}"
            for section in self.sections
            for figure in section.figures
            if any(ratio.verdict == "MISSES THE MUST" for ratio in figure.ratios)
        )
