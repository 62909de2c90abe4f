"""Scenes that come with the simulator, and any mesh put under it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from twinline.arrays import FloatArray
from twinline.devices.simulator.board_print import board_thing, default_board
from twinline.devices.simulator.mesh_file import MESH_ENDINGS, read_mesh
from twinline.devices.simulator.relief import HALF_X_MM, HALF_Y_MM, relief_mesh
from twinline.devices.simulator.turns import turn_deg
from twinline.devices.simulator.world import Material, Thing
from twinline.errors import NotFoundError, SettingsError

_BED = Material((0.46, 0.50, 0.52), 0.08)
_WOOD = Material((0.52, 0.68, 0.82), 0.06)
_OAK = Material((0.40, 0.58, 0.72), 0.10)
_WALNUT = Material((0.22, 0.34, 0.47), 0.10)
_CHALK = Material((0.88, 0.90, 0.90), 0.02)
_CARD = Material((0.74, 0.70, 0.62), 0.04)


@dataclass(frozen=True, eq=False)
class Scene:
    """Things on the bed.

    Attributes
    ----------
    things
        Placed about the origin of the bed plane, standing on it.
    span_mm : (float, float)
        Lowest and highest x that a scan should cover.
    """

    name: str
    things: tuple[Thing, ...]
    bed: Material = _BED
    span_mm: tuple[float, float] = (-20.0, 20.0)

    def moved(self, x_mm: float, y_mm: float) -> "Scene":
        """The same scene elsewhere on the bed."""
        return Scene(
            self.name,
            tuple(thing.moved(x_mm, y_mm) for thing in self.things),
            self.bed,
            (self.span_mm[0] + x_mm, self.span_mm[1] + x_mm),
        )


def named_scene(name: str) -> Scene:
    """A built-in scene, or a mesh file given by its path.

    Raises
    ------
    NotFoundError
        There is no scene of this name, or no such file.
    SettingsError
        The file has no usable surface.
    """
    path = Path(name)
    if path.suffix.lower() in MESH_ENDINGS:
        mesh, colours = read_mesh(path)
        return mesh_scene(path.stem, mesh, colours=colours)
    makers: dict[str, Callable[[], Sequence[Thing]]] = {
        "bed": lambda: (),
        "three-objects": _three_objects,
        "five-pieces": _five_pieces,
        "board": lambda: (board_thing(default_board(), 0.0, 0.0, 7.0),),
        "steps": _steps,
        "sphere": lambda: (_sphere("sphere", 20.0, 0.0, 0.0, _CHALK),),
        "relief": lambda: (_relief(),),
    }
    if name not in makers:
        raise NotFoundError(
            f"There is no simulated scene {name!r}; choose one of {', '.join(sorted(makers))}, or give a mesh file "
            f"({', '.join(MESH_ENDINGS)})."
        )
    return scene_of(name, makers[name]())


def scene_of(name: str, things: Sequence[Thing], *, margin_mm: float = 6.0) -> Scene:
    """Things as a scene that is scanned from end to end.

    Parameters
    ----------
    margin_mm
        Bare bed to scan before and after the things.
    """
    if not things:
        return Scene(name, ())
    first = min(float(thing.mesh.bounds[0][0]) for thing in things)
    last = max(float(thing.mesh.bounds[1][0]) for thing in things)
    return Scene(name, tuple(things), span_mm=(first - margin_mm, last + margin_mm))


def mesh_scene(
    name: str, mesh: trimesh.Trimesh, material: Material = _CHALK, *, colours: FloatArray | None = None
) -> Scene:
    """Any mesh, centred and standing on the bed as it is turned.

    Parameters
    ----------
    colours : (vertices, 3) array
        Share of blue, green and red light that comes back; None takes the material's.

    Raises
    ------
    SettingsError
        The mesh has no triangles.
    """
    if not len(mesh.faces):
        raise SettingsError(f"The mesh {name!r} has no triangles; give a file with a surface, in millimetres.")
    mesh = mesh.copy()
    low, high = mesh.bounds
    mesh.apply_translation((-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]))
    size = dict(zip(("size_x", "size_y", "size_z"), (float(s) for s in mesh.extents), strict=True))
    return scene_of(name, [Thing(name, "mesh", {"x": 0.0, "y": 0.0, **size}, mesh, material, colours)])


def box(name: str, size: tuple[float, float, float], x: float, y: float, yaw_deg: float, material: Material) -> Thing:
    """A box standing on the bed, its middle at x, y; sizes along its own axes in mm."""
    mesh = trimesh.creation.box(size)
    turn = np.eye(4)
    turn[:3, :3] = turn_deg(np.array([0.0, 0.0, 1.0]), yaw_deg)
    mesh.apply_transform(turn)
    mesh.apply_translation((x, y, size[2] / 2))
    dimensions = {"x": x, "y": y, "size_x": size[0], "size_y": size[1], "size_z": size[2], "yaw_deg": yaw_deg}
    return Thing(name, "box", dimensions, mesh, material)


def _sphere(name: str, radius: float, x: float, y: float, material: Material) -> Thing:
    # With 20 480 facets the mesh stays within radius / 6000 of the ball.
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    mesh.apply_translation((x, y, radius))
    return Thing(name, "sphere", {"x": x, "y": y, "z": radius, "radius": radius}, mesh, material)


def _cylinder(name: str, radius: float, height: float, x: float, y: float, material: Material) -> Thing:
    mesh = trimesh.creation.cylinder(radius=radius, height=height, sections=256)
    mesh.apply_translation((x, y, height / 2))
    return Thing(name, "cylinder", {"x": x, "y": y, "radius": radius, "height": height}, mesh, material)


def _three_objects() -> Sequence[Thing]:
    return (
        box("prism", (25.4, 24.2, 19.35), -1.0, -38.0, 14.0, _WOOD),
        _sphere("sphere", 14.0, 1.0, 0.0, _CHALK),
        _cylinder("cylinder", 11.0, 16.0, -1.0, 36.0, _CARD),
    )


def _steps() -> Sequence[Thing]:
    """Blocks in a row across the bed, so that no block stands in the light of another."""
    heights = (10.0, 20.0, 30.0, 40.0, 50.0)
    return [
        box(f"block {height:g} mm", (24.0, 18.0, height), 0.0, 24.0 * (i - 2), 0.0, _CARD)
        for i, height in enumerate(heights)
    ]


def _relief() -> Thing:
    size = {"size_x": 2 * HALF_X_MM, "size_y": 2 * HALF_Y_MM}
    return Thing("relief", "mesh", {"x": 0.0, "y": 0.0, **size}, relief_mesh(), _CHALK)


def _five_pieces() -> Sequence[Thing]:
    """Five wooden pieces, thrown down at random once and for all."""
    arch = np.linspace(0.0, np.pi, 97)
    hexagon = np.arange(6) * np.pi / 3
    return (
        box("block", (32.0, 18.0, 15.0), -24.0, -30.0, 27.0, _OAK),
        _bar("wedge", np.array([[-11.0, 0.0], [11.0, 0.0], [0.0, 15.0]]), 30.0, 20.0, -38.0, -52.0, _WOOD),
        _cylinder("rod", 9.0, 22.0, -1.0, 1.0, _WALNUT),
        _bar("arch", 10.0 * np.column_stack([np.cos(arch), np.sin(arch)]), 34.0, -24.0, 32.0, 71.0, _WOOD),
        _standing("hexagon", 12.0 * np.column_stack([np.cos(hexagon), np.sin(hexagon)]), 10.0, 25.0, 29.0, 13.0, _OAK),
    )


def _bar(
    name: str, profile: FloatArray, length: float, x: float, y: float, yaw_deg: float, material: Material
) -> Thing:
    """A convex profile (across, up) drawn out along its own axis and laid down."""
    ends = [np.column_stack([np.full(len(profile), at), profile]) for at in (-length / 2, length / 2)]
    return _hull(name, np.concatenate(ends), {"length": length}, x, y, yaw_deg, material)


def _standing(
    name: str, outline: FloatArray, height: float, x: float, y: float, yaw_deg: float, material: Material
) -> Thing:
    """A convex outline (x, y) drawn out upwards."""
    ends = [np.column_stack([outline, np.full(len(outline), z)]) for z in (0.0, height)]
    return _hull(name, np.concatenate(ends), {"height": height}, x, y, yaw_deg, material)


def _hull(
    name: str, points: FloatArray, sizes: dict[str, float], x: float, y: float, yaw_deg: float, material: Material
) -> Thing:
    placed = points @ turn_deg(np.array([0.0, 0.0, 1.0]), yaw_deg).T + (x, y, 0.0)
    mesh = trimesh.convex.convex_hull(placed)
    return Thing(name, "mesh", {"x": x, "y": y, **sizes, "yaw_deg": yaw_deg}, mesh, material)
