"""One worker's share of a pass: frames in, points out. A pure function of its arguments and the files they name."""

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from twinline.arrays import BoolArray, ByteArray, FloatArray, IntArray
from twinline.errors import InputError
from twinline.fusion.cloud import PointCloud, Source
from twinline.fusion.edges import FramePoints
from twinline.geometry.triangulation import pack_laser, stripe_points_packed
from twinline.reconstruction.colour import CLEARANCE_PX, UNKNOWN_GREY, sample_colours, shift_per_mm
from twinline.reconstruction.plan import Plan
from twinline.reconstruction.reference import smooth_line
from twinline.reconstruction.result import NO_STRIPE, FrameProblem
from twinline.recording.frames import Frame, FrameSequence
from twinline.recording.images import read_image
from twinline.stripe.model import Flag, StripeProfile

CHUNK_FRAMES = 16
MOST_CHUNK_FRAMES = 64
_KEPT_FRAMES = 12
_CANDIDATES = 6

UNWANTED = (Flag.POOR_FIT, Flag.BROKEN)
"""Flags of stripes that give no point: their spot straddles an edge, or their shape is not a stripe's."""


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
    points: FloatArray
    sigma: FloatArray
    amplitude: FloatArray
    laser: IntArray
    column: IntArray
    pixels: FloatArray
    depth: FloatArray
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
        if not len(lit.points):
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
        parts = []
        for k in np.flatnonzero(lit):
            centre, sd = profile.centre_px[k], profile.sd_px[k]
            if bed is not None and plan.bed_px is not None:
                # Heights count from the empty bed as it was seen here, not from where the rig expects it.
                centre = centre - bed[0][k] - plan.drift.at(int(k), cart) + plan.bed_px[k]
                sd = np.hypot(sd, bed[1][k])
            wanted = self._wanted(profile.flags[k], profile.found[k], plan.lasers[k])
            columns = np.flatnonzero(wanted & np.isfinite(centre))
            across = centre[columns]
            pixels = np.column_stack([across, columns] if plan.along_v else [columns, across]).astype(np.float64)
            points, sigma = stripe_points_packed(self._packed[k], pixels, sd[columns], cart)
            good = np.isfinite(sigma)
            self._count(f"laser{plan.lasers[k] + 1} off the sheet", int((~good).sum()))
            parts.append((np.full(int(good.sum()), k), columns[good], pixels[good], points[good], sigma[good]))
        laser, column, pixels, points, sigma = (
            (np.concatenate(a) for a in zip(*parts, strict=True))
            if parts
            else (np.empty(0, int), np.empty(0, int), np.empty((0, 2)), np.empty((0, 3)), np.empty(0))
        )
        camera = plan.rig.bed_from_camera
        depth = (points - camera.translation_mm - plan.rig.travel * cart) @ camera.rotation[:, 2]
        amplitude = profile.amplitude_dn[laser, column]
        return _Lit(cart, points, sigma, amplitude, laser, column, pixels, depth, profile, lit)

    def _wanted(self, flags: IntArray, found: BoolArray, laser: int) -> BoolArray:
        wanted = np.ones(len(flags), bool)
        for flag in UNWANTED:
            hit = found & ((flags & int(flag)) != 0)
            if hit.any():
                self._count(f"laser{laser + 1} {(flag.name or '').lower().replace('_', ' ')}", int(hit.sum()))
                wanted &= ~hit
        return wanted

    def _count(self, name: str, number: int) -> None:
        if number:
            self._counts[name] = self._counts.get(name, 0) + number

    def _coloured(self, lit: _Lit) -> FramePoints:
        colours = np.full((len(lit.points), 3), UNKNOWN_GREY, np.uint8)
        if self._kept and len(lit.points):
            self._colour(lit, colours)
        sources = np.array([Source.LASER_1 + laser for laser in self._plan.lasers], np.uint8)
        cloud = PointCloud(
            lit.points.astype(np.float32),
            lit.sigma.astype(np.float32),
            lit.amplitude.astype(np.float32),
            colours,
            sources[lit.laser],
        )
        profile = lit.profile
        return FramePoints(
            cloud,
            lit.laser,
            lit.column,
            profile.centre_px.astype(np.float32),
            # A saturated stripe's height is a guess from its flanks; what was seen is the top of the scale.
            np.minimum(profile.amplitude_dn, self._plan.settings.saturation_dn).astype(np.float32),
            lit.lit,
        )

    def _colour(self, lit: _Lit, colours: ByteArray) -> None:
        shift = shift_per_mm(self._plan.rig) / lit.depth[:, None]
        offsets = np.array([cart - lit.cart_mm for cart, _, _ in self._kept])
        per_mm = float(np.abs(shift).max(axis=1).mean())
        far_enough = np.flatnonzero(np.abs(offsets) * per_mm >= CLEARANCE_PX)
        order = far_enough[np.argsort(np.abs(offsets[far_enough]), kind="stable")][:_CANDIDATES]
        missing = np.ones(len(lit.points), bool)
        for k in order:
            _, image, stripes = self._kept[k]
            part = np.flatnonzero(missing)
            if not len(part):
                return
            done = sample_colours(lit.pixels[part], shift[part], image, float(offsets[k]), stripes,
                                  not self._plan.along_v, part, colours)  # fmt: skip
            missing[part[done]] = False
        self._count("without colour", int(missing.sum()))


@lru_cache(maxsize=2)
def _off_image(path: Path) -> ByteArray:
    return read_image(path)
