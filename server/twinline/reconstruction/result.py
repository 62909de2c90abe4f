"""What goes into a reconstruction besides the data, and what comes out."""

from collections.abc import Callable
from dataclasses import dataclass, field

from twinline.fusion.cloud import PointCloud
from twinline.geometry.noise import NoiseModel
from twinline.stripe.model import Channel, Method

Report = Callable[[int, int], None]
"""Called with (done, total) frames, from the thread that called `reconstruct`."""

Checkpoint = Callable[[], None]
"""Called between chunks; raises `CancelledError` to stop, blocks to pause."""

OnPoints = Callable[[PointCloud], None]
"""Called with the points of each finished chunk, in frame order."""


@dataclass(frozen=True)
class ReconstructionOptions:
    """Choices of a reconstruction.

    Attributes
    ----------
    method
        Name of the stripe extraction method (`twinline.stripe.METHODS`).
    sources
        Which lasers to use: any of "laser1", "laser2".
    every
        Use each n-th frame.
    channel
        Which light is measured (`twinline.stripe.CHANNELS`); "auto" chooses from a few frames of the pass.
    """

    method: Method = "maximum-likelihood"
    sources: frozenset[str] = frozenset({"laser1", "laser2"})
    every: int = 1
    channel: Channel = "auto"


NO_STRIPE = "no laser stripe"
"""Reason of a frame that could be read but shows none."""


@dataclass(frozen=True)
class FrameProblem:
    """A frame that gave nothing, and why."""

    frame: str
    reason: str


@dataclass(frozen=True)
class Reconstruction:
    """A cloud and the account of how it came about.

    Attributes
    ----------
    frames, frames_used
        Frames in the pass and frames that gave points.
    problems
        Frames that could not be read or held no stripe (the first 100 are kept; `problem_count` counts all).
    counts
        Points per source and rejected columns per reason.
    channel, noise
        The light that was measured, and the noise model of its pixels (the rig's, or estimated from the frames).
    """

    cloud: PointCloud
    frames: int
    frames_used: int
    problem_count: int
    problems: tuple[FrameProblem, ...] = ()
    counts: dict[str, int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    elapsed_s: float = 0.0
    channel: Channel = "auto"
    noise: NoiseModel = field(default_factory=NoiseModel)
