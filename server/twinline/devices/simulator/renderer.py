"""From a world, a machine and a cart position to the picture its camera takes."""

from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass

import numpy as np

from twinline.arrays import ByteArray, FloatArray, IntArray
from twinline.devices.simulator.baking import OPEN_BED_LIGHT
from twinline.devices.simulator.bvh import ray_stack
from twinline.devices.simulator.ceiling import CEILING_REACH_MM
from twinline.devices.simulator.develop import POOL_BITS, RoomPicture, develop, room_picture
from twinline.devices.simulator.laser_light import REACH_WIDTHS, laser_light
from twinline.devices.simulator.machine import SimulatedLaser, SimulatedRig
from twinline.devices.simulator.noise_table import frame_seeds, normal_pool, normal_table
from twinline.devices.simulator.room_cells import meet_nodes, sort_cells
from twinline.devices.simulator.room_light import fill_patches, soften_edges
from twinline.devices.simulator.sensor import Exposure, blur, blur_kernel
from twinline.devices.simulator.solids import TEXTURE_TEXELS
from twinline.devices.simulator.world import World
from twinline.errors import SettingsError

_CELL_PX = 4


@dataclass(frozen=True)
class RoomLight:
    """The light of the room.

    Attributes
    ----------
    level_dn : (float, float, float)
        Grey levels of blue, green and red of a white surface.
    """

    level_dn: tuple[float, float, float] = (36.0, 40.0, 42.0)


@dataclass(frozen=True, eq=False)
class _Beam:
    """What never changes about one laser's sheet as the camera sees it."""

    source_mm: FloatArray
    normal: FloatArray
    width_mm: float
    brightness_dn: float
    response: tuple[float, float, float]
    pixels: IntArray
    rays: FloatArray
    slack_mm: float


class Renderer:
    """Takes pictures; picklable, and free of state that one picture could leave behind for the next.

    Parameters
    ----------
    world
        Everything on the bed, and the bed.
    rig
        The machine; its image size is the pictures'.
    room
        Light that is there with the lasers off.
    seed
        Of all noise. The same seed, frame number and position give the same picture, in whatever order and process.

    Raises
    ------
    SettingsError
        The lens gives a pixel no ray, or a sheet is too thick for the world's ceiling.
    """

    def __init__(self, world: World, rig: SimulatedRig, room: RoomLight | None = None, *, seed: int = 0) -> None:
        self.world = world
        self.rig = rig
        self.room = room or RoomLight()
        self.seed = seed
        width, height = rig.image_size
        self._solids = world.solids()
        self._table = normal_table()
        self._pool = np.resize(normal_pool(1 << POOL_BITS, seed), (1 << POOL_BITS) + width)
        self._rotation = np.ascontiguousarray(rig.bed_from_camera)
        self._kernel = blur_kernel(rig.sensor.blur_px, widths=3.0).astype(np.float32)
        # The blur of an edge must end within the next cell.
        self._step = max(_CELL_PX, len(self._kernel) // 2)
        self._nodes = rig.lens.slopes(self._corners(width), self._corners(height))
        self._ground = self._bed_places(self._nodes)
        u, v = np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64)
        self._slopes_x = ((u - rig.lens.centre_px[0]) / rig.lens.focal_px[0]).astype(np.float32)
        self._slopes_y = ((v - rig.lens.centre_px[1]) / rig.lens.focal_px[1]).astype(np.float32)
        slopes = rig.lens.slopes(u, v)
        # Moved by whole repeats of the pattern so far that no texel is negative.
        texels = np.nan_to_num(self._bed_places(slopes)) / world.texel_mm
        repeats = np.ceil(-min(float(texels.min()), 0.0) / TEXTURE_TEXELS)
        self._texels = (texels + repeats * TEXTURE_TEXELS).astype(np.float32)
        self._beams = tuple(self._beam(laser, slopes) for laser in rig.lasers)
        self._colours = tuple(dict.fromkeys(beam.response for beam in self._beams))
        rows = [beam.pixels[:, 0] for beam in self._beams if len(beam.pixels)]
        # The blur spreads light over some rows more than those with rays.
        border = int(np.ceil(4 * max(rig.sensor.blur_px, 0.0)))
        self._first_row = max(min((int(r.min()) for r in rows), default=0) - border, 0)
        self._last_row = min(max((int(r.max()) + 1 for r in rows), default=0) + border, height)

    def _corners(self, pixels: int) -> FloatArray:
        """Places of the corners of the cells along one side of the picture."""
        cells = -(-pixels // self._step)
        return np.arange(cells + 1) * self._step - 0.5

    def _bed_places(self, slopes: FloatArray) -> FloatArray:
        """Where rays meet the bed, against the eye's foot point; NaN where they never do."""
        directions = np.concatenate([slopes, np.ones((*slopes.shape[:2], 1))], axis=-1) @ self._rotation.T
        with np.errstate(divide="ignore", invalid="ignore"):
            places = -self.rig.camera_height_mm * directions[..., :2] / directions[..., 2:]
        places[directions[..., 2] >= 0] = np.nan
        return np.ascontiguousarray(places)

    def _beam(self, laser: SimulatedLaser, slopes: FloatArray) -> _Beam:
        """Choose the pixels whose rays cross the sheet between the bed and the highest thing."""
        directions = np.concatenate([slopes, np.ones((*slopes.shape[:2], 1))], axis=-1) @ self._rotation.T
        normal, source = laser.normal, laser.source_mm
        response = laser.response or self.rig.sensor.laser_response
        approach = directions @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.where(approach != 0, (source @ normal) / approach, np.nan)
            crossing = self.rig.camera_height_mm + depth * directions[..., 2]
            along = REACH_WIDTHS * laser.width_mm / np.abs(approach)
        highest = self.world.ceiling.highest_mm
        steepest = np.abs(directions[..., 2])
        near = (depth > 0) & (crossing > -along * steepest) & (crossing < highest + along * steepest)
        aside = along * np.linalg.norm(directions[..., :2], axis=-1)
        widest, slack = (float(v[near].max(initial=0.0)) for v in (aside, along * steepest))
        if widest > CEILING_REACH_MM:
            raise SettingsError(
                f"The sheet of the simulated laser on side {laser.side} is too thick or too flat: its light reaches "
                f"{widest:.1f} mm along a camera ray, more than {CEILING_REACH_MM:g} mm; make width_mm smaller than "
                f"{laser.width_mm:g} or the angle steeper."
            )
        return _Beam(
            source_mm=source,
            normal=normal,
            width_mm=laser.width_mm,
            brightness_dn=laser.brightness_dn,
            response=response,
            pixels=np.argwhere(near).astype(np.int32),
            rays=np.ascontiguousarray(np.column_stack([slopes[near], depth[near]])),
            slack_mm=slack,
        )

    def _room_light(self, cart_mm: float) -> RoomPicture:
        eye, level = self.rig.eye_mm(cart_mm), np.array(self.room.level_dn)
        rows, columns = self._nodes.shape[:2]
        found = np.empty((rows, columns), dtype=np.int32)
        places = np.empty((rows, columns, 3))
        colours = np.empty((rows, columns, 3))
        light = np.empty((rows, columns))
        kinds = np.empty((rows - 1, columns - 1), dtype=np.int8)
        patch_of = np.empty((rows - 1, columns - 1), dtype=np.int32)
        stack = ray_stack()
        view = (self._rotation, eye)
        meet_nodes(self._solids, self._nodes, self._ground, *view, level, found, places, colours, light, stack)
        count = sort_cells(self._solids, self._nodes, *view, found, places, light, kinds, patch_of, stack)
        patches = np.empty((count, self._step, self._step, 3), dtype=np.float32)
        grid = np.empty((self._step + 1, self._step + 1, 4))
        fill_patches(
            self._solids, self._nodes, *view, level, found, places, colours, kinds, patch_of, patches, grid, stack
        )  # fmt: skip
        if len(self._kernel) > 1 and count:
            sharp, patches = patches, patches.copy()
            soften_edges(kinds, patch_of, sharp, self._kernel, patches)
        foot = np.mod(eye[:2] / self.world.texel_mm, TEXTURE_TEXELS).astype(np.float32)
        bed_dn = (level * self.world.looks[0, :3] * OPEN_BED_LIGHT).astype(np.float32)
        return RoomPicture(self._texels, foot, bed_dn, light, kinds, patch_of, patches)

    def room_dn(self, cart_mm: float) -> FloatArray:
        """Mean grey levels by the light of the room, (height, width, 3) float32, blue first, blurred."""
        width, height = self.rig.image_size
        picture = np.empty((height, width, 3), dtype=np.float32)
        room = self._room_light(cart_mm)
        room_picture(self._solids, room, np.empty((4, width), dtype=np.float32), picture)
        return picture

    def laser_dn(
        self,
        cart_mm: float,
        lasers: AbstractSet[int],
        *,
        speckle_seeds: IntArray | None = None,
        power: Mapping[int, float] | None = None,
    ) -> tuple[FloatArray, int]:
        """Light of the lasers after lens and pixels.

        Parameters
        ----------
        lasers
            Numbers of those that are on, from 1.
        speckle_seeds : (2,) array of uint64
            None for light without speckle.
        power
            Share of its light that a laser gives, by its number; 1 for those not named.

        Returns
        -------
        (colours, rows, width) array of float32 and int
            Mean grey levels of each colour of laser in its strongest channel, and the row of the picture at which they
            start.
        """
        eye = self.rig.eye_mm(cart_mm)
        bands = np.zeros((len(self._colours), self._last_row - self._first_row, self.rig.image_size[0]), np.float32)
        for number, beam in enumerate(self._beams, 1):
            share = 1.0 if power is None else power.get(number, 1.0)
            if number not in lasers or not share > 0:
                continue
            sigma = 0.0 if speckle_seeds is None else self.rig.sensor.speckle_sigma
            seed = 1 if speckle_seeds is None else int(speckle_seeds[number - 1])
            laser_light(
                beam.pixels, beam.rays, self._first_row, self._rotation, eye, eye + beam.source_mm, beam.normal,
                beam.width_mm, share * beam.brightness_dn, int(np.argmax(beam.response)), sigma, seed, self._table,
                self._solids, beam.slack_mm, ray_stack(),
                bands[self._colours.index(beam.response)],
            )  # fmt: skip
        return np.stack([blur(band, self.rig.sensor.blur_px) for band in bands]), self._first_row

    def render(
        self,
        frame: int,
        cart_mm: float,
        lasers: AbstractSet[int] = frozenset({1, 2}),
        *,
        exposure: Exposure | None = None,
        power: Mapping[int, float] | None = None,
    ) -> ByteArray:
        """Take one picture.

        Parameters
        ----------
        frame
            Number that its noise belongs to.
        cart_mm
            Commanded position of the cart.
        lasers
            Numbers of the lasers that are on, from 1.
        exposure
            What the camera's controls make of it.
        power
            Share of its light that a laser gives, by its number; 1 for those not named.

        Returns
        -------
        (height, width, 3) array of uint8
            Blue, green, red.
        """
        sensor, setting = self.rig.sensor, exposure or Exposure()
        seeds = frame_seeds(self.seed, frame, 3)
        bands, first_row = self.laser_dn(cart_mm, lasers, speckle_seeds=seeds[1:], power=power)
        room = self._room_light(cart_mm)
        width, height = self.rig.image_size
        picture = np.empty((height, width, 3), dtype=np.uint8)
        develop(
            self._solids, room, bands, first_row,
            np.array(self._colours), self._slopes_x, self._slopes_y, sensor.falloff, setting.time * setting.gain,
            sensor.read_dn * setting.gain, setting.gain / sensor.electrons_per_dn, int(seeds[0]), self._pool,
            np.empty((5, width), dtype=np.float32), np.empty(3, dtype=np.int64), picture,
        )  # fmt: skip
        return picture
