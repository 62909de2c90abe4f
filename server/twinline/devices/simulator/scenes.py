"""Scenes that come with the simulator, and any mesh put under it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from twinline.arrays import FloatArray
from twinline.devices.simulator.machine import turn_deg
from twinline.devices.simulator.world import Material, Thing
from twinline.errors import NotFoundError, SettingsError

_BED = Material((0.46, 0.50, 0.52), 0.08)
_WOOD = Material((0.52, 0.68, 0.82), 0.06)
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
    """A built-in scene.

    Raises
    ------
    NotFoundError
        There is none of this name.
    """
    makers: dict[str, Callable[[], Sequence[Thing]]] = {
        "bed": lambda: (),
        "three-objects": _three_objects,
        "steps": _steps,
        "sphere": lambda: (_sphere("sphere", 20.0, 0.0, 0.0, _CHALK),),
        "relief": lambda: (_relief(),),
    }
    if name not in makers:
        raise NotFoundError(f"There is no simulated scene {name!r}; choose one of {', '.join(sorted(makers))}.")
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


def mesh_scene(name: str, mesh: trimesh.Trimesh, material: Material = _CHALK) -> Scene:
    """Any mesh, centred and standing on the bed as it is turned.

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
    return scene_of(name, [Thing(name, "mesh", {"x": 0.0, "y": 0.0, **size}, mesh, material)])


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
    """A face in low relief: smooth, without an edge except its rim."""
    x, y = np.meshgrid(np.linspace(-32.0, 32.0, 129), np.linspace(-26.0, 26.0, 105), indexing="ij")

    def bump(at_x: float, at_y: float, wide_x: float, wide_y: float, high: float) -> FloatArray:
        return np.asarray(high * np.exp(-0.5 * (((x - at_x) / wide_x) ** 2 + ((y - at_y) / wide_y) ** 2)))

    inside = np.clip(1.0 - (x / 31.0) ** 2 - (y / 25.0) ** 2, 0.0, None)
    height = 13.0 * inside**0.55
    height += bump(2.0, 0.0, 7.0, 3.0, 6.5) + bump(6.5, 0.0, 2.6, 4.2, 3.0)
    height += bump(-7.5, -9.5, 2.2, 6.0, 2.2) + bump(-7.5, 9.5, 2.2, 6.0, 2.2)
    height -= bump(-3.0, -9.5, 2.6, 4.5, 3.0) + bump(-3.0, 9.5, 2.6, 4.5, 3.0)
    height += bump(-3.0, -9.5, 1.3, 2.4, 1.6) + bump(-3.0, 9.5, 1.3, 2.4, 1.6)
    height += bump(13.0, 0.0, 1.4, 6.0, 1.8) + bump(16.8, 0.0, 1.6, 5.0, 2.0) - bump(14.9, 0.0, 0.8, 7.0, 1.2)
    height += bump(23.0, 0.0, 3.0, 4.0, 2.4)
    mesh = _height_field(x, y, np.clip(height, 0.0, None) * (inside > 0))
    return Thing("relief", "mesh", {"x": 0.0, "y": 0.0, "size_x": 64.0, "size_y": 52.0}, mesh, _CHALK)


def _height_field(x: FloatArray, y: FloatArray, height: FloatArray) -> trimesh.Trimesh:
    """Two triangles a cell, leaving out the cells that lie flat on the bed."""
    rows, columns = x.shape
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    top = np.maximum.reduce([height[:-1, :-1], height[1:, :-1], height[1:, 1:], height[:-1, 1:]])
    raised = top > 0
    faces = np.concatenate([np.stack([a, b, c], axis=-1)[raised], np.stack([a, c, d], axis=-1)[raised]])
    vertices = np.column_stack([x.ravel(), y.ravel(), height.ravel()])
    return trimesh.Trimesh(vertices, faces, process=False)
