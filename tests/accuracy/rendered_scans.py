"""The same capture reconstructed in other ways than the default, for comparison."""

from twinline.fusion.cloud import PointCloud
from twinline.geometry.rig import Rig
from twinline.reconstruction.chunk import chunk_frames, process_chunk
from twinline.reconstruction.plan import make_plan
from twinline.reconstruction.result import ReconstructionOptions
from twinline.recording.capture import Capture


def unfiltered(capture: Capture, rig: Rig) -> PointCloud:
    """The points before those that straddle an edge are dropped."""
    plan, frames = make_plan(capture, rig, ReconstructionOptions())
    shares = [process_chunk(plan, frames.select(share)) for share in frames.chunks(chunk_frames(plan, frames))]
    return PointCloud.concatenate([frame.cloud for share in shares for frame in share.frames])
