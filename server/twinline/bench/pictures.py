"""Pictures to measure on: two noisy stripes on a bed with objects, drawn here, so that no data are needed."""

from dataclasses import dataclass

import numpy as np

from twinline.arrays import ByteArray, FloatArray, IntArray

NOISE_DN = 1.5
_WIDTH_PX = 2.0
_AMBIENT_DN = 18.0
_AMBIENT_SLOPE_DN = 12.0
_AMPLITUDES_DN = (150.0, 130.0)
_TINT = (0.85, 0.95, 1.0)
_SHARES = (0.05, 0.1, 1.0)
_TEXTURE_DN = 6.0
_HALO_PX = 12


@dataclass(frozen=True)
class Brush:
    """Draws pictures of a size, with stripes at given centres; every picture has noise of its own."""

    width: int
    height: int
    rng: np.random.Generator

    def gray(self, centres: FloatArray) -> ByteArray:
        """A gray picture, (height, width), of stripes at ``centres`` (lasers, width)."""
        light = self._ambient() + self._light(centres)
        return _digitised(light + self.rng.normal(0.0, NOISE_DN, light.shape))

    def colour(self, centres: FloatArray) -> ByteArray:
        """A colour picture of red stripes on a textured bed, (height, width, 3), blue green red."""
        texture = self.rng.normal(0.0, _TEXTURE_DN, (self.height // 8 + 1, self.width // 8 + 1))
        ambient = self._ambient() + np.kron(texture, np.ones((8, 8)))[: self.height, : self.width]
        light = self._light(centres)
        picture = np.stack(
            [tint * ambient + share * light for tint, share in zip(_TINT, _SHARES, strict=True)], axis=-1
        )
        return _digitised(picture + self.rng.normal(0.0, NOISE_DN, picture.shape))

    def waves(self, phase: float = 0.0) -> FloatArray:
        """Centres of two stripes, (2, width): over waves, a slope, and blocks with steps."""
        relief = relief_of(self.width, phase)
        return np.asarray(self.height * np.stack([0.70 + 0.08 * relief, 0.30 - 0.08 * relief]))

    def halves(self) -> IntArray:
        """Where each of two stripes is to be sought, (2, width, 2): in the lower and in the upper half."""
        bands = np.zeros((2, self.width, 2), np.int32)
        bands[0, :, 0], bands[0, :, 1] = self.height // 2, self.height
        bands[1, :, 1] = self.height // 2
        return bands

    def _ambient(self) -> FloatArray:
        rows = np.arange(self.height)[:, None] / self.height
        return np.asarray(np.broadcast_to(_AMBIENT_DN + _AMBIENT_SLOPE_DN * rows, (self.height, self.width)))

    def _light(self, centres: FloatArray) -> FloatArray:
        """Light of the stripes alone, (height, width)."""
        light = np.zeros((self.height, self.width))
        offsets = np.arange(-_HALO_PX, _HALO_PX + 1)[:, None]
        columns = np.arange(self.width)
        for centre, amplitude in zip(centres, _AMPLITUDES_DN, strict=False):
            near = np.rint(centre).astype(np.int64) + offsets
            profile = amplitude * np.exp(-0.5 * ((near - centre) / _WIDTH_PX) ** 2)
            inside = (near >= 0) & (near < self.height)
            np.add.at(light, (np.clip(near, 0, self.height - 1), columns), np.where(inside, profile, 0.0))
        return light


def relief_of(columns: int, phase: float) -> FloatArray:
    """Heights across a scene, (columns,), from 0 to 1: waves, a slope, and blocks with steps."""
    u = np.arange(columns) / columns
    relief = 0.3 + 0.25 * np.sin(2 * np.pi * (1.4 * u + phase)) + 0.1 * u
    return np.asarray(relief + 0.3 * ((u + 0.3 * phase) % 0.5 > 0.35))


def _digitised(light: FloatArray) -> ByteArray:
    return np.asarray(np.clip(np.rint(light), 0, 255), dtype=np.uint8)
