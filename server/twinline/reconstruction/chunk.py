"""One worker's share of a pass: frames in, points out. A pure function of its arguments and the files they name."""

from dataclasses import dataclass, field
from functools import lru_cache

import cv2
import numpy as np

from twinline.arrays import BoolArray, ByteArray, FloatArray
from twinline.errors import InputError
from twinline.fusion.cloud import PointCloud, Source
from twinline.fusion.edges import FramePoints
from twinline.geometry.triangulation import pack_laser
from twinline.reconstruction.colour import CLEARANCE_PX, UNKNOWN_GREY, sample_colours, shift_per_mm
from twinline.reconstruction.plan import Plan
from twinline.reconstruction.points import StripePoints, enter_points
from twinline.reconstruction.reference import smooth_line
from twinline.reconstruction.result import NO_STRIPE, FrameProblem
from twinline.recording.frames import Frame, FrameSequence
from twinline.recording.images import PictureFile, read_image
from twinline.stripe.model import StripeProfile

CHUNK_FRAMES = 16
MOST_CHUNK_FRAMES = 64
_KEPT_FRAMES = 12
_CANDIDATES = 6


@dataclass(frozen=True, eq=False)
class ChunkResult:
    """Points of a share of the frames, not yet filtered for edges, and the account of the rest."""

    frames: tuple[FramePoints, ...]
    problem_count: int
    problems: tuple[FrameProblem, ...]
    counts: dict[str, int] = field(default_factory=dict)


@dataclass(eq=False)
class _Lit:
    """The points of one frame, before colour."""

    cart_mm: float
    points: StripePoints
    profile: StripeProfile
    lit: BoolArray


def chunk_frames(plan: Plan, frames: FrameSequence) -> int:
    """Frames per share: enough that each point's surroundings are seen unlit by another frame of the same share."""
    carts = np.array([f.cart_mm for f in frames.frames])
    step = float(np.median(np.abs(np.diff(carts)))) if len(carts) > 1 else 0.0
    if step <= 0:
        return CHUNK_FRAMES
    per_frame = float(np.abs(shift_per_mm(plan.rig)).max()) * step / float(plan.rig.bed_from_camera.translation_mm[2])
    needed = int(np.ceil(1.3 * CLEARANCE_PX / max(per_frame, 1e-6)))
    return int(np.clip(2 * needed, CHUNK_FRAMES, MOST_CHUNK_FRAMES))


def process_chunk(plan: Plan, frames: FrameSequence, reference: FrameSequence | None = None) -> ChunkResult:
    """Points of a share of the frames.

    Parameters
    ----------
    reference
        The frames of the empty bed at the same positions, one for each of ``frames``.
    """
    cv2.setNumThreads(1)
    work = _Chunk(plan, len(frames))
    references = reference.read() if reference is not None else iter(())
    for place, frame in enumerate(frames.read()):
        work.add(place, frame, next(references, None))
    return work.finish()


class _Chunk:
    """Points and kept frames of a share while it is being worked on."""

    def __init__(self, plan: Plan, frames: int) -> None:
        self._plan = plan
        self._off = _off_image(plan.off) if plan.off is not None else None
        self._shift = shift_per_mm(plan.rig)
        self._packed = [pack_laser(plan.rig, laser) for laser in plan.lasers]
        self._lit: list[_Lit] = []
        self._kept: list[tuple[float, ByteArray, FloatArray]] = []
        self._keep_every = max(1, frames // _KEPT_FRAMES)
        self._problems: list[FrameProblem] = []
        self._counts: dict[str, int] = {}

    def add(self, place: int, frame: Frame, reference: Frame | None) -> None:
        """Extract and triangulate one frame."""
        if frame.image is None:
            self._problems.append(FrameProblem(frame.entry.name, frame.problem or "cannot be read"))
            return
        try:
            profile = self._plan.profile(frame.image, self._off)
            bed = self._reference(reference)
        except InputError as error:
            self._problems.append(FrameProblem(frame.entry.name, error.detail))
            return
        if frame.image.ndim == 3 and place % self._keep_every == 0:
            self._kept.append((frame.entry.cart_mm, frame.image, profile.centre_px))
        lit = self._triangulate(frame, profile, bed)
        if not len(lit.points.laser):
            self._problems.append(FrameProblem(frame.entry.name, NO_STRIPE))
        self._lit.append(lit)

    def finish(self) -> ChunkResult:
        """Colour the points."""
        return ChunkResult(
            frames=tuple(self._coloured(lit) for lit in self._lit),
            problem_count=len(self._problems),
            problems=tuple(self._problems),
            counts=self._counts,
        )

    def _reference(self, frame: Frame | None) -> tuple[FloatArray, FloatArray] | None:
        """Stripe on the empty bed, (lasers, columns), and its standard deviation; None without a reference pass."""
        if frame is None:
            return None
        if frame.image is None:
            raise InputError(f"reference frame {frame.entry.name}: {frame.problem}")
        profile = self._plan.profile(frame.image, self._off)
        # Where a gap of the reference is bridged, its reading is as good as it usually is.
        usual = np.nanmedian(profile.sd_px, axis=1, keepdims=True) if profile.found.any() else np.nan
        return smooth_line(profile.centre_px), np.where(profile.found, profile.sd_px, usual)

    def _triangulate(self, frame: Frame, profile: StripeProfile, bed: tuple[FloatArray, FloatArray] | None) -> _Lit:
        plan, cart = self._plan, frame.entry.cart_mm
        on = frame.entry.lasers
        lit = np.array([on is None or laser + 1 in on for laser in plan.lasers])
        place, sd = profile.centre_px, profile.sd_px
        if bed is not None and plan.bed_px is not None:
            # Heights count from the empty bed as it was seen here, not from where the rig expects it.
            drift = np.array([plan.drift.at(k, cart) for k in range(len(plan.lasers))])
            place = place - bed[0] - drift[:, None] + plan.bed_px
            sd = np.hypot(sd, bed[1])
        room, end = StripePoints.room_for(place.size), 0
        for k, laser in enumerate(plan.lasers):
            if not lit[k]:
                continue
            end, poor, broken, off = enter_points(
                self._packed[k], k, int(Source.LASER_1) + laser, profile.centre_px[k], sd[k], place[k],
                profile.amplitude_dn[k], profile.flags[k], cart, room, end,
            )  # fmt: skip
            for reason, number in (("poor fit", poor), ("broken", broken), ("off the sheet", off)):
                self._count(f"laser{laser + 1} {reason}", number)
        return _Lit(cart, room.first(end), profile, lit)

    def _count(self, name: str, number: int) -> None:
        if number:
            self._counts[name] = self._counts.get(name, 0) + number

    def _coloured(self, lit: _Lit) -> FramePoints:
        points, profile = lit.points, lit.profile
        colours = np.full((len(points.laser), 3), UNKNOWN_GREY, np.uint8)
        if self._kept and len(colours):
            self._colour(lit, colours)
        return FramePoints(
            PointCloud(points.points_mm, points.sigma_mm, points.intensity, colours, points.source),
            points.laser,
            points.column,
            profile.centre_px.astype(np.float32),
            # A saturated stripe's height is a guess from its flanks; what was seen is the top of the scale.
            np.minimum(profile.amplitude_dn, self._plan.settings.saturation_dn).astype(np.float32),
            lit.lit,
        )

    def _colour(self, lit: _Lit, colours: ByteArray) -> None:
        pixels, depth = lit.points.pixels, lit.points.depth_mm
        offsets = np.array([cart - lit.cart_mm for cart, _, _ in self._kept])
        per_mm = float(np.abs(self._shift).max() * np.mean(1.0 / depth))
        far_enough = np.flatnonzero(np.abs(offsets) * per_mm >= CLEARANCE_PX)
        order = far_enough[np.argsort(np.abs(offsets[far_enough]), kind="stable")][:_CANDIDATES]
        missing, left = np.ones(len(depth), bool), len(depth)
        for k in order:
            if left == 0:
                return
            _, image, stripes = self._kept[k]
            move = self._shift * offsets[k]
            left = sample_colours(pixels, depth, move, image, stripes, not self._plan.along_v, missing, colours)
        self._count("without colour", left)


@lru_cache(maxsize=2)
def _off_image(path: PictureFile) -> ByteArray:
    return read_image(path)
