"""Pictures of one stripe per column with known centres; shares no code with what it measures.

Pixel k of a column holds ``background + gradient (k - k0) + A exp(-(k - mu)^2 / (2 s^2)) (1 + C g) + shot + n h``, with
independent standard normal g (speckle) and h (read noise) per pixel, clipped to 0..255 and rounded to 8 bits.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating[Any]]
Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Stripe:
    """One cell of a grid: the light of a stripe and the noise of the camera that sees it."""

    width_px: float = 2.0
    amplitude_dn: float = 120.0
    noise_dn: float = 2.0
    background_dn: float = 20.0
    gradient_dn_per_px: float = 0.0
    contrast: float = 0.0
    electrons_per_dn: float = float("inf")

    def __str__(self) -> str:
        name = f"s{self.width_px:g}-A{self.amplitude_dn:g}-n{self.noise_dn:g}"
        if self.gradient_dn_per_px:
            name += f"-g{self.gradient_dn_per_px:+g}"
        if self.contrast:
            name += f"-C{self.contrast:g}"
        if np.isfinite(self.electrons_per_dn):
            name += f"-K{self.electrons_per_dn:g}"
        return name


def brightness(stripe: Stripe, rows: int, centres: Floats) -> tuple[Floats, Floats]:
    """Mean light of every pixel, as (ambient, stripe), each (rows, columns), in DN before clipping."""
    k = np.arange(rows, dtype=np.float64)[:, None]
    ambient = stripe.background_dn + stripe.gradient_dn_per_px * (k - (rows - 1) / 2)
    signal = stripe.amplitude_dn * np.exp(-((k - centres) ** 2) / (2 * stripe.width_px**2))
    return np.broadcast_to(ambient, signal.shape), signal


def expose(stripe: Stripe, light: Floats, rng: np.random.Generator, *, speckled: Floats | float = 0.0) -> Picture:
    """What an 8-bit camera makes of some ambient light plus some light that speckles, in DN."""
    laser = np.broadcast_to(np.asarray(speckled, dtype=np.float64), light.shape)
    if stripe.contrast:
        laser = laser * (1.0 + stripe.contrast * rng.standard_normal(light.shape))
    value = light + laser
    if np.isfinite(stripe.electrons_per_dn):
        # Only the laser's electrons fluctuate here: what the ambient light adds is the same in every pixel.
        value = value + np.sqrt(np.maximum(laser, 0.0) / stripe.electrons_per_dn) * rng.standard_normal(light.shape)
    value = value + stripe.noise_dn * rng.standard_normal(light.shape)
    return np.clip(np.rint(value), 0, 255).astype(np.uint8)


def photograph(stripe: Stripe, rows: int, centres: Floats, rng: np.random.Generator) -> Picture:
    """A gray picture, (rows, columns), of a stripe along u with the given centre per column (NaN: no stripe there)."""
    ambient, signal = brightness(stripe, rows, centres)
    return expose(stripe, ambient, rng, speckled=np.nan_to_num(signal))


def wavy(columns: int, rows: int, swing_px: float, rng: np.random.Generator) -> Floats:
    """Centres of a stripe that winds slowly about the middle row, every sub-pixel phase equally often.

    Phases are random, so that neighbours tell no more of each other than that the stripe goes on; it never moves by
    more than 1.5 px from one column to the next, as across a step it would.
    """
    turns = max(1, round(columns * 0.4 / (2 * np.pi * swing_px)))
    wave = swing_px * np.sin(2 * np.pi * turns * np.arange(columns) / columns)
    return np.asarray((rows - 1) / 2 + wave + rng.uniform(-0.5, 0.5, columns))
