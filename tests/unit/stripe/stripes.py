"""Small pictures of stripes, and independent formulas, for the tests of single modules."""

import numpy as np
from scipy.stats import norm

from twinline.arrays import ByteArray, FloatArray
from twinline.stripe.light import Light, take_light


def clean_picture(
    centres: FloatArray,
    *,
    rows: int = 96,
    width_px: float = 2.0,
    amplitude_dn: float = 150.0,
    background_dn: float = 20.0,
) -> ByteArray:
    """A picture, (rows, columns), of a noiseless stripe rounded to 8 bits; no stripe where the centre is NaN."""
    k = np.arange(rows)[:, None]
    stripe = np.nan_to_num(amplitude_dn * np.exp(-((k - centres) ** 2) / (2 * width_px**2)))
    return np.clip(np.rint(background_dn + stripe), 0, 255).astype(np.uint8)


def noisy_picture(
    centres: FloatArray,
    rng: np.random.Generator,
    *,
    rows: int = 96,
    width_px: float = 2.0,
    amplitude_dn: float = 120.0,
    noise_dn: float = 2.0,
    contrast: float = 0.0,
    background_dn: float = 20.0,
) -> ByteArray:
    """The same with read noise and speckle."""
    k = np.arange(rows)[:, None]
    stripe = np.nan_to_num(amplitude_dn * np.exp(-((k - centres) ** 2) / (2 * width_px**2)))
    stripe = stripe * (1 + contrast * rng.standard_normal(stripe.shape))
    value = background_dn + stripe + noise_dn * rng.standard_normal(stripe.shape)
    return np.clip(np.rint(value), 0, 255).astype(np.uint8)


def gray_light(image: ByteArray) -> Light:
    return take_light(image, "gray", along_v=False)


def whole_band(light: Light) -> np.ndarray[tuple[int, ...], np.dtype[np.int32]]:
    bands = np.zeros((1, light.columns, 2), np.int32)
    bands[..., 1] = light.rows
    return bands


def censored_log_likelihood(
    theta: FloatArray, pixels: FloatArray, level: float, noise_dn: float, contrast: float = 0.0
) -> float:
    """Log-likelihood of (centre, log width, log amplitude, background, gradient); pixels at NaN are over the level."""
    k = np.arange(len(pixels))
    signal = np.exp(theta[2] - 0.5 * ((k - theta[0]) / np.exp(theta[1])) ** 2)
    mean = theta[3] + theta[4] * (k - len(pixels) / 2) + signal
    deviation = np.sqrt(noise_dn**2 + (contrast * signal) ** 2)
    over = np.isnan(pixels)
    told = norm.logpdf(pixels[~over], mean[~over], deviation[~over]).sum()
    return float(told + norm.logcdf((mean[over] - level) / deviation[over]).sum())
