"""What the grids do not show: pixel locking, detection, the image's border, two lasers, colour, subtracted frames."""

from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from scipy.ndimage import gaussian_filter

from tests.accuracy.bounds import centre_bound_px, cut_bounds_px
from tests.accuracy.stripe_grids import COLUMNS, ROWS, SWING_PX, Outcome, generator, judge
from tests.accuracy.synthetic_columns import Floats, Picture, Stripe, brightness, expose, photograph, wavy
from twinline.stripe import Channel, ExtractionSettings, Flag, Method, extract

LOCKING_PHASES = 40
LOCKING_COLUMNS = 800
LOCKED = tuple(Stripe(s, 160.0, 1.0) for s in (0.8, 1.0, 1.5, 2.0, 3.0, 4.0))

CAMERA_ROWS, CAMERA_COLUMNS = 720, 1280

GAPPED = (Stripe(1.0, 40.0, 6.0), Stripe(2.0, 40.0, 6.0), Stripe(4.0, 40.0, 6.0), Stripe(2.0, 80.0, 3.0), Stripe())
GAP_COLUMNS = 64

LEAVING = tuple(Stripe(s, a, n) for s in (1.0, 2.0, 4.0) for a, n in ((80.0, 3.0), (200.0, 2.0)))

TEXTURED = tuple(Stripe(s, a, background_dn=60.0) for s in (1.0, 2.0, 4.0) for a in (60.0, 120.0))
TEXTURE_DN = 15.0
TEXTURE_GRAIN_PX = 2.0


@dataclass(frozen=True)
class Locking:
    """Mean error of the centre at `LOCKING_PHASES` sub-pixel phases: largest and RMS, and what chance alone leaves."""

    stripe: Stripe
    worst_px: float
    rms_px: float
    chance_px: float


@cache
def locking(stripe: Stripe, method: Method = "maximum-likelihood") -> Locking:
    """How much the centre depends on where in its pixel the stripe lies."""
    phases = (np.arange(LOCKING_PHASES) + 0.5) / LOCKING_PHASES - 0.5
    centres = ROWS // 2 + np.tile(phases, LOCKING_COLUMNS)
    image = photograph(stripe, ROWS, centres, generator(stripe, "locking"))
    error = extract(image, ExtractionSettings(method=method)).centre_px[0] - centres
    mean = np.nanmean(error.reshape(LOCKING_COLUMNS, LOCKING_PHASES), axis=0)
    chance = centre_bound_px(stripe) / np.sqrt(LOCKING_COLUMNS)
    return Locking(stripe, float(np.abs(mean).max()), float(np.sqrt(np.mean(mean**2))), float(chance))


@cache
def false_share(noise_dn: float, gradient_dn_per_px: float = 0.0) -> float:
    """Share of columns of a whole camera picture without any stripe in which one is found."""
    empty = Stripe(2.0, 1.0, noise_dn, background_dn=60.0, gradient_dn_per_px=gradient_dn_per_px)
    nowhere = np.full(4 * CAMERA_COLUMNS, np.nan)
    image = photograph(empty, CAMERA_ROWS, nowhere, generator(empty, "empty"))
    return float(extract(image).found.mean())


@cache
def gaps(stripe: Stripe) -> tuple[float, float, float]:
    """Shares of lit columns found, of dark columns where something is found, and of the former grossly wrong.

    Every other run of `GAP_COLUMNS` columns of a whole camera picture is dark.
    """
    rng = generator(stripe, "gaps")
    columns = 4 * CAMERA_COLUMNS
    centres = wavy(columns, CAMERA_ROWS, 100.0, rng)
    dark = (np.arange(columns) // GAP_COLUMNS) % 2 == 1
    centres[dark] = np.nan
    profile = extract(photograph(stripe, CAMERA_ROWS, centres, rng))
    outcome = judge(stripe, profile, centres, centre_bound_px(stripe))
    return 1.0 - outcome.lost, float(profile.found[0, dark].mean()), outcome.gross


@dataclass(frozen=True)
class Leaving:
    """Stripes whose centre is within three widths of the picture's border, the rest of the profile cut off.

    Attributes
    ----------
    ratio
        Root mean square of the error over each column's own bound for the pixels that are left.
    flagged
        Share of the centres nearer than two widths that carry NEAR_EDGE.
    """

    stripe: Stripe
    side: str
    ratio: float
    lost: float
    flagged: float


@cache
def leaving(stripe: Stripe, side: str) -> Leaving:
    """A stripe that leaves the picture at its top or bottom."""
    rng = generator(stripe, f"leaving at the {side}")
    ramp = np.abs(np.arange(2048) % 128 / 64.0 - 1.0)
    distance = np.abs(3.0 * stripe.width_px * ramp + rng.uniform(-0.5, 0.5, ramp.size))
    centres = distance if side == "top" else ROWS - 1 - distance
    profile = extract(photograph(stripe, ROWS, centres, rng))
    found = profile.found[0]
    error = (profile.centre_px[0] - centres)[found] / cut_bounds_px(stripe, ROWS, centres[found])
    near = found & (distance < 1.9 * stripe.width_px)
    flagged = (profile.flags[0, near] & int(Flag.NEAR_EDGE)) != 0
    return Leaving(stripe, side, float(np.sqrt(np.mean(error**2))), float(1 - found.mean()), float(flagged.mean()))


@cache
def two_lasers(stripe: Stripe) -> tuple[Outcome, Outcome]:
    """Two stripes of one picture, told apart by bands given in the reverse order of their rows."""
    rng = generator(stripe, "two lasers")
    columns, rows = COLUMNS, 2 * ROWS
    wave = 20.0 * np.sin(np.arange(columns) / 90.0)
    upper, lower = (row + wave + rng.uniform(-1, 1, columns) for row in (64.0, 190.0))
    ambient, first = brightness(stripe, rows, upper)
    _, second = brightness(stripe, rows, lower)
    image = expose(stripe, ambient, rng, speckled=first + second)
    bands = np.empty((2, columns, 2), np.int32)
    bands[0] = (rows // 2, rows)
    bands[1] = (0, rows // 2)
    profile = extract(image, bands=bands)
    bound = centre_bound_px(stripe)
    return judge(stripe, profile, lower, bound, laser=0), judge(stripe, profile, upper, bound, laser=1)


@lru_cache(maxsize=2)
def textured_scene(stripe: Stripe, purpose: str) -> tuple[Picture, Picture, Floats]:
    """A colour picture of a red stripe on a grey textured surface, the same with the laser off, and the centres."""
    rng = generator(stripe, purpose)
    centres = wavy(COLUMNS, ROWS, SWING_PX, rng)
    texture = gaussian_filter(rng.standard_normal((ROWS, COLUMNS)), TEXTURE_GRAIN_PX)
    ambient, signal = brightness(stripe, ROWS, centres)
    ambient = ambient + texture * (TEXTURE_DN / texture.std())
    red = expose(stripe, ambient, rng, speckled=signal)
    other = [expose(stripe, ambient, rng) for _ in range(5)]
    return np.dstack([other[0], other[1], red]), np.dstack(other[2:]), centres


@cache
def on_texture(stripe: Stripe, channel: Channel, *, off: bool) -> Outcome:
    """A red stripe on texture, in one channel, in a difference of channels, or less a laser-off picture."""
    image, dark, centres = textured_scene(stripe, "texture")
    profile = extract(image, ExtractionSettings(channel=channel), off=dark if off else None)
    exposures = (2 if off else 1) * (2 if channel == "red-blue" else 1)
    return judge(stripe, profile, centres, centre_bound_px(stripe, exposures=exposures))
