"""What the operations work with; the composition root fills it, tests put in their own."""

from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from twinline.fusion.cloud import PointCloud
from twinline.geometry.rig import Rig
from twinline.operations.exports.provenance import Provenance
from twinline.reconstruction.result import Checkpoint, OnPoints, Reconstruction, ReconstructionOptions, Report
from twinline.recording.capture import Capture
from twinline.stripe import Method


class Reconstruct(Protocol):
    """`twinline.reconstruction.offline.reconstruct`."""

    def __call__(
        self,
        capture: Capture,
        rig: Rig,
        options: ReconstructionOptions,
        *,
        executor: Executor,
        report: Report,
        checkpoint: Checkpoint,
        on_points: OnPoints,
    ) -> Reconstruction:
        """Points of a whole laser pass."""
        ...


class Render(Protocol):
    """Writes a simulated capture folder."""

    def __call__(
        self, folder: Path, scene: str, *, seed: int, executor: Executor, report: Report, checkpoint: Checkpoint
    ) -> object:
        """Render a scene into a folder, with as much in the executor's processes as can be."""
        ...


@dataclass(frozen=True)
class Toolbox:
    """Implementations, picked in one place.

    Attributes
    ----------
    open_capture, read_rig
        As in `twinline.recording`.
    unpack
        Unpacks a zip of a capture into an empty folder and returns the capture folder in it.
    writers
        File name in a scan's folder and what writes it.
    methods, default_method
        Names of the extraction methods.
    scenes
        Names of the simulator's scenes and their titles, the default first.
    """

    open_capture: Callable[[Path], Capture]
    read_rig: Callable[[Path], Rig]
    unpack: Callable[[Path, Path], Path]
    reconstruct: Reconstruct
    render: Render
    writers: Mapping[str, Callable[[Path, PointCloud, Provenance], None]]
    methods: tuple[Method, ...]
    default_method: Method
    scenes: Mapping[str, str]
