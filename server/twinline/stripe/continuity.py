"""What the neighbours along a stripe say about a column: where the stripe breaks, and what is too short to be one."""

import numpy as np
from numba import njit

from twinline.arrays import BoolArray, FloatArray, IntArray
from twinline.stripe.model import Flag

JUMP_PX = 2.0
"""A stripe that moves further than this, and than noise explains, from one column to the next has left its surface."""

SHORTEST_FRAGMENT = 4
"""Weak or narrow peaks must go on over so many columns to count: noise and glare do not."""

_DOUBTFUL = int(Flag.WEAK | Flag.NARROW | Flag.WIDE)


@njit(cache=True, error_model="numpy", inline="always")
def _goes_on(step_px: float, variance: float) -> bool:
    """Whether a step from column to column is one that noise of such a variance explains; NaN is none."""
    beyond = abs(step_px) - JUMP_PX
    return beyond <= 0.0 or beyond * beyond <= 16.0 * variance


@njit(cache=True, error_model="numpy")
def broken_columns(centre: FloatArray, sd: FloatArray) -> BoolArray:
    """Columns beside which the stripe jumps or ends, (columns,) bool; only columns with a stripe count.

    A laser spot that straddles a step lights both surfaces, and its centre lies on neither.
    """
    n = centre.size
    broken = np.zeros(n, np.bool_)
    for i in range(n - 1):
        if not _goes_on(centre[i + 1] - centre[i], sd[i] * sd[i] + sd[i + 1] * sd[i + 1]):
            broken[i] = centre[i] == centre[i]
            broken[i + 1] = centre[i + 1] == centre[i + 1]
    return broken


@njit(cache=True, error_model="numpy")
def fragments(centre: FloatArray, sd: FloatArray, flags: IntArray) -> BoolArray:
    """Columns that belong to a piece of stripe too short and too doubtful to be one, (columns,) bool."""
    n = centre.size
    drop = np.zeros(n, np.bool_)
    start = 0
    while start < n:
        if centre[start] != centre[start]:
            start += 1
            continue
        end = start + 1
        doubtful = (flags[start] & _DOUBTFUL) != 0
        while end < n and _goes_on(centre[end] - centre[end - 1], sd[end] * sd[end] + sd[end - 1] * sd[end - 1]):
            doubtful = doubtful or (flags[end] & _DOUBTFUL) != 0
            end += 1
        if doubtful and end - start < SHORTEST_FRAGMENT:
            drop[start:end] = True
        start = end
    return drop
