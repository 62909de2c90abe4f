"""What shows clouds: the 3-D view as jobs and the API see it."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from twinline.fusion.cloud import PointCloud


class ColourMode(StrEnum):
    """What the colour of a point tells."""

    HEIGHT = "height"
    SOURCE = "source"
    SIGMA = "sigma"
    INTENSITY = "intensity"
    COLOUR = "colour"


@dataclass(frozen=True)
class Legend:
    """Values at the two ends of the colour scale."""

    min: float
    max: float
    unit: str


@dataclass(frozen=True)
class DisplayState:
    """What is shown.

    Attributes
    ----------
    points, shown
        Points of the cloud, and how many of them are drawn.
    scan_id, job_id
        Where the cloud comes from; both None while nothing is shown.
    legend
        None in colour modes without a scale.
    note
        A remark for people, as that the cloud is thinned.
    """

    colour: ColourMode
    points: int = 0
    shown: int = 0
    scan_id: str | None = None
    job_id: str | None = None
    legend: Legend | None = None
    note: str | None = None


class CloudDisplay(Protocol):
    """Shows one cloud that may be growing; every method may be called from any thread."""

    def begin(self, *, job_id: str | None = None, scan_id: str | None = None) -> None:
        """Clear the stage for another cloud."""
        ...

    def append(self, cloud: PointCloud) -> None:
        """Add points; small batches may be held back for a moment."""
        ...

    def finish(self, *, scan_id: str | None = None) -> None:
        """Show all that was held back; the cloud is whole and is that of a scan."""
        ...

    def clear(self) -> None:
        """Show nothing."""
        ...

    def set_colour(self, mode: ColourMode) -> None:
        """Colour all points in another way."""
        ...

    def reset_cameras(self) -> None:
        """Let all viewers see the whole cloud again."""
        ...

    def state(self) -> DisplayState:
        """What is shown now."""
        ...
