"""A scene under one machine: what the simulated camera, the simulated board and a truth file all speak of."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import trimesh

from twinline.arrays import FloatArray
from twinline.devices.simulator.machine import SimulatedRig
from twinline.devices.simulator.renderer import Renderer, RoomLight
from twinline.devices.simulator.scenes import Scene, named_scene
from twinline.devices.simulator.sensor import Sensor
from twinline.devices.simulator.tof import FrontEnd, TofFaults, TofReader, TofSensor
from twinline.devices.simulator.tof_beam import true_distances_mm
from twinline.devices.simulator.truth import export_mesh, true_rig, truth_mesh
from twinline.devices.simulator.world import World, build_world
from twinline.errors import SettingsError
from twinline.geometry.rig import Rig

WORKSHOP = RoomLight((75.0, 84.0, 87.0))
"""A workshop with the blinds half down: bright enough to see by, dim enough for the lasers."""
START_MM = 10.0
"""Commanded position at which a laser pass over a placed scene may begin."""


def swept_travel_mm(rig: SimulatedRig, scene: Scene) -> tuple[float, float]:
    """Commanded positions between which every laser sweeps the scene, by what the owner knows of the machine."""
    highest = max((float(thing.mesh.bounds[1][2]) for thing in scene.things), default=0.0)
    reaches = [
        laser.ahead * (laser.known_baseline_mm - depth / np.tan(np.radians(laser.known_angle_deg)))
        for laser in rig.lasers
        for depth in (rig.known_camera_height_mm, rig.known_camera_height_mm - highest)
    ]
    return scene.span_mm[0] - max(reaches), scene.span_mm[1] - min(reaches)


@dataclass(frozen=True, eq=False)
class Workspace:
    """Things on the bed of one machine; immutable and picklable.

    Attributes
    ----------
    scene
        As it lies in the bed frame, whose origin is below the camera while the cart stands at 0.
    seed
        Of the surfaces' patterns and of all noise in pictures.
    """

    scene: Scene
    rig: SimulatedRig
    room: RoomLight
    seed: int

    @cached_property
    def world(self) -> World:
        """The scene, prepared for rays."""
        return build_world(self.scene.things, self.scene.bed, seed=self.seed)

    @cached_property
    def renderer(self) -> Renderer:
        """What takes the pictures."""
        return Renderer(self.world, self.rig, self.room, seed=self.seed)

    @property
    def laser_pass_mm(self) -> tuple[float, float]:
        """Commanded positions between which every laser sweeps the scene."""
        return swept_travel_mm(self.rig, self.scene)

    def tof_distance_mm(self, cart_mm: float, slide_mm: float) -> float:
        """True distance that the spot of the ToF sensor averages; infinity where there is nothing.

        Parameters
        ----------
        cart_mm, slide_mm
            Where cart and slide stand in commanded millimetres, whatever their drives were told.

        Raises
        ------
        SettingsError
            The machine has no ToF sensor.
        """
        return float(self.tof_distances_mm(np.array([cart_mm]), np.array([slide_mm]))[0])

    def tof_distances_mm(self, cart_mm: FloatArray, slide_mm: FloatArray) -> FloatArray:
        """As `tof_distance_mm` for many positions at once, (n,)."""
        if self.rig.tof is None:
            raise SettingsError("The simulated machine has no ToF sensor; give its rig one.")
        return true_distances_mm(self.world, self.rig.tof, self.rig.travel, cart_mm, slide_mm)

    def tof_adc(
        self, sensor: TofSensor | None = None, front_end: FrontEnd | None = None, faults: TofFaults | None = None
    ) -> "WorkspaceAdc":
        """The ToF sensor and its converter, as a simulated board samples them."""
        reader = TofReader(sensor or TofSensor(), front_end or FrontEnd(), self.seed, faults or TofFaults())
        return WorkspaceAdc(self, reader)

    def true_rig(self, front_end: FrontEnd | None = None) -> Rig:
        """The machine's true parameters in the project's terms, for ToF readings in counts of a board's converter."""
        return true_rig(f"{self.scene.name} (true)", self.rig, front_end or FrontEnd())

    def true_mesh(self) -> trimesh.Trimesh:
        """All things in the bed frame, millimetres; empty for a bare bed."""
        return truth_mesh(self.scene)

    def export_mesh(self, path: Path) -> None:
        """Write the true mesh as .ply, .stl, .obj or .glb (which is in metres, as its format demands).

        Raises
        ------
        SettingsError
            Another ending, or a bare bed that has no mesh.
        OutputError
            The file cannot be written.
        """
        export_mesh(path, self.true_mesh())


@dataclass(frozen=True, eq=False)
class WorkspaceAdc:
    """An `AdcModel`: counts of the converter behind the ToF sensor; ``reader.faults`` may be replaced at any time."""

    workspace: Workspace
    reader: TofReader

    def __call__(self, cart_mm: FloatArray, slide_mm: FloatArray, host_time_s: FloatArray) -> FloatArray:
        """Counts (n,) at true positions and ascending times."""
        distance = self.workspace.tof_distances_mm(cart_mm, slide_mm)
        return self.reader.sample(host_time_s, distance).astype(np.float64)


def build_workspace(
    scene: str | Scene = "three-objects",
    rig: SimulatedRig | None = None,
    room: RoomLight | None = None,
    *,
    seed: int = 0,
    start_mm: float = START_MM,
) -> Workspace:
    """Put a scene under a machine, as far along the travel as a laser pass from ``start_mm`` on needs.

    Parameters
    ----------
    scene
        Name of a built-in scene, path of a mesh file, or a scene about the origin.
    rig
        By default a machine that is misaligned in every way a real one is.
    room
        By default `WORKSHOP`.

    Raises
    ------
    NotFoundError
        There is no such scene, or no such file.
    SettingsError
        A file has no usable surface.
    """
    machine = rig or SimulatedRig(sensor=Sensor(falloff=0.3))
    chosen = named_scene(scene) if isinstance(scene, str) else scene
    first_mm, _ = swept_travel_mm(machine, chosen)
    return Workspace(chosen.moved(start_mm - first_mm, 0.0), machine, room or WORKSHOP, seed)
