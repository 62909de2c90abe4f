"""Where light must and must not be, computed here by explicit algebra."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from twinline.arrays import FloatArray
from twinline.devices.simulator.ceiling import Ceiling
from twinline.devices.simulator.machine import SimulatedLaser, SimulatedRig, ideal_rig
from twinline.devices.simulator.renderer import Renderer, RoomLight
from twinline.devices.simulator.scenes import Scene, box, named_scene
from twinline.devices.simulator.sensor import Exposure, Sensor
from twinline.devices.simulator.world import Material, build_world
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
    picture[first : first + band.shape[1]] = band.sum(axis=0)
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


def test_the_open_bed_is_as_bright_as_lamp_and_surroundings_make_it() -> None:
    rig = ideal_rig().cropped((64, 48))
    picture = renderer_of(bare(), rig, room=RoomLight((60.0, 100.0, 140.0))).room_dn(0.0)
    # Half of the light comes from everywhere, half from a lamp that stands at this height above the horizon.
    sine = 0.89 / np.linalg.norm([0.28, 0.36, 0.89])
    expected = 0.8 * (0.5 + 0.5 * sine) * np.array([60.0, 100.0, 140.0])
    np.testing.assert_allclose(picture, np.broadcast_to(expected, picture.shape), rtol=1e-5)


def test_the_pattern_of_the_bed_stays_where_it_is_while_the_cart_moves() -> None:
    rig = ideal_rig().cropped((90, 130))
    renderer = renderer_of(bare(Material((0.5, 0.5, 0.5), 0.2)), rig, room=RoomLight((100.0, 100.0, 100.0)))
    # By so many millimetres the bed moves up by 20 rows of the picture, and to the next repeat of the pattern and on.
    step_mm = 20 * 430.0 / 1030.0
    here = renderer.room_dn(0.0)
    assert here.std() > 3.0
    for steps in (1, -1, 3):
        there = renderer.room_dn(steps * step_mm)
        seen, before = (there[: 130 - 20 * steps], here[20 * steps :]) if steps > 0 else (there[20:], here[:-20])
        np.testing.assert_allclose(seen, before, atol=0.05)


def test_things_shade_the_bed_on_the_side_away_from_the_lamp() -> None:
    rig = ideal_rig().cropped((400, 400))
    block = box("block", (30.0, 30.0, 20.0), 0.0, 0.0, 0.0, PLAIN)
    picture = renderer_of(Scene("block", (block,), PLAIN), rig, room=RoomLight((100.0, 100.0, 100.0))).room_dn(0.0)
    grey = picture[..., 1]
    v, u = (rig.lens.centre_px[1], rig.lens.centre_px[0])

    def at(x_mm: float, y_mm: float) -> float:
        row, column = round(v + 1030.0 * x_mm / 430.0), round(u + 1030.0 * y_mm / 430.0)
        return float(grey[row - 1 : row + 2, column - 1 : column + 2].mean())

    far = at(75.0, 75.0)
    # The lamp stands towards +x and -y: 20 mm high means a shadow of 20 * 0.36 / 0.89 = 8.1 mm towards +y.
    assert at(0.0, 19.0) < 0.75 * far
    assert at(0.0, -23.0) > 0.8 * far
    assert at(0.0, 40.0) > 0.93 * far


@pytest.mark.parametrize(("shift_mm", "yaw_deg"), [(0.0, 0.0), (0.13, 0.0), (0.29, 0.0), (0.1, 8.0)])
def test_an_edge_lies_where_a_pinhole_sees_it_to_a_part_of_a_pixel(shift_mm: float, yaw_deg: float) -> None:
    rig = ideal_rig().cropped((160, 240))
    white, black = Material((0.9, 0.9, 0.9), 0.0), Material((0.0, 0.0, 0.0), 0.0)
    # The face towards +x is seen from above it; its upper edge is the border between white and black.
    block = box("block", (40.0, 90.0, 15.0), shift_mm, 0.0, yaw_deg, white)
    picture = renderer_of(Scene("block", (block,), black), rig, room=RoomLight((100.0, 100.0, 100.0))).room_dn(0.0)
    for column in (40, 80, 120):
        y = (column - rig.lens.centre_px[0]) * 415.0 / 1030.0
        yaw = np.radians(yaw_deg)
        x = shift_mm - (20.0 + y * np.sin(yaw)) / np.cos(yaw)
        expected = rig.lens.centre_px[1] + 1030.0 * x / 415.0
        rows = np.arange(round(expected) - 8, round(expected) + 9)
        light = picture[rows, column, 1]
        # Position of a blurred step: the middle of its derivative.
        slope = np.abs(np.diff(light))
        seen = float((slope * (rows[:-1] + 0.5)).sum() / slope.sum())
        assert seen == pytest.approx(expected, abs=0.11)


def test_exposure_and_gain_act_on_light_and_noise_as_in_a_camera() -> None:
    sensor = Sensor(read_dn=2.0, electrons_per_dn=20.0)
    rig = replace(ideal_rig().cropped((400, 300)), sensor=sensor)
    renderer = renderer_of(bare(), rig, room=RoomLight((60.0, 60.0, 60.0)))
    base = renderer.render(0, 0.0, frozenset())
    longer = renderer.render(0, 0.0, frozenset(), exposure=Exposure(time=2.0))
    louder = renderer.render(0, 0.0, frozenset(), exposure=Exposure(gain=2.0))
    mean = base.mean()
    assert longer.mean() == pytest.approx(2 * mean, rel=0.01)
    assert louder.mean() == pytest.approx(2 * mean, rel=0.01)
    assert longer.std() == pytest.approx(np.sqrt(4.0 + 2 * mean / 20.0 + 1 / 12), rel=0.02)
    # Twice the gain is half the electrons for the same grey level, and twice the read noise.
    assert louder.std() == pytest.approx(np.sqrt(16.0 + 4 * mean / 20.0 + 1 / 12), rel=0.02)


def test_the_lens_darkens_towards_its_corners_by_its_law() -> None:
    rig = replace(ideal_rig(), sensor=Sensor(falloff=1.0, read_dn=0.0, electrons_per_dn=np.inf))
    picture = renderer_of(bare(), rig, room=RoomLight((200.0, 200.0, 200.0))).render(0, 0.0, frozenset()).astype(float)
    cosine = 1.0 / np.sqrt(1.0 + (639.5**2 + 359.5**2) / 1030.0**2)
    middle = picture[340:380, 620:660].mean()
    assert picture[:3, :3].mean() / middle == pytest.approx(cosine**4, abs=0.01)


def test_a_green_laser_is_green_and_meets_the_green_albedo() -> None:
    green = replace(ideal_rig().lasers[0], response=(0.1, 1.0, 0.15))
    rig = replace(ideal_rig().cropped((120, 480)), lasers=(green, ideal_rig().lasers[1]))
    picture = renderer_of(bare(Material((0.8, 0.4, 0.8), 0.0)), rig).render(0, 0.0).astype(float)
    lower, upper = picture[260:], picture[:220]
    assert lower[..., 1].max() > 3 * lower[..., 2].max()
    assert upper[..., 2].max() > 3 * upper[..., 1].max()
    assert lower[..., 1].max() < 0.7 * upper[..., 2].max()


@pytest.mark.parametrize("share", [0.0, 0.25])
def test_a_dim_laser_gives_its_share_of_light_and_a_dead_one_none(share: float) -> None:
    renderer = renderer_of(bare(), ideal_rig().cropped((120, 480)))
    full, _ = renderer.laser_dn(0.0, frozenset({1}))
    dim, _ = renderer.laser_dn(0.0, frozenset({1}), power={1: share})
    np.testing.assert_allclose(dim, share * full, rtol=1e-5, atol=1e-4)


def test_the_sheet_too_thick_for_the_shortcut_is_refused() -> None:
    rig = ideal_rig().cropped((120, 480))
    thick = replace(rig, lasers=(replace(rig.lasers[0], width_mm=6.0),))
    with pytest.raises(SettingsError, match="width_mm"):
        renderer_of(bare(), thick)
