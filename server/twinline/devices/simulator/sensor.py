"""The simulated image sensor: blur, shot and read noise, saturation, eight bits."""

from dataclasses import dataclass

import cv2
import numba
import numpy as np

from twinline.arrays import ByteArray, FloatArray
from twinline.devices.simulator.noise_table import TABLE_BITS, next_random, to_normal


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
        Grey levels of blue, green and red for one grey level of laser light.
    """

    blur_px: float = 0.7
    read_dn: float = 1.4
    electrons_per_dn: float = 60.0
    speckle: float = 0.12
    laser_response: tuple[float, float, float] = (0.07, 0.12, 1.0)

    @property
    def speckle_sigma(self) -> float:
        """Sigma of the logarithm of the speckle before the blur that leaves the stated contrast behind it."""
        if self.speckle <= 0:
            return 0.0
        kernel = blur_kernel(self.blur_px)
        kept = float((kernel**2).sum())
        return float(np.sqrt(np.log1p((self.speckle / kept) ** 2)))

    def expose(
        self, room_dn: FloatArray, laser_dn: FloatArray, first_row: int, seed: int, table: FloatArray
    ) -> ByteArray:
        """Turn light into a picture.

        Parameters
        ----------
        room_dn : (height, width, 3) array of float32
            Light of the room, blurred.
        laser_dn : (rows, width) array of float32
            Light of the lasers, blurred, in the rows from ``first_row``.
        seed
            Not 0.
        table
            From ``normal_table``.

        Returns
        -------
        (height, width, 3) array of uint8
            Blue, green, red.
        """
        picture = np.empty(room_dn.shape, dtype=np.uint8)
        response = np.array(self.laser_response, dtype=np.float32)
        _expose(room_dn, laser_dn, first_row, response, self.read_dn, self.electrons_per_dn, seed, table, picture)
        return picture


def blur_kernel(blur_px: float) -> FloatArray:
    """One side of the separable point spread, summing to 1; a single 1 for no blur."""
    if blur_px <= 0:
        return np.ones(1)
    half = int(np.ceil(4 * blur_px))
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) / blur_px) ** 2)
    return np.asarray(kernel / kernel.sum())


def blur(light: FloatArray, blur_px: float) -> FloatArray:
    """Spread light as lens and pixels do, (rows, columns[, 3]) of float32."""
    kernel = blur_kernel(blur_px)
    if len(kernel) == 1 or not light.size:
        return light
    return np.asarray(cv2.sepFilter2D(light, -1, kernel, kernel, borderType=cv2.BORDER_REPLICATE))


@numba.njit(cache=True, nogil=True)
def _expose(
    room: FloatArray,
    laser: FloatArray,
    first_row: int,
    response: FloatArray,
    read_dn: float,
    electrons_per_dn: float,
    seed: int,
    table: FloatArray,
    picture: ByteArray,
) -> None:  # pragma: no cover - compiled
    state = np.uint64(seed)
    read2 = np.float32(read_dn * read_dn)
    shot = np.float32(1.0 / electrons_per_dn)
    # Noise depends on the signal so slowly that whole grey levels suffice.
    spread = np.empty(257, dtype=np.float32)
    for level in range(257):
        spread[level] = np.sqrt(read2 + shot * np.float32(level))
    half = np.float32(0.5)
    top = np.float32(255.0)
    rows, columns, _ = room.shape
    for row in range(rows):
        lit = first_row <= row < first_row + laser.shape[0]
        for column in range(columns):
            state = next_random(state)
            bits = state
            extra = laser[row - first_row, column] if lit else np.float32(0.0)
            for channel in range(3):
                bits = bits >> np.uint64(TABLE_BITS)
                mean = room[row, column, channel] + extra * response[channel]
                noise = spread[int(min(mean, top))] * to_normal(table, bits)
                picture[row, column, channel] = np.uint8(min(max(mean + noise + half, np.float32(0.0)), top))
