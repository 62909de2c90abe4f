"""What goes into a reconstruction besides the data, and what comes out."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from twinline.calibration.thesis_align import LaserShift, TofAlignment
from twinline.fusion.cloud import PointCloud
from twinline.fusion.fuse import Agreement
from twinline.fusion.holes import Holes
from twinline.geometry.noise import NoiseModel
from twinline.stripe.model import Channel, Method

Report = Callable[[int, int], None]
"""Called with (done, total) frames, from the thread that called `reconstruct`."""

Checkpoint = Callable[[], None]
"""Called between chunks; raises `CancelledError` to stop, blocks to pause."""

OnPoints = Callable[[PointCloud], None]
"""Called with the points of each finished chunk, in frame order."""


AlignmentMethod = Literal["none", "thesis"]
ALIGNMENTS: tuple[AlignmentMethod, ...] = ("none", "thesis")


@dataclass(frozen=True)
class ReconstructionOptions:
    """Choices of a reconstruction.

    Attributes
    ----------
    method
        Name of the stripe extraction method (`twinline.stripe.METHODS`).
    sources
        What to use: any of "laser1", "laser2"; for `reconstruct_fused` also "tof".
    every
        Use each n-th frame.
    channel
        Which light is measured (`twinline.stripe.CHANNELS`); "auto" chooses from a few frames of the pass.
    alignment
        Whether `reconstruct_fused` moves laser 1 and the ToF cloud before fusing, as the thesis does (4.3, 4.4); a
        calibrated rig needs none of it.
    fill
        Whether `reconstruct_fused` closes small gaps with points of source 5.
    """

    method: Method = "maximum-likelihood"
    sources: frozenset[str] = frozenset({"laser1", "laser2"})
    every: int = 1
    channel: Channel = "auto"
    alignment: AlignmentMethod = "none"
    fill: bool = False


NO_STRIPE = "no laser stripe"
"""Reason of a frame that could be read but shows none."""


@dataclass(frozen=True)
class FrameProblem:
    """A frame that gave nothing, and why."""

    frame: str
    reason: str


@dataclass(frozen=True, eq=False)
class Alignment:
    """What the thesis's alignments did, with their traces; None for what was not aligned."""

    laser_1: LaserShift | None = None
    tof: TofAlignment | None = None


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
    agreement
        How the two lasers agree; None where they were not fused.
    alignment
        The alignments that were asked for.
    holes
        Where there are no points, and why; None where no laser was used.
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
    agreement: Agreement | None = None
    alignment: Alignment = field(default_factory=Alignment)
    holes: Holes | None = None
