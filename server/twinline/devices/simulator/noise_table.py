"""Normal random numbers cheap enough for every pixel of every frame: a 64-bit generator and a table of quantiles."""

from statistics import NormalDist

import numpy as np

from twinline.arrays import FloatArray, IntArray
from twinline.devices.simulator.compiled import loop

TABLE_BITS = 12


def normal_table() -> FloatArray:
    """Means of the normal distribution over ``2**TABLE_BITS`` equally likely intervals, with unit variance.

    Returns
    -------
    (4096,) array of float32
    """
    size = 1 << TABLE_BITS
    normal = NormalDist()
    inner = np.array([normal.pdf(normal.inv_cdf(i / size)) for i in range(1, size)])
    density = np.concatenate([[0.0], inner, [0.0]])
    means = (density[:-1] - density[1:]) * size
    return np.asarray(means / means.std(), dtype=np.float32)


@loop
def next_random(state: np.uint64) -> np.uint64:  # pragma: no cover - compiled
    """Next state of a xorshift generator, which is also its next 64 random bits; a state of 0 stays 0.

    G. Marsaglia, "Xorshift RNGs", J. Statistical Software 8 (2003).
    """
    a = state ^ (state << np.uint64(13))
    b = a ^ (a >> np.uint64(7))
    return b ^ (b << np.uint64(17))


@loop
def to_normal(table: FloatArray, bits: np.uint64) -> float:  # pragma: no cover - compiled
    """Standard normal number for the last ``TABLE_BITS`` of some random bits."""
    value: float = table[bits & np.uint64((1 << TABLE_BITS) - 1)]
    return value


def normal_pool(size: int, seed: int) -> FloatArray:
    """Normal random numbers to be read again from ever other places, (size,) float32 with mean 0 and variance 1."""
    pool = np.random.default_rng([seed, 2]).standard_normal(size)
    return np.asarray((pool - pool.mean()) / pool.std(), dtype=np.float32)


def frame_seeds(seed: int, frame: int, count: int) -> IntArray:
    """Independent starting states for the parts of one frame; the same for the same seed and frame, never 0.

    Returns
    -------
    (count,) array of uint64
    """
    return np.random.default_rng([seed, frame]).integers(1, 2**63, size=count, dtype=np.uint64)
