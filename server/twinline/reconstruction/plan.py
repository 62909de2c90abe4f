"""What every frame of a pass is processed with: settled once, before the first frame, and sent to the workers."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from twinline.arrays import ByteArray, FloatArray, IntArray
from twinline.errors import CaptureError, FrameError, RigError, StripeError
from twinline.geometry.noise import NoiseModel
from twinline.geometry.optics import check_stripes_separable, stripe_positions, stripe_rows
from twinline.geometry.rig import Rig
from twinline.reconstruction.reference import BedDrift, drift_of, smooth_line
from twinline.reconstruction.result import NO_STRIPE, FrameProblem, ReconstructionOptions
from twinline.recording.capture import Capture
from twinline.recording.frames import FrameSequence
from twinline.recording.images import PictureFile, read_image
from twinline.stripe.choice import choose_light
from twinline.stripe.extraction import extract_light, usual_widths
from twinline.stripe.light import Light, take_light
from twinline.stripe.model import ExtractionSettings, StripeProfile
from twinline.stripe.noise import noise_from_residuals, read_noise, rounded
from twinline.stripe.width import UsualWidth

SAMPLED_FRAMES = 5
DRIFT_FRAMES = 16
LASER_NAMES = ("laser1", "laser2")


@dataclass(frozen=True, eq=False)
class Plan:
    """How to process the frames of a pass.

    Attributes
    ----------
    lasers
        Indices into ``rig.sheets`` of the lasers to use, in the order of ``bands``.
    bands : (lasers, columns, 2) int array
        Where to look for each stripe: rows [low, high) per column ("along-u"; columns and rows swap for "along-v").
    bed_px : (lasers, columns) array or None
        Where the rig sees each stripe on the bare bed; only where a reference pass is subtracted.
    widths
        How wide the stripes are in this pass; None leaves that to each frame.
    drift
        Shift of the bed against the reference pass.
    off
        Picture with the lasers off, or None.
    """

    rig: Rig
    lasers: tuple[int, ...]
    bands: IntArray
    settings: ExtractionSettings
    noise: NoiseModel
    off: PictureFile | None
    bed_px: FloatArray | None
    widths: tuple[UsualWidth, ...] | None = None
    drift: BedDrift = field(default_factory=lambda: BedDrift(np.empty(0), np.empty((0, 0))))

    @property
    def along_v(self) -> bool:
        """Whether stripes cross image rows."""
        return self.rig.stripe_runs == "along-v"

    def light(self, image: ByteArray, off: ByteArray | None) -> Light:
        """The measured light of a frame."""
        return take_light(image, self.settings.channel, along_v=self.along_v, off=off)

    def profile(self, image: ByteArray, off: ByteArray | None) -> StripeProfile:
        """The stripes of a frame, one row per laser of ``lasers``."""
        return extract_light(self.light(image, off), self.bands, self.settings, self.noise, self.widths)


def make_plan(capture: Capture, rig: Rig, options: ReconstructionOptions) -> tuple[Plan, FrameSequence]:
    """Check that a pass can be reconstructed with a rig, and settle how.

    Returns
    -------
    Plan
        What the workers need.
    FrameSequence
        The frames to process.

    Raises
    ------
    CaptureError
        There is no laser pass, or its frames differ in size.
    RigError
        The rig belongs to another camera, lacks the laser, or its stripes cross within the depth range.
    StripeError
        None of the sampled frames shows a stripe.
    """
    if capture.laser is None:
        raise CaptureError(f"{capture.path} holds no laser pass: put its frames and frames.csv into laser/.")
    frames = capture.laser.select(range(0, len(capture.laser), options.every)) if options.every > 1 else capture.laser
    frames.check_sizes()
    if rig.camera.size != capture.info.image_size:
        w, h = rig.camera.size
        width, height = capture.info.image_size
        raise RigError(
            f"Rig {rig.name!r} is for pictures of {w} x {h} px but {capture.path} holds {width} x {height}: use the "
            "rig calibrated for this camera setting."
        )
    if rig.stripe_runs != capture.info.stripe_runs:
        raise RigError(
            f"Rig {rig.name!r} has stripes {rig.stripe_runs} but {capture.path / 'capture.json'} says "
            f"{capture.info.stripe_runs}: one of them is wrong."
        )
    lasers = _lasers(rig, options)
    alternating = all(f.lasers is not None and len(f.lasers) < 2 for f in frames.frames)
    if len(lasers) == 2 and not alternating:
        check_stripes_separable(rig).require()
    bed_px = None
    if capture.reference is not None:
        if len(capture.reference) != len(capture.laser):
            raise CaptureError(
                f"reference/ has {len(capture.reference)} frames but laser/ has {len(capture.laser)}: the reference "
                "pass must be taken at the same positions, frame by frame."
            )
        bed_px = np.stack([stripe_positions(rig, i, 0.0) for i in lasers])
    plan = Plan(
        rig=rig,
        lasers=lasers,
        bands=_bands(rig, lasers, whole=alternating or bed_px is not None),
        settings=ExtractionSettings(method=options.method, channel="auto", noise=rig.noise),
        noise=rig.noise or NoiseModel(),
        off=capture.laser_off,
        bed_px=bed_px,
    )
    plan = _settle_light(plan, frames, options)
    if capture.reference is not None:
        plan = replace(plan, drift=_bed_drift(plan, frames, capture.reference))
    return plan, frames


def _bed_drift(plan: Plan, frames: FrameSequence, reference: FrameSequence) -> BedDrift:
    """Drift of the bed against the reference pass, seen in some frames along the pass."""
    off = read_image(plan.off, plan.rig.camera.size) if plan.off is not None else None
    places = [int(i) for i in np.unique(np.linspace(0, len(frames) - 1, DRIFT_FRAMES).astype(int))]
    pairs = zip(frames.read(places), reference.read([frames.frames[i].index for i in places]), strict=True)
    carts, shifts = [], []
    for frame, bed in pairs:
        if frame.image is None or bed.image is None:
            continue
        try:
            line = smooth_line(plan.profile(bed.image, off).centre_px)
            shift = drift_of(plan.profile(frame.image, off).centre_px, line)
        except StripeError:
            continue
        if np.isfinite(shift).all():
            carts.append(frame.entry.cart_mm)
            shifts.append(shift)
    order = np.argsort(carts, kind="stable")
    return BedDrift(np.array(carts)[order], np.array(shifts).T[:, order] if shifts else np.empty((0, 0)))


def _lasers(rig: Rig, options: ReconstructionOptions) -> tuple[int, ...]:
    unknown = sorted(options.sources - set(LASER_NAMES))
    if unknown:
        raise RigError(f"Unknown source {unknown[0]!r}: a laser pass has the sources laser1 and laser2.")
    lasers = tuple(i for i in range(len(rig.sheets)) if LASER_NAMES[i] in options.sources)
    if not lasers:
        wanted = " and ".join(sorted(options.sources)) or "no source"
        raise RigError(f"{wanted} was asked for, but rig {rig.name!r} has {len(rig.sheets)} laser(s): choose laser1.")
    return lasers


def _bands(rig: Rig, lasers: tuple[int, ...], *, whole: bool) -> IntArray:
    width, height = rig.camera.size
    columns, rows = (width, height) if rig.stripe_runs == "along-u" else (height, width)
    bands = np.zeros((len(lasers), columns, 2), np.int32)
    bands[..., 1] = rows
    if whole and len(lasers) == 1:
        return bands
    camera_height = float(rig.bed_from_camera.translation_mm[2])
    for k, laser in enumerate(lasers):
        # A little below the bed for a sagging table, and up to where the stripe leaves the picture.
        low, high = stripe_rows(rig, laser, -0.03 * camera_height, 0.75 * camera_height)
        bands[k, :, 0], bands[k, :, 1] = low, high
    return bands


def _settle_light(plan: Plan, frames: FrameSequence, options: ReconstructionOptions) -> Plan:
    """Choose channel and noise model from a few frames of the pass, unless they are given."""
    off = read_image(plan.off, plan.rig.camera.size) if plan.off is not None else None
    places = np.unique(np.linspace(0, len(frames) - 1, 2 * SAMPLED_FRAMES + 1).astype(int)[1:-1:2])
    images = [f.image for f in frames.read([int(i) for i in places]) if f.image is not None]
    if not images:
        return plan
    # One frame of another kind must not decide, or stop, anything: it is counted when its turn comes.
    kinds = [image.ndim for image in images]
    images = [image for image in images if image.ndim == max(set(kinds), key=kinds.count)]
    # The stripe of a laser that was not asked for is no texture either.
    every = tuple(range(len(plan.rig.sheets)))
    bands = plan.bands if every == plan.lasers else _bands(plan.rig, every, whole=True)
    choice = choose_light(images, bands, along_v=plan.along_v, off=off, channel=options.channel)
    plan = replace(plan, settings=replace(plan.settings, channel=choice.channel))
    if not choice.subtract_off:
        plan, off = replace(plan, off=None), None
    lights = [plan.light(image, off) for image in images]
    noise = plan.rig.noise or _noise(plan, lights)
    return replace(plan, noise=noise, widths=usual_widths(lights, plan.bands, plan.settings, noise))


def _noise(plan: Plan, lights: list[Light]) -> NoiseModel:
    """Noise model from a few frames of the pass."""
    noise = rounded(NoiseModel(read_dn=float(np.median([read_noise(light) for light in lights]))))
    start = noise
    for _ in range(2 if plan.settings.method == "maximum-likelihood" else 0):
        pictures = [(light, extract_light(light, plan.bands, plan.settings, noise)) for light in lights]
        noise = noise_from_residuals(pictures, start, plan.settings)
    return noise


def require_stripes(found: int, frames: int, folder: Path, problems: Sequence[FrameProblem]) -> None:
    """Raise `StripeError` if a whole pass gave no stripe, `FrameError` if none of its frames could be read."""
    if not found and problems and all(problem.reason != NO_STRIPE for problem in problems):
        raise FrameError(
            f"None of the {frames} frames in {folder} can be used; the first fails because {problems[0].reason}."
        )
    if not found:
        raise StripeError(
            f"None of the {frames} frames in {folder} shows a laser stripe: check that the lasers were on, the "
            "exposure, and that the rig is the one of this scanner."
        )
