"""The simulated image sensor: blur, noise, and what a camera's settings change."""

from dataclasses import dataclass

import cv2
import numpy as np

from twinline.arrays import FloatArray


@dataclass(frozen=True)
class Sensor:
    """How light becomes grey levels (DN).

    Attributes
    ----------
    blur_px
        Standard deviation of the point spread of lens and pixel together.
    read_dn
        Standard deviation of the noise in the dark, before rounding.
    electrons_per_dn
        Sets the shot noise: variance = signal / electrons_per_dn.
    speckle
        Contrast of the laser's speckle in the finished picture; neighbouring pixels share it as far as they share the
        blur.
    laser_response : (float, float, float)
        Grey levels of blue, green and red for one grey level of laser light, unless a laser has a colour of its own.
    falloff
        How far the lens darkens towards its corners, as a share of the natural cosine-to-the-fourth law.
    """

    blur_px: float = 0.7
    read_dn: float = 1.4
    electrons_per_dn: float = 60.0
    speckle: float = 0.12
    laser_response: tuple[float, float, float] = (0.07, 0.12, 1.0)
    falloff: float = 0.0

    @property
    def speckle_sigma(self) -> float:
        """Sigma of the logarithm of the speckle before the blur that leaves the stated contrast behind it."""
        if self.speckle <= 0:
            return 0.0
        kernel = blur_kernel(self.blur_px)
        kept = float((kernel**2).sum())
        return float(np.sqrt(np.log1p((self.speckle / kept) ** 2)))


@dataclass(frozen=True)
class Exposure:
    """What the camera's controls change, against the setting for which light and noise are stated.

    Attributes
    ----------
    time
        Factor on the light that is collected.
    gain
        Factor on the grey levels of what was collected, and on its noise.
    """

    time: float = 1.0
    gain: float = 1.0


def blur_kernel(blur_px: float, widths: float = 4.0) -> FloatArray:
    """One side of the separable point spread out to so many standard deviations, summing to 1; a 1 for no blur."""
    if blur_px <= 0:
        return np.ones(1)
    half = max(round(widths * blur_px), 1)
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) / blur_px) ** 2)
    return np.asarray(kernel / kernel.sum())


def blur(light: FloatArray, blur_px: float) -> FloatArray:
    """Spread light as lens and pixels do, (rows, columns[, 3]) of float32."""
    kernel = blur_kernel(blur_px)
    if len(kernel) == 1 or not light.size:
        return light
    return np.asarray(cv2.sepFilter2D(light, -1, kernel, kernel, borderType=cv2.BORDER_REPLICATE))
