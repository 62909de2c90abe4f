"""The grids over which stripe centres are measured, and what is measured in each cell.

Every cell has its own fixed seed, so a test, the report and a second run see the same pixels.
"""

import zlib
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np

from tests.accuracy.bounds import centre_bound_px, clipped_bounds_px
from tests.accuracy.synthetic_columns import Floats, Picture, Stripe, photograph, wavy
from twinline.geometry.noise import NoiseModel
from twinline.stripe import ExtractionSettings, Method, StripeProfile, extract

SEED = 20240517
COLUMNS = 4096
"""Columns per cell: a root mean square over so many has a relative standard deviation of 1.1 %."""

ROWS = 128
SWING_PX = 4.0

WIDTHS = (1.0, 1.5, 2.0, 3.0, 4.0)
AMPLITUDES = (40.0, 80.0, 160.0, 225.0)
NOISES = (1.0, 2.0, 4.0, 6.0)
ADDITIVE = tuple(Stripe(s, a, n) for s in WIDTHS for a in AMPLITUDES for n in NOISES)

GRADIENTS = (-2.0, -1.0, -0.5, 0.5, 1.0, 2.0)
SLOPED = tuple(
    Stripe(s, a, n, background_dn=95.0, gradient_dn_per_px=g)
    for g in GRADIENTS
    for s in WIDTHS
    for a, n in ((40.0, 6.0), (80.0, 1.0), (80.0, 3.0))
)

EXCESSES = (2.0, 4.0, 6.0, 10.0)
FULL_SCALE_DN = 235.0
"""What takes a stripe on the usual background of 20 DN to the top of the scale."""
SATURATED = tuple(Stripe(s, FULL_SCALE_DN * x, n) for x in EXCESSES for s in WIDTHS for n in (1.0, 3.0, 6.0))

CONTRASTS = (0.1, 0.2, 0.3, 0.37)
SPECKLED = tuple(
    Stripe(s, a, n, contrast=c) for c in CONTRASTS for s in WIDTHS for a in (40.0, 80.0, 160.0) for n in (1.0, 3.0, 6.0)
)


SHOT = tuple(Stripe(s, a, 2.0, electrons_per_dn=20.0) for s in WIDTHS for a in (40.0, 80.0, 160.0))

BUDGETED_CONTRASTS = (0.2, 0.3, 0.37)


@dataclass(frozen=True)
class Outcome:
    """What extraction made of one cell.

    Attributes
    ----------
    ratio
        Root mean square error of the centre over the bound, of the centres that have not gone astray.
    ratio_of_all
        The same of all.
    sd_ratio
        Root mean square of the reported standard deviation over that of the error, not astray.
    pull
        Root mean square of the error in units of each column's own reported standard deviation, not astray.
    bias
        Mean error over the bound, not astray.
    lost
        Share of columns without a centre.
    gross
        Share of centres more than 1 px and more than 5 bounds off.
    astray
        Share of centres more than three stripe widths and 5 bounds off: another peak than the stripe's was taken, of
        which a bound for the stripe's own position says nothing.
    """

    stripe: Stripe
    bound_px: float
    ratio: float
    ratio_of_all: float
    sd_ratio: float
    pull: float
    bias: float
    lost: float
    gross: float
    astray: float


def generator(stripe: Stripe, purpose: str = "") -> np.random.Generator:
    """The random numbers of a cell."""
    return np.random.default_rng([SEED, zlib.crc32(f"{stripe}{purpose}".encode())])


def pixel_noise(stripe: Stripe, exposures: int = 1) -> NoiseModel:
    """The noise that a cell's pixels have, rounding included, as one would give it to the extraction."""
    read = np.sqrt(exposures * (stripe.noise_dn**2 + 1 / 12))
    return NoiseModel(float(read), stripe.electrons_per_dn, stripe.contrast)


@lru_cache(maxsize=4)
def picture(stripe: Stripe, columns: int = COLUMNS, rows: int = ROWS) -> tuple[Picture, Floats]:
    """A cell's picture and true centres."""
    rng = generator(stripe)
    centres = wavy(columns, rows, SWING_PX, rng)
    return photograph(stripe, rows, centres, rng), centres


def judge(stripe: Stripe, profile: StripeProfile, centres: Floats, bound_px: float, laser: int = 0) -> Outcome:
    """Compare centres with the truth; columns without a true centre are left out."""
    true = np.isfinite(centres)
    found = profile.found[laser] & true
    error = profile.centre_px[laser][found] - centres[found]
    near = np.abs(error) <= max(3.0 * stripe.width_px, 5.0 * bound_px)
    kept, sd = error[near], profile.sd_px[laser][found][near]
    rms = _rms(kept)
    return Outcome(
        stripe,
        bound_px,
        ratio=rms / bound_px,
        ratio_of_all=_rms(error) / bound_px,
        sd_ratio=_rms(sd) / rms,
        pull=_rms(kept / sd),
        bias=float(np.mean(kept)) / bound_px if kept.size else float("nan"),
        lost=float(1.0 - found.sum() / true.sum()),
        gross=float(np.mean(np.abs(error) > max(1.0, 5.0 * bound_px))),
        astray=float(np.mean(~near)),
    )


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


@cache
def plain(stripe: Stripe, method: Method = "maximum-likelihood", noise_given: bool = False) -> Outcome:
    """One cell of the additive, sloped or speckled grids; the noise is given, or estimated from the picture itself."""
    image, centres = picture(stripe)
    settings = ExtractionSettings(method=method, noise=pixel_noise(stripe) if noise_given else None)
    return judge(stripe, extract(image, settings), centres, centre_bound_px(stripe))


def given(stripe: Stripe) -> Outcome:
    """The same with the true noise model given, as a rig whose noise has been measured has it."""
    return plain(stripe, noise_given=True)


@cache
def saturated(stripe: Stripe, method: Method = "maximum-likelihood") -> Outcome:
    """One cell of the saturated grid, against the bound for clipped pixels."""
    image, centres = picture(stripe)
    bound_px = float(np.sqrt(np.mean(clipped_bounds_px(stripe) ** 2)))
    return judge(stripe, extract(image, ExtractionSettings(method=method)), centres, bound_px)
