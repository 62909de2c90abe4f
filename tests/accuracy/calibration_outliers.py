"""Gross errors among what a scanner is calibrated from."""

from dataclasses import replace

import numpy as np

from twinline.calibration.scanner import ScannerData, StripeTable

_PATCH = (6, 12)
"""Frames and lanes."""


def scattered(clean: ScannerData, share: float, *, seed: int = 1) -> ScannerData:
    """A share of the stripes anywhere in the picture, and of the ToF readings anywhere in the range."""
    rng = np.random.default_rng(seed)
    tables = []
    for table in clean.stripes:
        centre = table.centre_px.copy()
        wrong = np.isfinite(centre) & (rng.random(centre.shape) < share)
        centre[wrong] = rng.uniform(np.nanmin(centre) - 100, np.nanmax(centre) + 100, int(wrong.sum()))
        tables.append(StripeTable(centre, table.sd_px, table.cart_mm))
    assert clean.tof is not None
    reading = clean.tof.reading.copy()
    wrong = rng.random(len(reading)) < share
    reading[wrong] = rng.uniform(0, 4095, int(wrong.sum()))
    return replace(clean, stripes=tuple(tables), tof=replace(clean.tof, reading=reading))


def in_patches(clean: ScannerData, share: float, *, seed: int = 2) -> ScannerData:
    """A share of the stripes on a wrong surface, whole patches of them together."""
    rng = np.random.default_rng(seed)
    tables = []
    for table in clean.stripes:
        centre = table.centre_px.copy()
        frames, lanes = centre.shape
        for _ in range(int(share * frames * lanes / (_PATCH[0] * _PATCH[1]))):
            i, j = rng.integers(0, frames - _PATCH[0]), rng.integers(0, lanes - _PATCH[1])
            centre[i : i + _PATCH[0], j : j + _PATCH[1]] += rng.uniform(5, 60) * rng.choice([-1, 1])
        tables.append(StripeTable(centre, table.sd_px, table.cart_mm))
    return replace(clean, stripes=tuple(tables))
