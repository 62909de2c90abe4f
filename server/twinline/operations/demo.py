"""The job for a first visit: it renders a small capture on the simulated scanner and reconstructs it."""

from dataclasses import dataclass
from pathlib import Path

from twinline.operations.captures import CaptureRecord
from twinline.operations.reconstruct import Bench, ReconstructRequest
from twinline.operations.runner import JobContext
from twinline.operations.scans import Scan


@dataclass(frozen=True)
class DemoRequest:
    """Which scene to scan.

    Attributes
    ----------
    scene
        Name of a scene of the simulator.
    seed
        Of the rendered noise.
    """

    scene: str
    seed: int = 1


def render_capture(context: JobContext, bench: Bench, request: DemoRequest) -> CaptureRecord:
    """Render a scene as a capture that is kept like an uploaded one.

    Raises
    ------
    TwinlineError
        If it cannot be rendered or kept; nothing is kept then.
    """
    context.phase("Rendering")

    def fill(folder: Path) -> Path:
        bench.toolbox.render(
            folder,
            request.scene,
            seed=request.seed,
            executor=bench.workers,
            report=context.report,
            checkpoint=context.checkpoint,
        )
        return folder

    return bench.captures.add("demo", fill)


def reconstruct_rendered(context: JobContext, bench: Bench, record: CaptureRecord) -> Scan:
    """Reconstruct what `render_capture` made, with the rig that belongs to it."""
    return bench.reconstruct(context, ReconstructRequest(record.id))
