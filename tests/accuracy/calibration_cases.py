"""Simulated machines and scenes to calibrate on, each out of true in its own way."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import trimesh

from tests.accuracy.calibration_parts import TrueTof, misaligned_rig
from twinline.devices.simulator.lens import Lens
from twinline.devices.simulator.machine import SimulatedRig
from twinline.devices.simulator.scenes import Scene, box, named_scene, scene_of
from twinline.devices.simulator.sensor import Sensor
from twinline.devices.simulator.world import Material, Thing

IMAGE_SIZE = (1024, 640)
PITCH_MM = 1.5

_WOOD, _CARD = Material((0.52, 0.68, 0.82), 0.06), Material((0.74, 0.70, 0.62), 0.04)


@dataclass(frozen=True)
class Case:
    """A capture to be made: what lies on the bed, the machine, and how its owner misjudges it."""

    scene: Callable[[], Scene]
    rig: SimulatedRig
    seed: int
    tof: TrueTof = field(default_factory=TrueTof)


def flat_tops() -> Scene:
    """Nothing but level tops: all they tell of a laser's tilt is their height."""
    return scene_of(
        "flat tops",
        [
            box("low", (30, 24, 12), -4, -52, 10, _WOOD),
            box("middle", (26, 26, 20), 3, -18, -20, _CARD),
            box("high", (24, 30, 30), -2, 18, 33, _WOOD),
            box("another", (24, 20, 16), 4, 52, 5, _CARD),
        ],
    )


def equal_tops() -> Scene:
    """Level tops of one height."""
    return scene_of(
        "equal tops",
        [
            box("left", (25, 25, 20), -4, -45, 10, _WOOD),
            box("middle", (25, 25, 20), 3, 0, -20, _CARD),
            box("right", (25, 25, 20), -2, 45, 33, _WOOD),
        ],
    )


def small_spheres() -> Scene:
    """Nothing flat, and little of it."""
    return scene_of(
        "small spheres",
        [_sphere("left", 10.0, 0.0, -35.0), _sphere("middle", 14.0, 3.0, 0.0), _sphere("right", 8.0, -2.0, 30.0)],
    )


def _sphere(name: str, radius: float, x: float, y: float) -> Thing:
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    mesh.apply_translation((x, y, radius))
    return Thing(name, "sphere", {"x": x, "y": y, "z": radius, "radius": radius}, mesh, _CARD)


def prism() -> Scene:
    """The prism of the thesis, alone."""
    return scene_of("prism", [box("prism", (25.4, 24.2, 19.35), 0, 0, 14, _WOOD)])


def small_block() -> Scene:
    """Hardly anything."""
    return scene_of("small block", [box("block", (15, 15, 10), 0, 3, 20, _WOOD)])


def _cases() -> dict[str, Case]:
    thesis = misaligned_rig(18)
    lower = misaligned_rig(15)
    longer = misaligned_rig(17)
    noisy = misaligned_rig(20)
    return {
        "three objects, angles 3 and 6 degrees out": Case(
            lambda: named_scene("three-objects"),
            replace(
                thesis,
                lasers=tuple(
                    replace(laser, known_baseline_mm=246.0, known_angle_deg=60.0, angle_error_deg=degrees)
                    for laser, degrees in zip(thesis.lasers, (5.75, 2.5), strict=True)
                ),
            ),
            18,
        ),
        "flat tops": Case(flat_tops, misaligned_rig(2), 2),
        "tops of one height, few ToF readings": Case(
            equal_tops, misaligned_rig(14), 14, TrueTof(advance_mm=5.0, sweep_mm_s=50.0)
        ),
        "steps under a lower camera": Case(
            lambda: named_scene("steps"),
            replace(
                lower,
                camera_height_mm=lower.camera_height_mm - 50.0,
                known_camera_height_mm=380.0,
                lasers=tuple(replace(x, known_baseline_mm=200.0, known_angle_deg=68.0) for x in lower.lasers),
            ),
            15,
        ),
        "relief under a longer lens": Case(
            lambda: named_scene("relief"),
            replace(
                longer,
                lens=Lens((1420.0, 1418.0), (655.0, 351.0), (-0.05, 0.02, 0.0), (0.0003, -0.0005)),
                known_focal_px=1400.0,
                camera_height_mm=longer.camera_height_mm + 70.0,
                known_camera_height_mm=500.0,
                lasers=tuple(replace(x, known_baseline_mm=230.0, known_angle_deg=70.0) for x in longer.lasers),
            ),
            17,
        ),
        "sphere in faint light with much noise": Case(
            lambda: named_scene("sphere"),
            replace(
                noisy,
                sensor=Sensor(blur_px=1.1, read_dn=3.0, electrons_per_dn=25.0, speckle=0.25),
                lasers=tuple(replace(laser, brightness_dn=180.0) for laser in noisy.lasers),
            ),
            20,
            TrueTof(place_mm=(-110.0, -1.0, 131.0), tilt_deg=(0.8, -0.9), slide_yaw_deg=0.9, lag_s=0.03),
        ),
        "small spheres, few ToF readings": Case(
            small_spheres, misaligned_rig(74), 74, TrueTof(advance_mm=6.0, sweep_mm_s=60.0)
        ),
        "one small block": Case(small_block, misaligned_rig(12), 12),
    }


CASES = _cases()

REPORTED: dict[str, Case] = {
    "prism 25.4 x 24.2 x 19.35 mm only": Case(prism, misaligned_rig(13), 13),
    **CASES,
}
"""Those of the accuracy report."""
