"""The passes that everything is measured against must read every byte."""

from collections.abc import Callable

import numpy as np
import pytest

from twinline.arrays import ByteArray
from twinline.bench.passes import HIGHEST, NARROW_SUM, PASSES, PLAIN_SUM


def test_the_passes_give_what_they_say(rng: np.random.Generator) -> None:
    pixels = rng.integers(0, 256, 3 * 1280 * 72, dtype=np.uint8)
    assert PASSES[PLAIN_SUM](pixels) == int(pixels.sum())
    assert PASSES[NARROW_SUM](pixels) == int(pixels.sum())
    assert PASSES[HIGHEST](pixels) == int(pixels.max())


@pytest.mark.parametrize("name", PASSES)
def test_no_byte_is_left_out(name: str) -> None:
    read: Callable[[ByteArray], int] = PASSES[name]
    pixels = np.zeros(1000, np.uint8)
    for place in range(pixels.size):
        pixels[place] = 7
        assert read(pixels) == 7
        pixels[place] = 0


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240604)
