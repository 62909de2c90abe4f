"""Reading every byte of a picture once: what any method that looks at the whole picture has to do at the least.

The result depends on every byte, so that the compiler can leave none out. How long that takes depends on what is done
with the bytes, from the highest of them (one instruction for a whole register of bytes) to their sum (which has to
widen them first).
"""

import numpy as np
from numba import njit

from twinline.arrays import ByteArray

PLAIN_SUM = "plain sum of the bytes"
NARROW_SUM = "sum in 32 bits"
HIGHEST = "highest byte"


@njit(cache=True)
def plain_sum(pixels: ByteArray) -> int:
    """Sum of (n,) bytes, as one would write it down: counted in 64 bits."""
    total = np.uint64(0)
    for i in range(pixels.size):
        total += np.uint64(pixels[i])
    return int(total)


@njit(cache=True)
def narrow_sum(pixels: ByteArray) -> int:
    """Sum of (n,) bytes, at most 16 million, counted in the 32 bits that are enough for it."""
    total = np.uint32(0)
    for i in range(pixels.size):
        total = np.uint32(total + np.uint32(pixels[i]))
    return int(total)


@njit(cache=True)
def highest(pixels: ByteArray) -> int:
    """Highest of (n,) bytes: the cheapest that can be done with all of them."""
    top = np.uint8(0)
    for i in range(pixels.size):
        top = max(top, pixels[i])
    return int(top)


PASSES = {PLAIN_SUM: plain_sum, NARROW_SUM: narrow_sum, HIGHEST: highest}
