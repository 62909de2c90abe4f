"""The simulated world: solid things on a flat bed, in the bed frame (x along the travel, y across, z up, mm)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import trimesh

from twinline.arrays import FloatArray, IntArray
from twinline.devices.simulator.baking import OPEN_BED_LIGHT, BakedLight, bake_light
from twinline.devices.simulator.bvh import Bvh, build_bvh
from twinline.devices.simulator.ceiling import Ceiling, build_ceiling
from twinline.devices.simulator.solids import TEXTURE_TEXELS, Solids
from twinline.errors import SettingsError

_ON_BED_MM = 1e-9


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
class Print:
    """A picture printed on the level top of a thing.

    Attributes
    ----------
    share : (rows, columns) array of float32
        Share of light that comes back, the same in all colours, already softened by what a camera's pixels
        and lens take away.
    corner_mm : (float, float)
        Place of the middle of texel 0, 0 on the bed.
    along : ((float, float), (float, float))
        Unit vectors on the bed along columns (a row of texels) and along rows.
    texel_mm
        Distance of neighbouring texels.
    """

    share: FloatArray
    corner_mm: tuple[float, float]
    along: tuple[tuple[float, float], tuple[float, float]]
    texel_mm: float

    def moved(self, x_mm: float, y_mm: float) -> "Print":
        """The same print elsewhere on the bed."""
        return replace(self, corner_mm=(self.corner_mm[0] + x_mm, self.corner_mm[1] + y_mm))


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
    colours : (vertices, 3) array
        Share of blue, green and red light that comes back at each vertex; None where the material says it for all.
    printed
        Picture on its level faces; of all things in a world only one may have it.
    """

    name: str
    kind: str
    dimensions_mm: Mapping[str, float]
    mesh: trimesh.Trimesh
    material: Material = field(default_factory=Material)
    colours: FloatArray | None = None
    printed: Print | None = None

    def moved(self, x_mm: float, y_mm: float) -> "Thing":
        """The same thing elsewhere on the bed."""
        mesh = self.mesh.copy()
        mesh.apply_translation((x_mm, y_mm, 0.0))
        dimensions = dict(self.dimensions_mm)
        dimensions["x"] = dimensions.get("x", 0.0) + x_mm
        dimensions["y"] = dimensions.get("y", 0.0) + y_mm
        printed = None if self.printed is None else self.printed.moved(x_mm, y_mm)
        return replace(self, dimensions_mm=dimensions, mesh=mesh, printed=printed)


@dataclass(frozen=True, eq=False)
class World:
    """Everything that light can fall on, ready for rays.

    Attributes
    ----------
    bvh
        The triangles of all things; the bed is the plane z = 0 and not among them.
    normals : (triangles, 3) array
        Outward unit normals, in tree order.
    owners : (triangles,) array of int
        Number of the thing that each triangle in tree order belongs to, from 1.
    albedo : (triangles, 3, 3) array
        Blue, green, red (last axis) at the corners of each triangle.
    looks : (things + 1, 4) array
        Blue, green, red albedo and grain; row 0 is the bed.
    texture : (TEXTURE_TEXELS, TEXTURE_TEXELS) array
        Pattern that repeats, mean 0 and standard deviation 1.
    texel_mm
        Size of one texel of the pattern.
    room
        How much of the room's light reaches the bed and the corners of the triangles.
    print_owner, printed
        Number of the thing with a print, and the print; 0 and None where there is none.
    """

    bvh: Bvh
    normals: FloatArray
    owners: IntArray
    albedo: FloatArray
    looks: FloatArray
    texture: FloatArray
    ceiling: Ceiling
    room: BakedLight
    texel_mm: float = 0.4
    print_owner: int = 0
    printed: Print | None = None

    def solids(self) -> Solids:
        """The world as compiled loops take it."""
        ceiling, room = self.ceiling, self.room
        share, texel_from_bed = np.zeros((2, 2), dtype=np.float32), np.zeros((2, 3))
        if self.printed is not None:
            share = np.ascontiguousarray(self.printed.share, dtype=np.float32)
            turn = np.array(self.printed.along) / self.printed.texel_mm
            texel_from_bed = np.column_stack([turn, -turn @ self.printed.corner_mm])
        count = len(self.normals)
        numbers = [
            self.texel_mm, ceiling.highest_mm, *ceiling.origin_mm, ceiling.cell_mm, *room.bed_corner_mm,
            room.bed_cell_mm, OPEN_BED_LIGHT, float(self.print_owner), *texel_from_bed.ravel(),
        ]  # fmt: skip
        faces = [self.normals, self.albedo.reshape(count, 9), room.corners, self.owners[:, np.newaxis]]
        return Solids(
            corners=self.bvh.corners,
            nodes=self.bvh.nodes,
            faces=np.ascontiguousarray(np.concatenate(faces, axis=1), dtype=np.float64),
            looks=self.looks,
            texture=self.texture,
            ceilings=ceiling.heights_mm,
            bed_light=room.bed,
            print_share=share,
            numbers=np.array(numbers),
        )


def build_world(things: Sequence[Thing], bed: Material, *, seed: int) -> World:
    """Prepare things on a bed for ray casting.

    Parameters
    ----------
    seed
        Of the surfaces' pattern.

    Raises
    ------
    SettingsError
        A mesh has no triangles, or coordinates that are not finite, or several things have a print.
    """
    triangles: list[FloatArray] = [np.empty((0, 3, 3))]
    colours: list[FloatArray] = [np.empty((0, 3, 3), dtype=np.float32)]
    owners: list[IntArray] = [np.empty(0, dtype=np.int32)]
    for number, thing in enumerate(things, 1):
        corners = np.asarray(thing.mesh.triangles, dtype=np.float64)
        if not len(corners) or not np.isfinite(corners).all():
            raise SettingsError(
                f"The simulated object {thing.name!r} has no usable surface: its mesh needs triangles with finite "
                f"coordinates, but it has {len(corners)} triangles."
            )
        triangles.append(corners)
        shape = (len(corners), 3, 3)
        own = thing.material.albedo if thing.colours is None else np.asarray(thing.colours)[thing.mesh.faces]
        colours.append(np.broadcast_to(np.asarray(own, dtype=np.float32), shape))
        owners.append(np.full(len(corners), number, dtype=np.int32))
    every = np.concatenate(triangles)
    normals = np.cross(every[:, 1] - every[:, 0], every[:, 2] - every[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    # A sliver without area has no normal and cannot be seen, nor can what lies flat on the bed: the large faces on
    # which things stand would only make the boxes of the tree overlap.
    solid = (lengths > 0) & (every[:, :, 2].max(axis=1) > _ON_BED_MM)
    every, normals = every[solid], normals[solid] / lengths[solid, np.newaxis]
    bvh = build_bvh(every)
    ordered = np.ascontiguousarray(normals[bvh.order])
    ceiling = build_ceiling(every)
    printed = [(number, thing.printed) for number, thing in enumerate(things, 1) if thing.printed is not None]
    if len(printed) > 1:
        raise SettingsError(f"Only one object of a simulated scene may have a print, not {len(printed)}.")
    return World(
        bvh=bvh,
        normals=ordered,
        owners=np.ascontiguousarray(np.concatenate(owners)[solid][bvh.order]),
        albedo=np.ascontiguousarray(np.concatenate(colours)[solid][bvh.order]),
        looks=np.array([(*m.albedo, m.grain) for m in (bed, *(t.material for t in things))], dtype=np.float64),
        texture=_pattern(np.random.default_rng([seed, 1])),
        ceiling=ceiling,
        room=bake_light(bvh, ordered, ceiling.highest_mm),
        print_owner=printed[0][0] if printed else 0,
        printed=printed[0][1] if printed else None,
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
