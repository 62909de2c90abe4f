"""The legend beside the 3-D view has the colours that the points have; no browser is needed to see that."""

import re
from pathlib import Path

import numpy as np
import pytest

from twinline.arrays import ByteArray
from twinline.fusion.cloud import PointCloud, Source
from twinline.operations.display import ColourMode
from twinline.view.colours import colours

TOKENS = Path(__file__).parents[2] / "web" / "src" / "styles" / "tokens.css"
SOURCES = {
    Source.LASER_1: "--src-laser1",
    Source.LASER_2: "--src-laser2",
    Source.BOTH_LASERS: "--src-both",
    Source.TOF: "--src-tof",
    Source.FILLED: "--src-filled",
}
RAMP = tuple(f"--ramp-{index}" for index in range(6))


def token(name: str) -> tuple[int, ...]:
    """Red, green, blue of a token on the stage, which is dark in both themes."""
    value = re.search(rf"{name}:\s*(?:light-dark\([^,]+,\s*)?#([0-9a-f]{{6}})", TOKENS.read_text(encoding="utf-8"))
    assert value is not None, f"{TOKENS.name} has no {name}"
    return tuple(bytes.fromhex(value[1]))


def painted(heights_mm: list[float], sources: list[int], mode: ColourMode) -> ByteArray:
    """Colours of points at some heights, on a scale from 0 to 5 mm."""
    n = len(heights_mm)
    points_mm = np.zeros((n, 3), np.float32)
    points_mm[:, 2] = heights_mm
    flat = np.ones(n, np.float32)
    cloud = PointCloud(points_mm, flat, flat, np.zeros((n, 3), np.uint8), np.array(sources, np.uint8))
    return colours(cloud, mode, (0.0, 5.0))


@pytest.mark.parametrize("source", SOURCES)
def test_a_source_has_one_colour_everywhere(source: Source) -> None:
    assert tuple(painted([1.0], [source], ColourMode.SOURCE)[0]) == token(SOURCES[source])


def test_a_height_has_the_colour_that_the_ramp_has_there() -> None:
    seen = painted([0.0, 1.0, 2.0, 3.0, 4.0, 5.0], [1] * 6, ColourMode.HEIGHT)
    # A table of 256 steps meets the ramp's anchors to the nearest step.
    np.testing.assert_allclose(seen.astype(int), [token(name) for name in RAMP], atol=3)
