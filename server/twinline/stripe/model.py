"""What extraction is asked for and what it answers."""

from dataclasses import dataclass, field
from enum import IntFlag
from typing import Literal, get_args

import numpy as np

from twinline.arrays import FloatArray, IntArray
from twinline.errors import StripeError
from twinline.geometry.noise import NoiseModel

Method = Literal["maximum-likelihood", "gaussian", "centre-of-gravity", "steger", "brightest-pixel"]
"""How the centre of a stripe is found in its column.

"maximum-likelihood" is the tabulated estimator of this package (default), "gaussian" the thesis's least-squares fit of
a Gaussian to the brightness profile around the brightest pixel; the others are the field's usual ones.
"""

METHODS: tuple[Method, ...] = get_args(Method)

Channel = Literal["auto", "gray", "luma", "red", "green", "blue", "red-blue"]
"""Which light is measured; "gray" is the only one for pictures of one channel."""

CHANNELS: tuple[Channel, ...] = get_args(Channel)


class Flag(IntFlag):
    """What is remarkable about a stripe in one column."""

    MISSING = 1
    """No stripe: amplitude below the detection limit; the centre is NaN."""
    WEAK = 2
    """Found, but its amplitude is below twice the detection limit."""
    WIDE = 4
    """Much wider than this laser's stripe usually is in this image."""
    NARROW = 8
    """Narrower than any stripe: a hot pixel or an edge."""
    SECOND_PEAK = 16
    """Another peak in the same column is at least half as high."""
    SATURATED = 32
    """Some of its pixels are at the top of the scale; fitted as such."""
    NEAR_EDGE = 64
    """Part of its profile lies outside the image."""
    POOR_FIT = 128
    """Its shape differs from a stripe's by more than the noise explains: an edge, an interreflection, gloss."""
    BROKEN = 256
    """The stripe jumps or ends beside this column, so that its spot may straddle two surfaces."""


REJECTED = Flag.MISSING | Flag.NARROW
"""Flags of columns that hold no measurement whatever the caller wants."""


_VALUES = (
    "centre_px",
    "sd_px",
    "amplitude_dn",
    "width_px",
    "background_dn",
    "runner_up_px",
    "runner_up_dn",
    "misfit",
)


@dataclass(frozen=True, eq=False)
class StripeProfile:
    """Stripes of one image, one row per laser and one entry per column (per image row if stripes run along v).

    Attributes
    ----------
    centre_px : (lasers, columns) float64 array
        Position across the stripe, in pixels of the image; NaN where there is no stripe.
    sd_px : (lasers, columns) float64 array
        Standard deviation of the centre.
    amplitude_dn, width_px, background_dn : (lasers, columns) float64 arrays
        Height of the Gaussian over the background, its standard deviation across the stripe, and the background.
    flags : (lasers, columns) uint16 array
        A combination of `Flag`.
    runner_up_px, runner_up_dn : (lasers, columns) float64 arrays
        Row and height over the background of the next highest peak of the column within the search band, at least
        some stripe widths away; NaN where there is none above the noise.
    misfit : (lasers, columns) float64 array
        Mean squared residual of the fit over its expectation; near 1 for a clean stripe, NaN where the method has none.
    """

    centre_px: FloatArray
    sd_px: FloatArray
    amplitude_dn: FloatArray
    width_px: FloatArray
    background_dn: FloatArray
    flags: IntArray
    runner_up_px: FloatArray
    runner_up_dn: FloatArray
    misfit: FloatArray

    @classmethod
    def empty(cls, lasers: int, columns: int) -> "StripeProfile":
        """A profile in which no stripe has been found yet."""
        # One block for all, since this is made anew for every frame.
        values = np.full((len(_VALUES), lasers, columns), np.nan)
        flags = np.full((lasers, columns), int(Flag.MISSING), np.uint16)
        return cls(flags=flags, **dict(zip(_VALUES, values, strict=True)))

    def rows(self, laser: int) -> tuple[FloatArray, ...]:
        """One laser's rows of all but the flags, in the order in which they are declared."""
        return tuple(getattr(self, name)[laser] for name in _VALUES)

    @property
    def found(self) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """(lasers, columns) bool array: where there is a measurement."""
        return np.isfinite(self.centre_px)


@dataclass(frozen=True)
class ExtractionSettings:
    """How to extract.

    Attributes
    ----------
    method
        Centre estimator.
    channel
        Which light is measured. "auto" takes gray pictures as they are and red in colour pictures.
    noise
        Noise of the pixels; None estimates it from each picture (`twinline.stripe.noise`).
    saturation_dn
        Pixels at or above this level only say "at least so bright".
    detection_snr
        A stripe counts as found when its amplitude exceeds this many of its own standard deviations.
    exclusion_px
        A runner-up peak must lie at least so far from the peak.
    """

    method: Method = "maximum-likelihood"
    channel: Channel = "auto"
    noise: NoiseModel | None = field(default=None)
    saturation_dn: int = 250
    detection_snr: float = 4.5
    exclusion_px: int = 12

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise StripeError(f"Unknown extraction method {self.method!r}; choose one of {', '.join(METHODS)}.")
        if self.channel not in CHANNELS:
            raise StripeError(f"Unknown channel {self.channel!r}; choose one of {', '.join(CHANNELS)}.")
        if not 2 <= self.saturation_dn <= 256:
            raise StripeError(f"The saturation level must be between 2 and 256, not {self.saturation_dn}.")
