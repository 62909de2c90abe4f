"""How far apart the points of a pass lie."""

from collections.abc import Sequence

import numpy as np

from twinline.geometry.rig import Rig
from twinline.recording.frames import FrameSequence

LEAST_MM = 0.3
MOST_MM = 3.0


def pitch_mm(rig: Rig, frames: FrameSequence, lasers: Sequence[int]) -> float:
    """Usual distance on the bed between frames that show the same laser; 0 where the cart stands."""
    steps = np.abs(np.diff([frame.cart_mm for frame in frames.frames]))
    pitch = float(np.median(steps)) * float(np.linalg.norm(rig.travel)) if len(steps) else 0.0
    taking_turns = any(f.lasers is not None and len(f.lasers) == 1 for f in frames.frames)
    return 2.0 * pitch if taking_turns and len(lasers) == 2 else pitch


def point_spacing_mm(rig: Rig, pitch: float) -> tuple[float, float]:
    """Reach of a laser point's neighbours along the travel and across it, for frames so far apart."""
    depth = float(rig.bed_from_camera.translation_mm[2])
    focal = rig.camera.fx if rig.stripe_runs == "along-u" else rig.camera.fy
    # Beyond the next point across, so that there always is one on either side.
    across = 1.25 * depth / focal
    return float(np.clip(1.02 * pitch, LEAST_MM, MOST_MM)), float(np.clip(across, LEAST_MM, MOST_MM))
