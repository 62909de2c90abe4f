"""How uncertain a grey value is."""

from dataclasses import dataclass

import numpy as np

from twinline.arrays import FloatArray
from twinline.errors import RigError


@dataclass(frozen=True)
class NoiseModel:
    """Variance of a pixel as a function of the light that falls on it.

    ``variance = read_dn**2 + signal / electrons_per_dn + (speckle * signal)**2`` with ``signal`` in grey levels
    (DN) above the dark level: read and quantisation noise, shot noise, and laser speckle, which is multiplicative.

    Attributes
    ----------
    read_dn
        Standard deviation without light, quantisation included, in DN. The letter n of the literature.
    electrons_per_dn
        K; ``inf`` leaves the shot noise out.
    speckle
        C, the speckle contrast seen by one pixel (0 to 1).
    """

    read_dn: float = 1.5
    electrons_per_dn: float = float("inf")
    speckle: float = 0.0

    def __post_init__(self) -> None:
        if not (0 <= self.read_dn < float("inf") and self.electrons_per_dn > 0 and 0 <= self.speckle <= 1):
            raise RigError("A noise model needs read_dn >= 0, electrons_per_dn > 0 and a speckle contrast from 0 to 1.")

    def variance_dn2(self, signal_dn: FloatArray) -> FloatArray:
        """Variance in DN^2 of pixels with the given mean signal, any shape."""
        signal = np.maximum(signal_dn, 0.0)
        return self.read_dn**2 + signal / self.electrons_per_dn + (self.speckle * signal) ** 2
