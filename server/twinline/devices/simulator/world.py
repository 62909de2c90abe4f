"""The simulated world: solid things on a flat bed, in the bed frame (x along the travel, y across, z up, mm)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
import trimesh

from twinline.arrays import FloatArray, IntArray
from twinline.devices.simulator.bvh import Bvh, build_bvh
from twinline.errors import SettingsError

TEXTURE_TEXELS = 512
_CEILING_CELL_MM = 2.0
_CEILING_REACH_CELLS = 4
CEILING_REACH_MM = _CEILING_CELL_MM * _CEILING_REACH_CELLS
"""How far sideways of a thing the ceiling still knows of it."""


@dataclass(frozen=True)
class Material:
    """How a surface looks; it scatters light evenly in all directions.

    Attributes
    ----------
    albedo : (float, float, float)
        Share of blue, green and red light that comes back.
    grain
        Standard deviation of the albedo's pattern as a share of it.
    """

    albedo: tuple[float, float, float] = (0.7, 0.75, 0.8)
    grain: float = 0.07


@dataclass(frozen=True, eq=False)
class Thing:
    """One object of a scene.

    Attributes
    ----------
    kind
        What it is: "box", "sphere", "cylinder", "mesh".
    dimensions_mm
        Its sizes and place by name, as a person would note them; enough to compute the surface of a solid.
    mesh
        Its surface, faces looking outwards.
    """

    name: str
    kind: str
    dimensions_mm: Mapping[str, float]
    mesh: trimesh.Trimesh
    material: Material = field(default_factory=Material)

    def moved(self, x_mm: float, y_mm: float) -> "Thing":
        """The same thing elsewhere on the bed."""
        mesh = self.mesh.copy()
        mesh.apply_translation((x_mm, y_mm, 0.0))
        dimensions = dict(self.dimensions_mm)
        dimensions["x"] = dimensions.get("x", 0.0) + x_mm
        dimensions["y"] = dimensions.get("y", 0.0) + y_mm
        return Thing(self.name, self.kind, dimensions, mesh, self.material)


@dataclass(frozen=True, eq=False)
class Ceiling:
    """Upper limit of the height of everything near each cell of the bed.

    A cheap test that never misses a surface: what lies higher than the ceiling, at any point within
    ``CEILING_REACH_MM``, is empty air.

    Attributes
    ----------
    heights_mm : (rows along x, columns along y) array
        0 where only the bed is near.
    origin_mm : (float, float)
        Corner x, y of cell 0, 0.
    cell_mm
        Side of a cell.
    """

    heights_mm: FloatArray
    origin_mm: tuple[float, float]
    cell_mm: float

    @property
    def highest_mm(self) -> float:
        """Height of the highest thing."""
        return float(self.heights_mm.max(initial=0.0))


@dataclass(frozen=True, eq=False)
class World:
    """Everything that light can fall on, ready for rays.

    Attributes
    ----------
    bvh
        The triangles of all things; the bed is the plane z = 0 and not among them.
    normals : (triangles, 3) array
        Outward unit normals, in tree order.
    materials : (triangles,) array of int
        Row of ``looks`` for each triangle in tree order.
    looks : (materials, 4) array
        Blue, green, red albedo and grain; row 0 is the bed.
    texture : (TEXTURE_TEXELS, TEXTURE_TEXELS) array
        Pattern that repeats, mean 0 and standard deviation 1.
    texel_mm
        Size of one texel of the pattern.
    """

    bvh: Bvh
    normals: FloatArray
    materials: IntArray
    looks: FloatArray
    texture: FloatArray
    ceiling: Ceiling
    texel_mm: float = 0.4


def build_world(things: Sequence[Thing], bed: Material, *, seed: int) -> World:
    """Prepare things on a bed for ray casting.

    Parameters
    ----------
    seed
        Of the surfaces' pattern.

    Raises
    ------
    SettingsError
        A mesh has no triangles, or coordinates that are not finite.
    """
    triangles: list[FloatArray] = [np.empty((0, 3, 3))]
    owners: list[IntArray] = [np.empty(0, dtype=np.int32)]
    for number, thing in enumerate(things, 1):
        corners = np.asarray(thing.mesh.triangles, dtype=np.float64)
        if not len(corners) or not np.isfinite(corners).all():
            raise SettingsError(
                f"The simulated object {thing.name!r} has no usable surface: its mesh needs triangles with finite "
                f"coordinates, but it has {len(corners)} triangles."
            )
        triangles.append(corners)
        owners.append(np.full(len(corners), number, dtype=np.int32))
    every = np.concatenate(triangles)
    normals = np.cross(every[:, 1] - every[:, 0], every[:, 2] - every[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    # A sliver without area has no normal and cannot be seen.
    solid = lengths > 0
    every, normals = every[solid], normals[solid] / lengths[solid, np.newaxis]
    bvh = build_bvh(every)
    looks = [(*m.albedo, m.grain) for m in (bed, *(t.material for t in things))]
    return World(
        bvh=bvh,
        normals=np.ascontiguousarray(normals[bvh.order]),
        materials=np.ascontiguousarray(np.concatenate(owners)[solid][bvh.order]),
        looks=np.array(looks, dtype=np.float64),
        texture=_pattern(np.random.default_rng([seed, 1])),
        ceiling=_ceiling(every),
    )


def _pattern(rng: np.random.Generator) -> FloatArray:
    """Fine and coarse blotches drawn out along y, as of a sanded board; it continues over its own edges."""
    tile = np.zeros((TEXTURE_TEXELS, TEXTURE_TEXELS))
    frequency_x = np.fft.fftfreq(TEXTURE_TEXELS)[:, np.newaxis]
    frequency_y = np.fft.rfftfreq(TEXTURE_TEXELS)[np.newaxis, :]
    for texels_x, texels_y, weight in ((1.2, 5.0, 0.7), (5.0, 24.0, 1.0), (20.0, 60.0, 0.6)):
        keep = np.exp(-2 * np.pi**2 * ((frequency_x * texels_x) ** 2 + (frequency_y * texels_y) ** 2))
        blotches = np.fft.irfft2(np.fft.rfft2(rng.standard_normal(tile.shape)) * keep, tile.shape)
        tile += weight * blotches / blotches.std()
    return np.asarray(np.clip((tile - tile.mean()) / tile.std(), -3.0, 3.0), dtype=np.float32)


def _ceiling(triangles: FloatArray) -> Ceiling:
    """Heights of the triangles' own boxes, widened by the reach in every direction."""
    if not len(triangles):
        return Ceiling(np.zeros((1, 1)), (0.0, 0.0), _CEILING_CELL_MM)
    lower, upper = triangles.min(axis=1), triangles.max(axis=1)
    border = (_CEILING_REACH_CELLS + 1) * _CEILING_CELL_MM
    origin = lower[:, :2].min(axis=0) - border
    first = np.floor((lower[:, :2] - origin) / _CEILING_CELL_MM).astype(np.intp)
    last = np.floor((upper[:, :2] - origin) / _CEILING_CELL_MM).astype(np.intp)
    size = last.max(axis=0) + _CEILING_REACH_CELLS + 2
    heights = np.zeros((int(size[0]), int(size[1])), dtype=np.float64)
    for (i0, j0), (i1, j1), top in zip(first, last, upper[:, 2], strict=True):
        cells = heights[i0 : i1 + 1, j0 : j1 + 1]
        np.maximum(cells, top, out=cells)
    width = 2 * _CEILING_REACH_CELLS + 1
    heights = np.asarray(cv2.dilate(heights, np.ones((width, width), dtype=np.uint8)), dtype=np.float64)
    return Ceiling(heights, (float(origin[0]), float(origin[1])), _CEILING_CELL_MM)
