"""Which light of a pass to measure: decided by looking at some of its pictures, not by rule.

Compressed video halves the resolution of colour, which blurs and shifts red; luma is sharp but mixes in the texture of
the surface; red less blue cancels the texture of grey surfaces; a laser-off picture cancels it too, if the scene stood
still between the two, and adds ghosts of it if not. What counts is how far the stripes stand out of everything that is
not stripe.
"""

from dataclasses import dataclass

import numpy as np

from twinline.arrays import ByteArray, FloatArray, IntArray
from twinline.geometry.noise import NoiseModel
from twinline.stripe.extraction import extract_light
from twinline.stripe.light import Light, take_light
from twinline.stripe.model import Channel, ExtractionSettings
from twinline.stripe.noise import read_noise

STRIPE_REACH_PX = 16
_STEP_PX = 6
_WHITE_CORE_DN = 200
_WHITE_SHARE = 0.2
_LUMA_BONUS = 1.25
"""Red of compressed pictures is shifted by some hundredths of a pixel (colour siting): it must be better by this."""


@dataclass(frozen=True)
class LightChoice:
    """A channel, whether the laser-off picture is subtracted, and how far stripes stand out of the rest."""

    channel: Channel
    subtract_off: bool
    contrast: float


def choose_light(
    images: list[ByteArray],
    bands: IntArray | None,
    *,
    along_v: bool,
    off: ByteArray | None = None,
    channel: Channel = "auto",
    same_view: bool = False,
) -> LightChoice:
    """The light in which the stripes of some pictures of one pass stand out most.

    Parameters
    ----------
    bands : (lasers, columns, 2) int array or None
        Where the stripes are sought; None for the whole picture.
    off
        A picture with the lasers off.
    channel
        Anything but "auto" leaves only the laser-off picture to decide on.
    same_view
        The laser-off picture shows the very same view, so it is always subtracted.
    """
    gray = all(image.ndim == 2 for image in images)
    channels: tuple[Channel, ...] = ("gray",) if gray else ("luma", "red", "red-blue")
    if channel != "auto":
        channels = (channel,)
    elif not gray and _white_cores(images):
        # In the white core of a very bright stripe the difference of colours vanishes, and one flank remains.
        channels = ("luma", "red")
    subtract = (True,) if off is not None and same_view else (False, True) if off is not None else (False,)
    choices = [
        LightChoice(c, s, _contrast([take_light(i, c, along_v=along_v, off=off if s else None) for i in images], bands))
        for c in channels
        for s in subtract
    ]
    return max(choices, key=lambda choice: choice.contrast * (_LUMA_BONUS if choice.channel == "luma" else 1.0))


def _white_cores(images: list[ByteArray]) -> bool:
    colour = [image for image in images if image.ndim == 3]
    white = sum(int(np.count_nonzero(image.min(axis=2) > _WHITE_CORE_DN)) for image in colour)
    lit = sum(int(np.count_nonzero(image[..., 2] > _WHITE_CORE_DN)) for image in colour)
    return white > _WHITE_SHARE * max(lit, 1)


def _contrast(lights: list[Light], bands: IntArray | None) -> float:
    """Height of the stripes over the root mean square of what varies over a stripe's width elsewhere."""
    heights, textures = [], []
    for light in lights:
        where = bands
        if where is None:
            where = np.zeros((1, light.columns, 2), np.int32)
            where[..., 1] = light.rows
        profile = extract_light(light, where, ExtractionSettings(), NoiseModel(read_dn=round(read_noise(light), 1)))
        found = profile.found
        if found.any():
            heights.append(float(np.median(profile.amplitude_dn[found])))
        textures.append(_texture(light, profile.centre_px))
    return float(np.median(heights)) / max(float(np.mean(textures)), 0.1) if heights else 0.0


def _texture(light: Light, centres: FloatArray) -> float:
    """Root mean square, in DN, of the second difference over `_STEP_PX` rows away from the stripes."""
    rows = np.arange(_STEP_PX, light.rows - _STEP_PX, 3)
    columns = np.arange(0, light.columns, 4)

    def pixels(at: IntArray) -> FloatArray:
        return light.values(at[:, None], columns[None, :])

    bend = pixels(rows) - 0.5 * (pixels(rows - _STEP_PX) + pixels(rows + _STEP_PX))
    with np.errstate(invalid="ignore"):
        away = ~(np.abs(rows[:, None] - centres[:, None, columns]) < STRIPE_REACH_PX + _STEP_PX).any(axis=0)
    return float(np.sqrt(np.mean(bend[away] ** 2))) if away.any() else 0.0
