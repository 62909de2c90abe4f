"""How long a pass will take and how dense it will be, before it starts.

Movements are trapezoids in time: a distance s at speed v with acceleration a takes ``s / v + v / a``, or
``2 sqrt(s / a)`` where the speed is not reached.
"""

from dataclasses import dataclass
from math import sqrt

from twinline.devices.board import Drive
from twinline.operations.passes.requests import LaserPassRequest, TofPassRequest
from twinline.recording.capture_json import CaptureInfo

JPEG_BYTES_PER_PIXEL = 0.12
"""A scene with two stripes and some texture at quality 90; PERFORMANCE.md does not depend on it."""

RUN_UP_MARGIN_STEPS = 8
"""The board's own margin around the ramps of a laser pass."""

DARK_S = 0.15
"""What lasers and exposure need until a frame is dark."""


@dataclass(frozen=True)
class Forecast:
    """What a pass will be like.

    Attributes
    ----------
    duration_s
        From its first movement to its last; the way to its beginning is counted from where the machine stands.
    samples
        Frames of a laser pass, readings of a ToF pass.
    along_mm, across_mm
        Distance of neighbouring points along the travel and across it, on the bed.
    bytes
        Size of the recording, roughly.
    """

    duration_s: float
    samples: int
    along_mm: float
    across_mm: float
    bytes: int


def movement_s(distance_mm: float, speed_mm_s: float, acceleration_mm_s2: float) -> float:
    """Seconds that a movement from rest to rest takes."""
    distance_mm = abs(distance_mm)
    if distance_mm >= speed_mm_s**2 / acceleration_mm_s2:
        return distance_mm / speed_mm_s + speed_mm_s / acceleration_mm_s2
    return 2.0 * sqrt(distance_mm / acceleration_mm_s2)


def laser_forecast(
    request: LaserPassRequest,
    drive: Drive,
    info: CaptureInfo,
    *,
    rate_hz: float,
    at_mm: float | None = None,
    depth_mm: float | None = None,
) -> Forecast:
    """Forecast of a laser pass.

    Parameters
    ----------
    drive
        The cart's.
    rate_hz
        Frames per second.
    at_mm
        Where the cart stands; its approach is left out where that is not known.
    depth_mm
        Distance from the camera to the bed; the description's where not given.
    """
    run_up = run_up_mm(request.speed_mm_s, drive)
    duration = (request.length_mm + 2.0 * run_up) / request.speed_mm_s
    duration += request.speed_mm_s / drive.acceleration_mm_s2
    start = request.from_mm - request.direction * run_up
    if request.background:
        duration += DARK_S + 1.5 / rate_hz + movement_s(run_up, drive.max_speed_mm_s, drive.acceleration_mm_s2)
        start = request.from_mm
    if at_mm is not None:
        duration += movement_s(start - at_mm, drive.max_speed_mm_s, drive.acceleration_mm_s2)
    frames = int(request.length_mm / request.speed_mm_s * rate_hz) + 1
    turns = 2 if request.alternating else 1
    depth = depth_mm or info.camera_height_mm or 430.0
    focal = float(info.camera_matrix_guess[0, 0])
    width, height = info.image_size
    size = int(frames * width * height * JPEG_BYTES_PER_PIXEL)
    return Forecast(duration, frames, turns * request.speed_mm_s / rate_hz, depth / focal, size)


def run_up_mm(speed_mm_s: float, drive: Drive) -> float:
    """What the board adds at either end of a laser pass."""
    return speed_mm_s**2 / (2.0 * drive.acceleration_mm_s2) + (RUN_UP_MARGIN_STEPS + 1) * drive.mm_per_step


def tof_forecast(
    request: TofPassRequest, cart: Drive, slide: Drive, *, samples_hz: float, at_mm: tuple[float, float] | None = None
) -> Forecast:
    """Forecast of a ToF pass.

    Parameters
    ----------
    samples_hz
        Readings per second.
    at_mm
        Where cart and slide stand; their approach is left out where that is not known.
    """
    places = request.row_places_mm(cart)
    sweep = movement_s(request.width_mm, request.speed_mm_s, slide.acceleration_mm_s2)
    advance_mm = abs(places[1] - places[0]) if len(places) > 1 else request.advance_mm
    advance = movement_s(advance_mm, cart.max_speed_mm_s, cart.acceleration_mm_s2)
    duration = len(places) * sweep + (len(places) - 1) * advance
    if at_mm is not None:
        duration += movement_s(places[0] - at_mm[0], cart.max_speed_mm_s, cart.acceleration_mm_s2)
        duration += movement_s(request.slide_from_mm - at_mm[1], slide.max_speed_mm_s, slide.acceleration_mm_s2)
    samples = int(duration * samples_hz)
    return Forecast(duration, samples, advance_mm, request.speed_mm_s / samples_hz, 60 * samples)
