"""The stripes of a laser pass, extracted without knowing where they can lie."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from twinline.arrays import BoolArray, ByteArray, FloatArray, IntArray
from twinline.errors import CaptureError, InputError, StripeError
from twinline.geometry.noise import NoiseModel
from twinline.geometry.rig import StripeRuns
from twinline.recording.capture import Capture
from twinline.recording.frames import Frame, FrameSequence
from twinline.recording.images import read_image
from twinline.stripe.choice import choose_light
from twinline.stripe.extraction import extract_light
from twinline.stripe.layout import find_layout
from twinline.stripe.light import Light, take_light
from twinline.stripe.model import ExtractionSettings, Flag, StripeProfile
from twinline.stripe.noise import noise_from_residuals, read_noise, rounded

Report = Callable[[int, int], None]

_SAMPLED_FRAMES = 9
_MOST_FRAMES = 1200
_SATURATED = int(Flag.SATURATED)
_UNWANTED = int(Flag.POOR_FIT | Flag.BROKEN | Flag.WIDE | Flag.NARROW | Flag.NEAR_EDGE)


@dataclass(frozen=True, eq=False)
class PassStripes:
    """Stripes of the frames of a pass.

    Attributes
    ----------
    cart_mm : (frames,) array
        Commanded positions, ascending in the order of the frames.
    centre_px, sd_px, amplitude_dn : (lasers, frames, lanes) float32 arrays
        NaN where there is no stripe fit to measure with.
    lit : (lasers, frames) bool array
    noise
        Noise of the pixels, from the stripes of the whole pass.
    settings
        What the stripes were extracted with.
    problems
        Frames that could not be used, with the reason.
    rejected_share
        Share of the found stripes that were left out for their shape.
    saturated_share
        For each laser the share of its stripes whose light is cut off at the top of the scale.
    """

    cart_mm: FloatArray
    centre_px: FloatArray
    sd_px: FloatArray
    amplitude_dn: FloatArray
    lit: BoolArray
    noise: NoiseModel
    settings: ExtractionSettings
    bands: IntArray
    off: ByteArray | None
    problems: tuple[str, ...]
    rejected_share: float
    saturated_share: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class _Light:
    """How the light of each frame is taken."""

    runs: StripeRuns
    settings: ExtractionSettings
    off: ByteArray | None

    def of(self, image: ByteArray) -> Light:
        return take_light(image, self.settings.channel, along_v=self.runs == "along-v", off=self.off)


def read_stripes(capture: Capture, *, report: Report = lambda done, total: None) -> PassStripes:
    """Extract the stripes of a capture's laser pass; of a very long pass an even choice of frames.

    Two stripes that are lit at once are told apart by their order: the one of the laser on the + side is the lower
    one, since a rising surface drives them apart.

    Raises
    ------
    CaptureError
        There is no laser pass.
    StripeError
        No frame shows a stripe, or there are not two where there should be.
    """
    if capture.laser is None:
        raise CaptureError(
            f"{capture.path} holds no laser pass, so the laser sheets cannot be calibrated: put its frames and "
            "frames.csv into laser/, or leave the sheets out with --only."
        )
    frames = capture.laser
    frames.check_sizes()
    if len(frames) > _MOST_FRAMES:
        frames = frames.select([int(i) for i in np.unique(np.linspace(0, len(frames) - 1, _MOST_FRAMES).astype(int))])
    runs = capture.info.stripe_runs
    lasers = len(capture.info.lasers)
    samples = _sampled(frames)
    alternating = lasers == 2 and all(f.lasers is not None and len(f.lasers) < 2 for f in frames.frames)
    bands = _bands(samples, capture, lasers, whole=alternating or lasers == 1)
    light, noise = _settle(samples, capture, bands)
    return _read_all(frames, light, noise, bands, runs, report)


def _sampled(frames: FrameSequence) -> list[ByteArray]:
    places = np.unique(np.linspace(0, len(frames) - 1, 2 * _SAMPLED_FRAMES + 1).astype(int)[1:-1:2])
    images = [f.image for f in frames.read([int(i) for i in places]) if f.image is not None]
    if not images:
        raise StripeError(
            f"None of the frames sampled from {frames.source} can be read: check the files, or record the pass again."
        )
    return images


def _bands(images: list[ByteArray], capture: Capture, lasers: int, *, whole: bool) -> IntArray:
    """Search bands (lasers, lanes, 2), laser by laser in the order of ``capture.json``."""
    height, width = images[0].shape[:2]
    lanes, rows = (width, height) if capture.info.stripe_runs == "along-u" else (height, width)
    bands = np.zeros((lasers, lanes, 2), np.int32)
    bands[..., 1] = rows
    if whole:
        return bands
    off = read_image(capture.laser_off) if capture.laser_off is not None else None
    cuts = []
    for image in images:
        try:
            layout = find_layout(image, ExtractionSettings(), off=off, runs=capture.info.stripe_runs, lasers=2)
        except StripeError:
            continue
        cuts.append(layout.bands[0, :, 0])
    cut = np.median(cuts, axis=0).astype(np.int32) if cuts else np.full(lanes, rows // 2, np.int32)
    for k, laser in enumerate(capture.info.lasers):
        bands[k, :, 0 if laser.side[0] == "+" else 1] = cut
    return bands


def _settle(images: list[ByteArray], capture: Capture, bands: IntArray) -> tuple[_Light, NoiseModel]:
    """Channel, laser-off picture and noise, in the way of a reconstruction."""
    runs = capture.info.stripe_runs
    off = read_image(capture.laser_off) if capture.laser_off is not None else None
    choice = choose_light(images, bands, along_v=runs == "along-v", off=off)
    settings = ExtractionSettings(channel=choice.channel)
    light = _Light(runs, settings, off if choice.subtract_off else None)
    lights = [light.of(image) for image in images]
    start = rounded(NoiseModel(read_dn=float(np.median([read_noise(item) for item in lights]))))
    noise = start
    for _ in range(2):
        pictures = [(item, extract_light(item, bands, settings, noise)) for item in lights]
        noise = noise_from_residuals(pictures, start, settings)
    return light, noise


def _read_all(
    frames: FrameSequence, light: _Light, noise: NoiseModel, bands: IntArray, runs: StripeRuns, report: Report
) -> PassStripes:
    lasers, lanes = bands.shape[:2]
    values = np.full((3, lasers, len(frames), lanes), np.nan, np.float32)
    lit = np.ones((lasers, len(frames)), bool)
    problems: list[str] = []
    found, rejected, saturated = np.zeros(lasers), 0, np.zeros(lasers)
    for place, frame in enumerate(frames.read()):
        on = frame.entry.lasers
        lit[:, place] = [on is None or k + 1 in on for k in range(lasers)]
        profile, reason = _profile(frame, light, noise, bands, lit[:, place])
        if profile is None:
            problems.append(f"{frame.entry.name}: {reason}")
            lit[:, place] = False
        else:
            shapely = profile.found & ((profile.flags & _UNWANTED) == 0)
            found += profile.found.sum(axis=1)
            rejected += int((profile.found & ~shapely).sum())
            saturated += (profile.found & ((profile.flags & _SATURATED) != 0)).sum(axis=1)
            for row, name in enumerate((profile.centre_px, profile.sd_px, profile.amplitude_dn)):
                values[row, :, place] = np.where(shapely & lit[:, place, None], name, np.nan)
        report(place + 1, len(frames))
    if not np.isfinite(values[0]).any() and saturated.sum() > 0.5 * found.sum():
        raise StripeError(
            f"The stripes in {frames.source} are saturated and too wide to measure: shorten the exposure or dim the "
            "lasers until their middle is just below white, and record the pass again."
        )
    if not np.isfinite(values[0]).any():
        raise StripeError(
            f"None of the {len(frames)} frames in {frames.source} shows a laser stripe: check that the lasers were on "
            "and the exposure."
        )
    order = np.argsort([f.cart_mm for f in frames.frames], kind="stable")
    values = values[:, :, order]
    carts = np.array([f.cart_mm for f in frames.frames])[order]
    return PassStripes(
        carts, values[0], values[1], values[2], lit[:, order], noise, light.settings, bands, light.off, tuple(problems),
        rejected / max(found.sum(), 1), tuple((saturated / np.maximum(found, 1)).tolist()),
    )  # fmt: skip


def _profile(
    frame: Frame, light: _Light, noise: NoiseModel, bands: IntArray, lit: BoolArray
) -> tuple[StripeProfile | None, str]:
    if frame.image is None:
        return None, frame.problem or "cannot be read"
    try:
        picture = light.of(frame.image)
        if lit.all():
            return extract_light(picture, bands, light.settings, noise), ""
        # Alone in the picture a stripe may lie anywhere; bands of lasers that are off must not cut it short.
        profile = StripeProfile.empty(len(bands), bands.shape[1])
        for k in np.flatnonzero(lit):
            one = extract_light(picture, bands[k : k + 1], light.settings, noise)
            for name in profile.__dataclass_fields__:
                getattr(profile, name)[k] = getattr(one, name)[0]
        return profile, ""
    except InputError as error:
        return None, error.detail


def bed_noise(capture: Capture, stripes: PassStripes, on_bed: BoolArray) -> NoiseModel:
    """Noise of the pixels from the columns in which the stripes lie on the flat, bare bed.

    Parameters
    ----------
    on_bed : (lasers, frames, lanes) bool array
        Which stripes of ``stripes`` those are.
    """
    assert capture.laser is not None
    order = np.argsort([f.cart_mm for f in capture.laser.frames], kind="stable")
    if len(order) != len(stripes.cart_mm):
        return stripes.noise
    best = np.argsort(-on_bed.sum(axis=(0, 2)), kind="stable")[: 4 * _SAMPLED_FRAMES]
    chosen = {int(order[i]): int(i) for i in best[:: max(len(best) // _SAMPLED_FRAMES, 1)]}
    light = _Light(capture.info.stripe_runs, stripes.settings, stripes.off)
    start = replace(stripes.noise)
    pictures: list[tuple[Light, StripeProfile]] = []
    places = sorted(chosen)
    for place, frame in zip(places, capture.laser.read(places), strict=True):
        if frame.image is None:
            continue
        picture = light.of(frame.image)
        profile = extract_light(picture, stripes.bands, stripes.settings, start)
        profile.centre_px[~on_bed[:, chosen[place]]] = np.nan
        pictures.append((picture, profile))
    plain = rounded(NoiseModel(read_dn=float(np.median([read_noise(p[0]) for p in pictures])))) if pictures else start
    measured = noise_from_residuals(pictures, plain, stripes.settings) if pictures else start
    return start if measured == plain else measured
