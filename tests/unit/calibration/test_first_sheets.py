"""First sheets in closed form, from whatever shows where the stripes lie."""

import numpy as np
import pytest

from tests.unit.calibration.scanner_samples import crooked_rig
from twinline.arrays import FloatArray
from twinline.calibration.first_sheets import first_sheets
from twinline.calibration.joint_model import Scanner
from twinline.calibration.joint_types import KnownPoints
from twinline.calibration.observations import StripePoints
from twinline.calibration.scanner import scanner_of_rig


@pytest.fixture
def scanner() -> Scanner:
    return scanner_of_rig(crooked_rig())


def stripe(scanner: Scanner, laser: int, height_mm: float) -> StripePoints:
    """Stripe on a plane at a height above the bed, where it crosses the picture."""
    axes, up = scanner.axes(), np.array([0.0, 0.0, scanner.height_mm()])
    across = np.linspace(-60.0, 60.0, 40)
    along = np.array([_along(scanner, laser, float(y), height_mm) for y in across])
    places = (np.column_stack([along, across, np.full_like(across, height_mm)]) - up) @ axes
    pixels = scanner.as_camera().project(places)
    return StripePoints(pixels, np.full(len(pixels), 0.05), np.zeros(len(pixels)))


def _along(scanner: Scanner, laser: int, y: float, z: float) -> float:
    """Where the sheet meets the line of places at y, z; it is linear along it."""

    def off(x: float) -> float:
        place = np.array([x, y, z - scanner.height_mm()]) @ scanner.axes()
        return float(scanner.sheets[laser] @ place - 1.0)

    return -off(0.0) / (off(1.0) - off(0.0))


def blocks(scanner: Scanner, laser: int, heights: tuple[float, ...]) -> KnownPoints:
    parts = [stripe(scanner, laser, height) for height in heights]
    count = len(parts[0])
    return KnownPoints(
        laser,
        StripePoints.join(parts),
        np.full((count * len(heights), 3), np.nan),
        np.repeat(np.array(heights), count),
        np.repeat(np.arange(len(heights)), count),
    )


def wrong(scanner: Scanner) -> FloatArray:
    return scanner.sheets * 1.05


def test_blocks_at_two_heights_give_the_sheet(scanner: Scanner) -> None:
    notes: list[str] = []
    known = [blocks(scanner, k, (0.0, 20.0)) for k in range(2)]
    sheets = first_sheets(scanner.with_vector(_with(scanner)), [246.0, 246.0], [], known, notes)
    np.testing.assert_allclose(sheets, scanner.sheets, rtol=1e-6, atol=1e-9)
    assert not notes


def test_the_bed_is_a_surface_of_known_place_too(scanner: Scanner) -> None:
    notes: list[str] = []
    bed = [stripe(scanner, k, 0.0) for k in range(2)]
    known = [blocks(scanner, k, (20.0,)) for k in range(2)]
    sheets = first_sheets(scanner.with_vector(_with(scanner)), [246.0, 246.0], bed, known, notes)
    np.testing.assert_allclose(sheets, scanner.sheets, rtol=1e-6, atol=1e-9)
    assert not notes


def test_one_height_alone_leaves_the_sheet_to_the_bed_and_says_so(scanner: Scanner) -> None:
    notes: list[str] = []
    known = [blocks(scanner, k, (0.0,)) for k in range(2)]
    bed = [stripe(scanner, k, 0.0) for k in range(2)]
    sheets = first_sheets(scanner, [246.0, 246.0], bed, known, notes)
    assert len(notes) == 2
    assert "do not fix the sheet of laser 1 alone" in notes[0]
    for k in range(2):
        rays = scanner.as_camera().rays(bed[k].pixels)
        np.testing.assert_allclose(rays @ sheets[k], rays @ scanner.bed, rtol=1e-9)


def test_a_laser_that_nobody_saw_keeps_its_sheet_and_is_named(scanner: Scanner) -> None:
    notes: list[str] = []
    sheets = first_sheets(scanner, [246.0, 246.0], [], [], notes)
    np.testing.assert_array_equal(sheets, scanner.sheets)
    assert [note[:27] for note in notes] == ["The stripe of laser 1 is no", "The stripe of laser 2 is no"]


def _with(scanner: Scanner) -> FloatArray:
    """Parameters with sheets out of place: what is found must not depend on them."""
    theta = scanner.vector()
    theta[15:21] = wrong(scanner).ravel()
    return theta
