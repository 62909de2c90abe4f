"""Stripes on surfaces of known place: a board in several poses, and blocks of known height."""

import cv2
import numpy as np

from twinline.arrays import BoolArray, ByteArray, FloatArray
from twinline.calibration.board import Board
from twinline.calibration.bundle import Solution, solve, stack_sightings
from twinline.calibration.camera_start import board_pose
from twinline.calibration.joint_types import KnownPoints
from twinline.calibration.observations import StripePoints
from twinline.calibration.views import BoardView, inspect_view
from twinline.errors import CalibrationError
from twinline.geometry.camera import Camera
from twinline.recording.capture import Capture
from twinline.recording.images import PictureFile, read_image
from twinline.stripe.choice import choose_light
from twinline.stripe.extraction import extract
from twinline.stripe.layout import find_layout
from twinline.stripe.model import ExtractionSettings, Flag, StripeProfile

_GROUPS_PER_VIEW = 3
_UNWANTED = int(Flag.POOR_FIT | Flag.BROKEN | Flag.NEAR_EDGE)
_NEAR_LINE_PX = 1.5
_RAISED_PX = 2.0
_EDGE_REACH_PX = 5
_EVEN_SHARE = 0.25
_FEWEST_LANES = 20


def read_sheet_views(capture: Capture, board: Board, camera: Camera) -> list[KnownPoints]:
    """Stripes on the board of ``sheets/``, one set per laser.

    Raises
    ------
    CalibrationError
        ``too-few-views`` if no view shows both the board and a stripe on it.
    """
    lasers = len(capture.info.lasers)
    parts: list[list[tuple[StripePoints, FloatArray, int]]] = [[] for _ in range(lasers)]
    for number, pair in enumerate(capture.sheets()):
        off, on = read_image(pair.off), read_image(pair.on)
        view = inspect_view(pair.name, off, board)
        if not view.usable:
            continue
        plane = _board_plane(view, camera)
        profile, order = _stripes(on, off, capture)
        inside = _board_mask(view, off.shape[:2]) & _even(off, along_u=capture.info.stripe_runs == "along-u")
        for k in range(min(lasers, len(order))):
            stripes = _rows(profile, order[k], inside, capture.info.stripe_runs == "along-u")
            if len(stripes) >= _FEWEST_LANES:
                parts[k].append((stripes, plane, number))
    if not any(parts):
        raise CalibrationError(
            f"None of the {len(capture.sheets())} views of {capture.path / 'sheets'} shows the whole board with a "
            "stripe on it: let the stripes cross the board, and take each pose twice, with the stripes on and off.",
            code="too-few-views",
        )
    return [_known(k, views) for k, views in enumerate(parts) if views]


def _known(laser: int, views: list[tuple[StripePoints, FloatArray, int]]) -> KnownPoints:
    stripes = StripePoints.join([s for s, _, _ in views])
    normal = np.concatenate([np.broadcast_to(plane[:3], (len(s), 3)) for s, plane, _ in views])
    offset = np.concatenate([np.full(len(s), plane[3]) for s, plane, _ in views])
    group = np.concatenate(
        [number * _GROUPS_PER_VIEW + (np.arange(len(s)) * _GROUPS_PER_VIEW) // len(s) for s, _, number in views]
    )
    return KnownPoints(laser, stripes, normal, offset, group)


def _board_plane(view: BoardView, camera: Camera) -> FloatArray:
    """Normal and offset of the board's face in the camera frame, (4,), by least squares over its corners."""
    rotation, translation = board_pose(view.board_mm, camera.rays(view.pixels)[:, :2], np.eye(3))
    theta = np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion])
    start = Solution(theta, rotation[None], translation[None])
    pose = solve(stack_sightings([view.board_mm], [view.pixels]), start, np.empty(0, np.int64))
    normal = pose.rotations[0][:, 2]
    return np.append(normal, float(normal @ pose.translations_mm[0]))


def _board_mask(view: BoardView, shape: tuple[int, int]) -> BoolArray:
    mask = np.zeros(shape, np.uint8)
    hull = cv2.convexHull(view.pixels.astype(np.float32))
    cv2.fillConvexPoly(mask, np.round(hull).astype(np.int32), 1)
    return np.asarray(mask > 0)


def _even(image: ByteArray, *, along_u: bool) -> BoolArray:
    """Pixels of one shade across the stripe: a spot that straddles black and white has its centre on neither."""
    shade = image if image.ndim == 2 else np.asarray(image.max(axis=2))
    reach = 2 * _EDGE_REACH_PX + 1
    window = np.ones((reach, 3) if along_u else (3, reach), np.uint8)
    light, dark = np.asarray(cv2.dilate(shade, window)), np.asarray(cv2.erode(shade, window))
    contrast = float(np.percentile(shade, 98)) - float(np.percentile(shade, 2))
    return np.asarray(light.astype(np.float64) - dark < _EVEN_SHARE * contrast)


def _stripes(on: ByteArray, off: ByteArray | None, capture: Capture) -> tuple[StripeProfile, list[int]]:
    """Stripes of one picture, and which row of the profile belongs to which laser of the capture."""
    lasers = capture.info.lasers
    runs = capture.info.stripe_runs
    settings = ExtractionSettings()
    layout = find_layout(on, settings, off=off, runs=runs, lasers=len(lasers))
    light = choose_light([on], layout.bands, along_v=runs == "along-v", off=off, same_view=True)
    profile = extract(on, ExtractionSettings(channel=light.channel), runs=runs, bands=layout.bands, off=off)
    if len(lasers) == 1:
        return profile, [0]
    return profile, [0 if laser.side[0] == "+" else 1 for laser in lasers]


def _rows(profile: StripeProfile, row: int, wanted: BoolArray, along_u: bool) -> StripePoints:
    centre, sd = profile.centre_px[row], profile.sd_px[row]
    lanes = np.flatnonzero(np.isfinite(centre) & ((profile.flags[row] & _UNWANTED) == 0))
    across = np.rint(centre[lanes]).astype(np.int64)
    inside = wanted[across, lanes] if along_u else wanted[lanes, across]
    lanes = lanes[inside]
    pixels = np.column_stack([lanes, centre[lanes]] if along_u else [centre[lanes], lanes]).astype(np.float64)
    return StripePoints(pixels, sd[lanes].astype(np.float64), np.zeros(len(lanes)))


def read_blocks(capture: Capture) -> list[KnownPoints]:
    """Stripes on the tops of the blocks of ``heights/`` and on the bare bed beside them, one set per laser.

    Raises
    ------
    CalibrationError
        ``no-block`` if a picture shows no raised stripe although its block has a height.
    """
    views = capture.heights()
    lasers = capture.info.lasers
    parts: list[list[tuple[StripePoints, FloatArray, int]]] = [[] for _ in lasers]
    along_u = capture.info.stripe_runs == "along-u"
    for number, view in enumerate(views):
        image = read_image(view.path)
        off = read_image(view.off) if view.off is not None else None
        profile, order = _stripes(image, off, capture)
        everywhere = np.ones(image.shape[:2], bool)
        found = False
        for k, laser in enumerate(lasers):
            stripes = _rows(profile, order[k], everywhere, along_u)
            bed, top = _bed_and_top(
                stripes, along_u, up=1.0 if laser.side[0] == "+" else -1.0, raised=view.height_mm > 0
            )
            if len(bed) >= _FEWEST_LANES:
                parts[k].append((bed, np.array([np.nan, np.nan, np.nan, 0.0]), 2 * number))
            if len(top) >= _FEWEST_LANES:
                found = True
                parts[k].append((top, np.array([np.nan, np.nan, np.nan, view.height_mm]), 2 * number + 1))
        if view.height_mm > 0 and not found:
            raise CalibrationError(
                f"{_name(view.path)} shows no stripe raised by a block of {view.height_mm:g} mm: put the block into "
                "the stripe, with bare bed on both sides of it.",
                code="no-block",
            )
    return [_known(k, found_views) for k, found_views in enumerate(parts) if found_views]


def _name(path: PictureFile) -> str:
    return f"{path.parent.name}/{path.name}"


def _bed_and_top(stripes: StripePoints, along_u: bool, *, up: float, raised: bool) -> tuple[StripePoints, StripePoints]:
    """The stripe's points on the bed, and those on the one flat top that rises from it."""
    if len(stripes) < _FEWEST_LANES:
        return stripes, stripes.take(np.empty(0, np.int64))
    lane = stripes.pixels[:, 0 if along_u else 1]
    height = up * stripes.pixels[:, 1 if along_u else 0]
    bed = _line_inliers(lane, height, lowest=True)
    if not raised:
        return stripes.take(bed), stripes.take(np.empty(0, np.int64))
    fit = np.polyfit(lane[bed], height[bed], 2)
    above = np.flatnonzero(height - np.polyval(fit, lane) > _RAISED_PX)
    if len(above) < _FEWEST_LANES:
        return stripes.take(bed), stripes.take(above[:0])
    top = above[_line_inliers(lane[above], height[above], lowest=False)]
    return stripes.take(bed), stripes.take(top)


def _line_inliers(lane: FloatArray, height: FloatArray, *, lowest: bool) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Points of the line that most lanes agree on; of two the lower one if ``lowest``."""
    start = np.percentile(height, 20) if lowest else np.median(height)
    near = np.abs(height - start) < 10 * _NEAR_LINE_PX
    for reach in (6.0, 3.0, 1.0, 1.0):
        if near.sum() < 3:
            break
        fit = np.polyfit(lane[near], height[near], 1 if reach > 1 else 2)
        near = np.abs(height - np.polyval(fit, lane)) < reach * _NEAR_LINE_PX
    return np.flatnonzero(near)
