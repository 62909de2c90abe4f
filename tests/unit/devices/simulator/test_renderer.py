"""Where light must and must not be, computed here by explicit algebra."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from twinline.arrays import FloatArray
from twinline.devices.simulator.machine import SimulatedLaser, SimulatedRig, ideal_rig
from twinline.devices.simulator.renderer import Renderer, RoomLight
from twinline.devices.simulator.scenes import Scene, box, named_scene
from twinline.devices.simulator.sensor import Sensor
from twinline.devices.simulator.world import Ceiling, Material, build_world
from twinline.errors import SettingsError

PLAIN = Material((0.8, 0.8, 0.8), 0.0)
BOTH = frozenset({1, 2})
DARK = RoomLight((0.0, 0.0, 0.0))


def renderer_of(scene: Scene, rig: SimulatedRig, *, seed: int = 3, room: RoomLight | None = DARK) -> Renderer:
    return Renderer(build_world(scene.things, scene.bed, seed=seed), rig, room, seed=seed)


def bare(material: Material = PLAIN) -> Scene:
    return Scene("bed", (), material)


def light_picture(renderer: Renderer, cart_mm: float = 0.0, lasers: frozenset[int] = BOTH) -> FloatArray:
    """Noise-free laser light, (height, width)."""
    width, height = renderer.rig.image_size
    picture = np.zeros((height, width))
    band, first = renderer.laser_dn(cart_mm, lasers)
    picture[first : first + len(band)] = band
    return picture


def centroid_v(picture: FloatArray, column: int, near: float) -> float:
    rows = np.arange(round(near) - 9, round(near) + 10)
    light = picture[rows, column]
    assert light.sum() > 50
    return float((rows * light).sum() / light.sum())


def test_the_stripe_on_the_bed_of_an_ideal_machine_lies_where_the_thesis_says() -> None:
    rig = ideal_rig().cropped((320, 480))
    picture = light_picture(renderer_of(bare(), rig))
    for number, laser in enumerate(rig.lasers):
        reach = laser.known_baseline_mm - 430.0 / np.tan(np.radians(laser.known_angle_deg))
        v = rig.lens.centre_px[1] + (1 - 2 * number) * 1030.0 * reach / 430.0
        for column in (5, 160, 300):
            assert centroid_v(picture, column, v) == pytest.approx(v, abs=0.02)


def test_the_stripe_of_a_misaligned_machine_lies_where_opencv_and_two_planes_say() -> None:
    rig = SimulatedRig()
    cart_mm = 37.0
    picture = light_picture(renderer_of(bare(), rig), cart_mm)
    lens = rig.lens
    matrix = np.array([[lens.focal_px[0], 0, lens.centre_px[0]], [0, lens.focal_px[1], lens.centre_px[1]], [0, 0, 1.0]])
    distortion = np.array([*lens.radial[:2], *lens.tangential, 0.0])
    for laser in rig.lasers:
        # Points of the line in which the sheet cuts the bed, seen by a pinhole with OpenCV's distortion.
        line = np.cross(laser.normal, (0.0, 0.0, 1.0))
        foot = np.linalg.solve(
            np.array([laser.normal, [0.0, 0.0, 1.0], line]),
            np.array([laser.normal @ laser.source_mm, -rig.camera_height_mm, 0.0]),
        )
        points = foot + np.linspace(-300, 300, 121)[:, np.newaxis] * line / np.linalg.norm(line)
        seen, _ = cv2.projectPoints(points @ rig.bed_from_camera, np.zeros(3), np.zeros(3), matrix, distortion)
        u, v = seen.reshape(-1, 2).T
        order = np.argsort(u)
        for column in (60, 333, 640, 1000, 1220):
            expected = np.interp(column, u[order], v[order])
            assert centroid_v(picture, column, expected) == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("height_mm", [5.0, 20.0, 45.0])
def test_a_step_moves_both_stripes_by_the_parallax_of_its_height(height_mm: float) -> None:
    rig = ideal_rig().cropped((240, 600))
    block = box("block", (200.0, 60.0, height_mm), 0.0, 0.0, 0.0, PLAIN)
    picture = light_picture(renderer_of(Scene("step", (block,), PLAIN), rig))
    depth = 430.0 - height_mm
    for number, laser in enumerate(rig.lasers):
        tangent = laser.known_baseline_mm / depth - 1.0 / np.tan(np.radians(laser.known_angle_deg))
        v = rig.lens.centre_px[1] + (1 - 2 * number) * 1030.0 * tangent
        assert centroid_v(picture, 120, v) == pytest.approx(v, abs=0.02)


@pytest.mark.parametrize(("laser", "share", "lit"), [(1, 0.9, False), (1, 1.1, True), (2, 0.9, False), (2, 1.1, True)])
def test_the_shadow_of_the_prism_is_as_long_as_its_height_times_the_cotangent(
    laser: int, share: float, lit: bool
) -> None:
    rig = ideal_rig().cropped((240, 720))
    height_mm = 19.35
    prism = box("prism", (25.4, 60.0, height_mm), 0.0, 0.0, 0.0, PLAIN)
    known = rig.lasers[laser - 1]
    cot = 1.0 / np.tan(np.radians(known.known_angle_deg))
    # The shadow lies on the side away from the laser; put the middle of the sheet at a share of its length.
    x = -known.ahead * (12.7 + share * height_mm * cot)
    cart_mm = x - known.ahead * (known.known_baseline_mm - 430.0 * cot)
    row = round(rig.lens.centre_px[1] + 1030.0 * (x - cart_mm) / 430.0)
    only = frozenset({laser})
    alone = light_picture(renderer_of(bare(), rig), cart_mm, only)[row, 120]
    beside = light_picture(renderer_of(Scene("prism", (prism,), PLAIN), rig), cart_mm, only)[row, 120]
    assert alone > 50
    assert beside == pytest.approx(alone if lit else 0.0, abs=0.01 * alone)


def test_what_stands_between_camera_and_stripe_hides_it() -> None:
    rig = ideal_rig().cropped((240, 600))
    known = rig.lasers[0]
    x = known.known_baseline_mm - 430.0 / np.tan(np.radians(known.known_angle_deg))
    # A thin wall between the camera's foot and the stripe, tall enough to cover it and outside the light's way.
    wall = box("wall", (1.0, 60.0, 60.0), x - 4.0, 0.0, 0.0, PLAIN)
    picture = light_picture(renderer_of(Scene("wall", (wall,), PLAIN), rig), lasers=frozenset({1}))
    row = round(rig.lens.centre_px[1] + 1030.0 * x / 430.0)
    assert picture[row, 5] > 50
    assert picture[row, 120] == 0.0


@pytest.mark.parametrize("scene", ["three-objects", "steps", "relief"])
def test_leaving_out_pixels_that_look_through_air_changes_nothing(scene: str) -> None:
    rig = SimulatedRig().cropped((420, 620))
    placed = named_scene(scene)
    world = build_world(placed.things, placed.bed, seed=3)
    everywhere = Ceiling(np.full((400, 400), 90.0), (-400.0, -400.0), 2.0)
    cautious = Renderer(replace(world, ceiling=everywhere), rig, DARK)
    quick = Renderer(world, rig, DARK)
    for cart_mm in (-60.0, -48.0, 20.0, 33.0):
        expected = light_picture(cautious, cart_mm)
        assert expected.max() > 100
        np.testing.assert_array_equal(light_picture(quick, cart_mm), expected)


def test_stripes_along_v_run_down_the_picture() -> None:
    lasers = (SimulatedLaser("+u", 251.5, 65.5), SimulatedLaser("-u", 251.5, 62.5))
    rig = replace(
        ideal_rig(), stripe_runs="along-v", lasers=lasers, image_size=(640, 240),
        lens=replace(ideal_rig().lens, centre_px=(320.0, 120.0)),
    )  # fmt: skip
    picture = light_picture(renderer_of(bare(), rig))
    for number, laser in enumerate(lasers):
        reach = 251.5 - 430.0 / np.tan(np.radians(laser.known_angle_deg))
        u = 320.0 + (1 - 2 * number) * 1030.0 * reach / 430.0
        assert centroid_v(picture.T, 77, u) == pytest.approx(u, abs=0.02)


class TestNoise:
    def test_the_same_seed_gives_the_same_picture_in_any_order(self) -> None:
        rig = SimulatedRig().cropped((160, 480))
        scene = named_scene("sphere")
        first = renderer_of(scene, rig, room=None)
        a, b = first.render(4, 2.0), first.render(5, 2.0)
        second = renderer_of(scene, rig, room=None)
        np.testing.assert_array_equal(second.render(5, 2.0), b)
        np.testing.assert_array_equal(second.render(4, 2.0), a)
        assert (a != b).mean() > 0.3
        assert (renderer_of(scene, rig, seed=4, room=None).render(4, 2.0) != a).mean() > 0.3

    def test_grey_levels_scatter_as_read_and_shot_noise_say(self) -> None:
        sensor = Sensor(read_dn=2.0, electrons_per_dn=20.0)
        rig = replace(ideal_rig().cropped((400, 300)), sensor=sensor)
        picture = renderer_of(bare(), rig, room=RoomLight((60.0, 100.0, 140.0))).render(0, 0.0, frozenset())
        mean, sd = picture.mean(axis=(0, 1)), picture.std(axis=(0, 1))
        share = mean[0] / 60.0
        np.testing.assert_allclose(mean, share * np.array([60.0, 100.0, 140.0]), rtol=0.002)
        np.testing.assert_allclose(sd, np.sqrt(4.0 + 1 / 12 + mean / 20.0), rtol=0.02)

    def test_speckle_leaves_the_stated_contrast_and_the_mean(self) -> None:
        laser = replace(ideal_rig().lasers[0], width_mm=0.45)
        sensor = Sensor(read_dn=0.0, electrons_per_dn=np.inf, speckle=0.15)
        rig = replace(ideal_rig().cropped((1200, 480)), lasers=(laser,), sensor=sensor)
        renderer = renderer_of(bare(), rig)
        calm, _ = renderer.laser_dn(0.0, frozenset({1}))
        seeds = np.array([9, 9], dtype=np.uint64)
        rough, _ = renderer.laser_dn(0.0, frozenset({1}), speckle_seeds=seeds)
        ridge = calm > 0.8 * calm.max()
        ratio = rough[ridge] / calm[ridge]
        assert ratio.mean() == pytest.approx(1.0, abs=0.02)
        # Across a stripe hardly wider than the blur fewer pixels are averaged than in an even field.
        assert 0.14 < ratio.std() < 0.20

    def test_too_much_light_saturates_at_255(self) -> None:
        rig = ideal_rig().cropped((120, 480))
        rig = replace(rig, lasers=tuple(replace(laser, brightness_dn=5000.0) for laser in rig.lasers))
        picture = renderer_of(bare(), rig).render(0, 0.0)
        assert picture[..., 2].max() == 255
        assert (picture[..., 2] == 255).sum() > 120 * 2 * 3
        assert picture[0].max() < 20


def test_interpolated_room_light_agrees_with_a_ray_for_every_pixel() -> None:
    rig = SimulatedRig().cropped((300, 300))
    scene = named_scene("three-objects")
    coarse = renderer_of(scene, rig, room=RoomLight(step_px=2)).room_dn(0.0)
    fine = renderer_of(scene, rig, room=RoomLight(step_px=1)).room_dn(0.0)
    assert coarse.shape == fine.shape == (300, 300, 3)
    assert np.median(np.abs(coarse - fine)) < 0.2


def test_the_sheet_too_thick_for_the_shortcut_is_refused() -> None:
    rig = ideal_rig().cropped((120, 480))
    thick = replace(rig, lasers=(replace(rig.lasers[0], width_mm=6.0),))
    with pytest.raises(SettingsError, match="width_mm"):
        renderer_of(bare(), thick)
