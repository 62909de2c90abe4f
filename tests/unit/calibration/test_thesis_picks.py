import numpy as np
import pytest

from tests.unit.calibration.thesis_scenes import (
    HEIGHT_MM,
    PRISM_MM,
    Height,
    Machine,
    points_at,
    prism,
    raster,
    rig,
    rotation,
    scene,
    stripes,
)
from twinline.arrays import FloatArray
from twinline.calibration.observations import StripePoints, TofReadings
from twinline.calibration.thesis_picks import PickedPoints, pick_points
from twinline.calibration.thesis_surface import tof_cloud
from twinline.errors import CalibrationError

MARGIN_MM = 4.0


def places(machine: Machine, laser: int, part: StripePoints, picks: PickedPoints) -> FloatArray:
    """Where the picked stripes truly lie on the bed."""
    key = {tuple(pixel): cart for pixel, cart in zip(part.pixels.tolist(), part.cart_mm, strict=True)}
    cart = np.array([key[tuple(pixel)] for pixel in picks.pixels.tolist()])
    x = (picks.pixels - (648.47410, 363.64953)) / (1028.84412, 1028.59061)
    return points_at(machine, laser, x[:, 1], x[:, 0]) + cart[:, None] * machine.travel


@pytest.mark.parametrize("laser", [0, 1])
@pytest.mark.parametrize("turn", [0.0, 1.0])
def test_picked_points_lie_on_the_bed_and_on_the_prism_away_from_its_edges(laser: int, turn: float) -> None:
    """The nominal rig's depths are wrong by 85 mm here, and its places by more than the margin."""
    machine = Machine(sheet_turns=(rotation(2, turn), rotation(2, -turn)))
    part = stripes(machine, laser, noise_px=0.1)
    picks = pick_points(rig(), laser, part, tof_cloud(rig(), raster(machine, noise_mm=0.01)), margin_mm=MARGIN_MM)
    there = places(machine, laser, part, picks)
    top = picks.depth_mm < HEIGHT_MM - 10.0
    assert top.sum() == 20
    assert (~top).sum() == 20
    np.testing.assert_allclose(picks.depth_mm, HEIGHT_MM - scene(there[:, 0], there[:, 1]), atol=0.05)
    to_edge = np.minimum(PRISM_MM[0] / 2 - np.abs(there[top, 0] + 22.0), PRISM_MM[1] / 2 - np.abs(there[top, 1]))
    assert to_edge.min() > MARGIN_MM - 2.0


def test_one_point_per_level_is_the_choice_of_the_thesis() -> None:
    machine = Machine()
    picks = pick_points(
        rig(), 0, stripes(machine, 0, height=prism), tof_cloud(rig(), raster(machine, height=prism)), per_level=1
    )
    np.testing.assert_allclose(np.sort(picks.depth_mm), [HEIGHT_MM - PRISM_MM[2], HEIGHT_MM], atol=1e-6)


def test_stripes_and_readings_without_a_number_are_passed_over() -> None:
    machine = Machine()
    part, readings = stripes(machine, 1), raster(machine)
    pixels, reading = part.pixels.copy(), readings.reading.copy()
    pixels[::17], reading[::11] = np.nan, np.nan
    torn = StripePoints(pixels, part.sd_px, part.cart_mm)
    holes = TofReadings(readings.time_s, readings.cart_mm, readings.slide_mm, reading)
    picks = pick_points(rig(), 1, torn, tof_cloud(rig(), holes))
    assert np.isfinite(picks.pixels).all()
    assert np.isfinite(picks.depth_mm).all()
    assert len(picks) == 40


def test_a_raster_without_a_single_reading_is_refused() -> None:
    machine = Machine()
    with pytest.raises(CalibrationError, match="The ToF raster holds no measurement") as caught:
        pick_points(rig(), 0, stripes(machine, 0), np.full((100, 3), np.nan))
    assert caught.value.code == "no-points"


def test_a_laser_without_stripes_is_refused_by_its_number() -> None:
    none = StripePoints(np.empty((0, 2)), np.empty(0), np.empty(0))
    with pytest.raises(CalibrationError, match="Laser 2 has no stripe"):
        pick_points(rig(), 1, none, np.zeros((5, 3)))


def test_passes_over_different_places_are_refused_with_both_extents() -> None:
    machine = Machine()
    away = tof_cloud(rig(), raster(machine)) + np.array([500.0, 0.0, 0.0])
    with pytest.raises(CalibrationError, match=r"x 455 to 544.*no place in common") as caught:
        pick_points(rig(), 0, stripes(machine, 0), away)
    assert caught.value.code == "no-overlap"


def waves(x: FloatArray, y: FloatArray) -> FloatArray:
    return np.asarray(2.0 + 0.8 * np.sin(x) + 0.0 * y)


def level(x: FloatArray, y: FloatArray) -> FloatArray:
    return 2.0 + 0.0 * x


@pytest.mark.parametrize("heights", [(waves, level), (level, waves)], ids=["by laser", "by ToF"])
def test_what_either_sensor_finds_uneven_is_no_flat_place(heights: tuple[Height, Height]) -> None:
    machine, (by_laser, by_tof) = Machine(), heights
    part, points = stripes(machine, 0, height=by_laser), tof_cloud(rig(), raster(machine, height=by_tof))
    with pytest.raises(CalibrationError, match="scan a flat-topped object") as caught:
        pick_points(rig(), 0, part, points)
    assert caught.value.code == "too-few-points"


def test_a_large_bare_bed_does_not_take_the_places_of_the_objects() -> None:
    machine = Machine()
    far = np.arange(-900.0, 900.0, 0.83)
    part = stripes(machine, 0, height=prism, cart_mm=far)
    picks = pick_points(rig(), 0, part, tof_cloud(rig(), raster(machine, height=prism)))
    assert (picks.depth_mm < HEIGHT_MM - 10.0).sum() == 20


def test_frames_far_apart_need_wider_cells() -> None:
    machine = Machine()
    part = stripes(machine, 0, height=prism, cart_mm=np.arange(-112.0, 112.0, 2.0))
    readings = tof_cloud(rig(), raster(machine, height=prism))
    with pytest.raises(CalibrationError, match="share 0 flat places"):
        pick_points(rig(), 0, part, readings)
    assert len(pick_points(rig(), 0, part, readings, cell_mm=2.6)) == 40
