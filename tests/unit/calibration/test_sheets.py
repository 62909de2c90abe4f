import numpy as np
import pytest

from tests.unit.calibration.scanner_samples import crooked_rig
from twinline.arrays import FloatArray
from twinline.calibration.sheets import sheet_from_bed_line, sheet_from_points
from twinline.errors import CalibrationError
from twinline.geometry.sheet import LaserSheet

SHEET = crooked_rig().sheets[0]


def rays_on(sheet: LaserSheet, planes: list[FloatArray], count: int = 50) -> tuple[FloatArray, FloatArray]:
    """Rays to where a sheet meets planes ``q . p = 1``, and 1/Z there."""
    rays, inverse = [], []
    for plane in planes:
        x = np.linspace(-0.5, 0.5, count)
        # (m - q) . (x, y, 1) = 0
        line = sheet.inverse_depth - plane
        y = -(line[0] * x + line[2]) / line[1]
        here = np.column_stack([x, y, np.ones(count)])
        rays.append(here)
        inverse.append(here @ plane)
    return np.concatenate(rays), np.concatenate(inverse)


def plane(distance_mm: float, tilt: float = 0.0) -> FloatArray:
    normal = np.array([np.sin(tilt), 0.01, np.cos(tilt)])
    return np.asarray(normal / np.linalg.norm(normal) / distance_mm)


def test_points_at_two_heights_give_the_sheet() -> None:
    rays, inverse = rays_on(SHEET, [plane(420.0), plane(390.0, 0.1)])
    found = sheet_from_points(rays, inverse, "+v")
    np.testing.assert_allclose(found.inverse_depth, SHEET.inverse_depth, rtol=1e-9, atol=1e-12)
    assert found.side == "+v"


def test_a_tenth_of_false_points_hardly_moves_it() -> None:
    rng = np.random.default_rng(21)
    rays, inverse = rays_on(SHEET, [plane(420.0), plane(380.0), plane(400.0, 0.2)], 200)
    inverse += rng.normal(0, 2e-7, len(inverse))
    clean = sheet_from_points(rays, inverse, "+v").inverse_depth
    wrong = rng.random(len(inverse)) < 0.1
    inverse[wrong] *= rng.uniform(0.8, 1.2, int(wrong.sum()))
    dirty = sheet_from_points(rays, inverse, "+v").inverse_depth
    assert np.linalg.norm(dirty - SHEET.inverse_depth) < 3 * np.linalg.norm(clean - SHEET.inverse_depth) + 1e-7


def test_points_on_one_line_are_refused() -> None:
    rays, inverse = rays_on(SHEET, [plane(420.0)])
    with pytest.raises(CalibrationError, match="could turn about it") as caught:
        sheet_from_points(rays, inverse, "+v")
    assert caught.value.code == "sheet-unobservable"


def test_the_line_on_the_bed_and_the_lasers_place_give_the_sheet() -> None:
    bed = plane(421.5)
    rays, _ = rays_on(SHEET, [bed])
    # Where the sheet really passes beside the camera, parallel to the bed.
    normal = bed / np.linalg.norm(bed)
    towards = np.array([0.0, 1.0, 0.0]) - normal * normal[1]
    towards /= np.linalg.norm(towards)
    baseline = 1.0 / float(SHEET.inverse_depth @ towards)
    found = sheet_from_bed_line(rays, bed, baseline, "+v")
    np.testing.assert_allclose(found.inverse_depth, SHEET.inverse_depth, rtol=1e-7, atol=1e-10)
    off = sheet_from_bed_line(rays, bed, baseline + 5.0, "+v")
    np.testing.assert_allclose(rays @ off.inverse_depth, rays @ bed, atol=1e-9)
    assert np.degrees(np.arccos(off.normal @ SHEET.normal)) < 1.0
