"""Where a stripe breaks, and what is too short to be one."""

import numpy as np
import pytest

from twinline.stripe import Flag
from twinline.stripe.continuity import SHORTEST_FRAGMENT, broken_columns, fragments

NAN = np.nan
NO_FLAGS = 0


def sd(centre: list[float], value: float = 0.05) -> np.ndarray:
    return np.full(len(centre), value)


@pytest.mark.parametrize(
    ("centre", "broken"),
    [
        ([5.0, 5.5, 6.0, 6.4], []),
        ([5.0, 5.5, 9.0, 9.4], [1, 2]),
        ([5.0, 5.5, NAN, 6.0, 6.0], [1, 3]),
        ([NAN, NAN], []),
        ([7.0], []),
    ],
)
def test_both_sides_of_a_jump_and_of_a_gap_are_broken(centre: list[float], broken: list[int]) -> None:
    found = broken_columns(np.array(centre), sd(centre))
    assert np.flatnonzero(found).tolist() == broken


def test_a_jump_that_noise_explains_is_none() -> None:
    centre = np.array([5.0, 8.0])
    assert broken_columns(centre, np.full(2, 0.05)).all()
    assert not broken_columns(centre, np.full(2, 0.5)).any()


def pieces(lengths: list[int]) -> np.ndarray:
    """Pieces of stripe with gaps between them."""
    return np.concatenate([np.append(np.full(n, 10.0), NAN) for n in lengths])


@pytest.mark.parametrize("flag", [Flag.WEAK, Flag.NARROW, Flag.WIDE])
def test_a_short_doubtful_piece_is_dropped_and_a_long_one_is_kept(flag: Flag) -> None:
    centre = pieces([SHORTEST_FRAGMENT - 1, SHORTEST_FRAGMENT])
    flags = np.full(centre.size, int(flag), np.uint16)
    dropped = fragments(centre, np.full(centre.size, 0.05), flags)
    assert np.flatnonzero(dropped).tolist() == list(range(SHORTEST_FRAGMENT - 1))


def test_a_short_piece_without_doubt_is_kept() -> None:
    centre = pieces([1, 2, 3])
    flags = np.full(centre.size, int(Flag.SATURATED), np.uint16)
    assert not fragments(centre, np.full(centre.size, 0.05), flags).any()


def test_a_jump_ends_a_piece() -> None:
    centre = np.array([10.0, 10.0, 30.0, 30.0, 30.0, 30.0, 30.0])
    flags = np.full(7, int(Flag.WEAK), np.uint16)
    assert fragments(centre, np.full(7, 0.05), flags).tolist() == [True, True, *[False] * 5]


def test_doubt_about_one_column_of_a_short_piece_is_doubt_about_all() -> None:
    centre = pieces([3])
    flags = np.array([0, int(Flag.WEAK), 0, 0], np.uint16)
    assert fragments(centre, np.full(4, 0.05), flags).tolist() == [True, True, True, False]
