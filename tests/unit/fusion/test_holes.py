"""Causes of holes against what a ruler gives: h cot(theta) behind a step for light, h tan(alpha) for the view."""

import numpy as np
import pytest

from tests.unit.fusion.scenes import cloud_of
from twinline.arrays import FloatArray
from twinline.fusion.cloud import PointCloud, Source
from twinline.fusion.holes import Cause, holes
from twinline.geometry.camera import Camera
from twinline.geometry.nominal import nominal_rig
from twinline.geometry.rig import Rig

HEIGHT_MM, BASELINE_MM, ANGLE_RAD, TALL_MM = 430.0, 246.0, float(np.radians(60.0)), 20.0
CART_MM = np.arange(-100.0, 100.5, 0.5)


@pytest.fixture(scope="module")
def rig() -> Rig:
    camera = Camera(np.array([[1030.0, 0.0, 640.0], [0.0, 1030.0, 360.0], [0.0, 0.0, 1.0]]), (1280, 720))
    return nominal_rig(
        "plain", camera, "along-u", [(BASELINE_MM, ANGLE_RAD, "+v"), (BASELINE_MM, ANGLE_RAD, "-v")], 430.0
    )


def block(x: FloatArray, y: FloatArray) -> FloatArray:
    return np.where((np.abs(x) < 15.0) & (np.abs(y) < 15.0), TALL_MM, 0.0)


def bed_with_block() -> PointCloud:
    x, y = (g.ravel() for g in np.meshgrid(np.arange(-50.0, 50.0, 0.5), np.arange(-30.0, 30.0, 0.5)))
    return cloud_of(np.column_stack([x, y, block(x, y)]), Source.BOTH_LASERS)


def dropped(gone: object) -> PointCloud:
    cloud = bed_with_block()
    return cloud.select(np.logical_not(np.asarray(gone, bool)))


def causes(rig: Rig, low: tuple[float, float], high: tuple[float, float], **options: float) -> list[FloatArray]:
    """Causes of each laser within a rectangle without points."""
    points = bed_with_block().points_mm
    gone = ((points[:, :2] > low) & (points[:, :2] < high)).all(axis=1)
    cloud = dropped(gone)
    if "intensity" in options:
        cloud = cloud_of(cloud.points_mm, 3, intensity=options["intensity"])
    found = holes(cloud, rig, CART_MM, cell_mm=1.0)
    places = found.surface.places()
    inside = ((places > np.array(low) + 0.6) & (places < np.array(high) - 0.6)).all(axis=-1)
    assert inside.sum() > 20
    return [np.asarray(c[inside]) for c in (*found.by_laser, found.cause)]


def test_behind_the_block_lies_one_laser_s_shadow_as_long_as_a_ruler_says(rig: Rig) -> None:
    # Laser 1 stands on the side of +x; its sheet comes down with 60 degrees, so the shadow lies at -x.
    length = TALL_MM / np.tan(ANGLE_RAD)
    first, second, _ = causes(rig, (-15.0 - length + 0.5, -10.0), (-15.0, 10.0))
    assert (first == Cause.LASER_1_SHADOW).mean() > 0.95
    assert not (second == Cause.LASER_2_SHADOW).any()
    first, second, _ = causes(rig, (-40.0, -10.0), (-15.0 - length - 1.0, 10.0))
    assert not (first == Cause.LASER_1_SHADOW).any()
    _, second, _ = causes(rig, (15.0, -10.0), (15.0 + length - 0.5, 10.0))
    assert (second == Cause.LASER_2_SHADOW).mean() > 0.95


def test_on_the_laser_s_own_side_the_block_hides_the_bed_from_the_camera() -> None:
    steep = float(np.radians(70.0))
    camera = Camera(np.array([[1030.0, 0.0, 640.0], [0.0, 1030.0, 360.0], [0.0, 0.0, 1.0]]), (1280, 720))
    rig = nominal_rig("plain", camera, "along-u", [(BASELINE_MM, steep, "+v")], HEIGHT_MM)
    # The camera sees the stripe on the bed this far ahead of itself, and looks back under the block's edge.
    ahead = BASELINE_MM - HEIGHT_MM / np.tan(steep)
    length = TALL_MM * ahead / HEIGHT_MM
    assert 4.0 < length < 4.5
    carts = np.arange(-150.0, 100.0, 0.5)
    points = bed_with_block().points_mm
    for low, high, hidden in ((15.0, 15.0 + length, True), (15.0 + length + 1.0, 30.0, False)):
        gone = (points[:, 0] >= low) & (points[:, 0] < high) & (np.abs(points[:, 1]) < 12.0)
        found = holes(dropped(gone), rig, carts, cell_mm=1.0)
        places = found.surface.places()
        inside = (places[..., 0] > low + 0.6) & (places[..., 0] < high - 0.6) & (np.abs(places[..., 1]) < 11.0)
        assert (found.cause[inside] == Cause.CAMERA_SHADOW).mean() == pytest.approx(float(hidden), abs=0.1)
        if hidden:
            assert "hidden from the camera: move tall objects" in str(found.hint())


def test_what_is_lit_and_seen_was_too_bright_or_too_dark(rig: Rig) -> None:
    dark, _, whole = causes(rig, (-45.0, 15.5), (-35.0, 25.0), intensity=60.0)
    assert (dark == Cause.TOO_DARK).all()
    assert (whole == Cause.TOO_DARK).all()
    bright, _, _ = causes(rig, (-45.0, 15.5), (-40.5, 25.0), intensity=255.0)
    assert (bright == Cause.SATURATED).all()


def test_where_the_cart_did_not_go_nothing_was_swept(rig: Rig) -> None:
    cloud = dropped(bed_with_block().points_mm[:, 0] > 40.0)
    points = np.concatenate([cloud.points_mm, [[49.0, 0.0, 0.0]]])
    found = holes(cloud_of(points, 3), rig, np.arange(-60.0, 35.0, 0.5), cell_mm=1.0)
    places = found.surface.places()
    assert (found.cause[(places[..., 0] > 41.0) & (places[..., 0] < 48.0)] == Cause.NOT_SWEPT).all()
    assert found.hint() is not None
    assert next(iter(found.areas_mm2())) == Cause.NOT_SWEPT


def test_what_rises_out_of_the_picture_is_out_of_range(rig: Rig) -> None:
    x, y = (g.ravel() for g in np.meshgrid(np.arange(-20.0, 20.0, 0.5), np.arange(-30.0, 30.0, 0.5)))
    # At 250 mm above the bed the sheets are 19.3 degrees and more off the axis: beyond the picture.
    gone = np.abs(y) < 5.0
    found = holes(cloud_of(np.column_stack([x, y, np.full(len(x), 250.0)])[~gone], 3), rig, CART_MM, cell_mm=1.0)
    assert (found.cause[found.cause != Cause.MEASURED] == Cause.OUT_OF_RANGE).all()
    assert (found.cause != Cause.MEASURED).sum() > 100


def test_a_whole_surface_has_no_holes(rig: Rig) -> None:
    found = holes(bed_with_block(), rig, CART_MM, cell_mm=1.0)
    assert found.share == 0.0
    assert found.hint() is None
    assert found.areas_mm2() == {}
