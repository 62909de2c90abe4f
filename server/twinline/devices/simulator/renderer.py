"""From a world, a machine and a cart position to the picture its camera takes."""

from collections.abc import Set as AbstractSet
from dataclasses import dataclass

import cv2
import numpy as np

from twinline.arrays import ByteArray, FloatArray, IntArray
from twinline.devices.simulator.light import REACH_WIDTHS, laser_light, room_light
from twinline.devices.simulator.machine import SimulatedLaser, SimulatedRig
from twinline.devices.simulator.noise_table import frame_seeds, normal_table
from twinline.devices.simulator.sensor import blur
from twinline.devices.simulator.world import CEILING_REACH_MM, World
from twinline.errors import SettingsError

_LAMP = np.array([0.28, -0.36, 0.89]) / np.linalg.norm([0.28, -0.36, 0.89])
_LAMP_SHARE = 0.5


@dataclass(frozen=True)
class RoomLight:
    """The light of the room.

    Attributes
    ----------
    level_dn : (float, float, float)
        Grey levels of blue, green and red of a white surface.
    step_px
        Rays are cast for every such pixel only, and the picture between them is interpolated. It shows in the room's
        dim light alone; the lasers' light has a ray for every pixel.
    """

    level_dn: tuple[float, float, float] = (36.0, 40.0, 42.0)
    step_px: int = 2


@dataclass(frozen=True, eq=False)
class _Beam:
    """What never changes about one laser's sheet as the camera sees it."""

    source_mm: FloatArray
    normal: FloatArray
    width_mm: float
    brightness_dn: float
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
        self._table = normal_table()
        self._rotation = np.ascontiguousarray(rig.bed_from_camera)
        step = self.room.step_px
        middle = (step - 1) / 2
        self._room_slopes = rig.lens.slopes(np.arange(0, width, step) + middle, np.arange(0, height, step) + middle)
        slopes = rig.lens.slopes(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
        self._beams = tuple(self._beam(laser, slopes) for laser in rig.lasers)
        rows = [beam.pixels[:, 0] for beam in self._beams if len(beam.pixels)]
        # The blur spreads light over some rows more than those with rays.
        border = int(np.ceil(4 * max(rig.sensor.blur_px, 0.0)))
        self._first_row = max(min((int(r.min()) for r in rows), default=0) - border, 0)
        self._last_row = min(max((int(r.max()) + 1 for r in rows), default=0) + border, height)

    def _beam(self, laser: SimulatedLaser, slopes: FloatArray) -> _Beam:
        """Choose the pixels whose rays cross the sheet between the bed and the highest thing."""
        directions = np.concatenate([slopes, np.ones((*slopes.shape[:2], 1))], axis=-1) @ self._rotation.T
        normal, source = laser.normal, laser.source_mm
        approach = directions @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.where(approach != 0, (source @ normal) / approach, np.nan)
            crossing = self.rig.camera_height_mm + depth * directions[..., 2]
            along = REACH_WIDTHS * laser.width_mm / np.abs(approach)
        highest = self.world.ceiling.highest_mm
        steepest = np.abs(directions[..., 2])
        near = (depth > 0) & (crossing > -along * steepest) & (crossing < highest + along * steepest)
        if not near.any():
            return _Beam(source, normal, laser.width_mm, laser.brightness_dn, np.empty((0, 2), np.int32),
                         np.empty((0, 3)), 0.0)  # fmt: skip
        aside = float((along * np.linalg.norm(directions[..., :2], axis=-1))[near].max())
        if aside > CEILING_REACH_MM:
            raise SettingsError(
                f"The sheet of the simulated laser on side {laser.side} is too thick or too flat: its light reaches "
                f"{aside:.1f} mm along a camera ray, more than {CEILING_REACH_MM:g} mm; make width_mm smaller than "
                f"{laser.width_mm:g} or the angle steeper."
            )
        return _Beam(
            source_mm=source,
            normal=normal,
            width_mm=laser.width_mm,
            brightness_dn=laser.brightness_dn,
            pixels=np.argwhere(near).astype(np.int32),
            rays=np.ascontiguousarray(np.column_stack([slopes[near], depth[near]])),
            slack_mm=float((along * steepest)[near].max()),
        )

    def room_dn(self, cart_mm: float) -> FloatArray:
        """Mean grey levels by the light of the room, (height, width, 3) float32, blue first, blurred."""
        width, height = self.rig.image_size
        world = self.world
        picture = np.empty((*self._room_slopes.shape[:2], 3), dtype=np.float32)
        if not any(self.room.level_dn):
            return np.zeros((height, width, 3), dtype=np.float32)
        room_light(
            self._room_slopes, self._rotation, self.rig.eye_mm(cart_mm), world.bvh.corners, world.bvh.bounds,
            world.bvh.links, world.normals, world.materials, world.looks, world.texture, world.texel_mm,
            _LAMP, _LAMP_SHARE, np.array(self.room.level_dn), picture,
        )  # fmt: skip
        step = self.room.step_px
        picture = np.asarray(blur(picture, self.rig.sensor.blur_px / step))
        if step == 1:
            return picture
        rows, columns = picture.shape[:2]
        full = cv2.resize(picture, (columns * step, rows * step), interpolation=cv2.INTER_LINEAR)
        return np.asarray(full[:height, :width])

    def laser_dn(
        self, cart_mm: float, lasers: AbstractSet[int], *, speckle_seeds: IntArray | None = None
    ) -> tuple[FloatArray, int]:
        """Light of the lasers after lens and pixels.

        Parameters
        ----------
        lasers
            Numbers of those that are on, from 1.
        speckle_seeds : (2,) array of uint64
            None for light without speckle.

        Returns
        -------
        (rows, width) array of float32 and int
            Mean grey levels of the red channel, and the row of the picture at which they start.
        """
        eye = self.rig.eye_mm(cart_mm)
        world, ceiling = self.world, self.world.ceiling
        band = np.zeros((self._last_row - self._first_row, self.rig.image_size[0]), dtype=np.float32)
        for number, beam in enumerate(self._beams, 1):
            if number not in lasers:
                continue
            sigma = 0.0 if speckle_seeds is None else self.rig.sensor.speckle_sigma
            seed = 1 if speckle_seeds is None else int(speckle_seeds[number - 1])
            laser_light(
                beam.pixels, beam.rays, self._first_row, self._rotation, eye, eye + beam.source_mm, beam.normal,
                beam.width_mm, beam.brightness_dn, sigma, seed, self._table, world.bvh.corners, world.bvh.bounds,
                world.bvh.links, world.normals, world.materials, world.looks, world.texture, world.texel_mm,
                ceiling.heights_mm, *ceiling.origin_mm, ceiling.cell_mm, beam.slack_mm, band,
            )  # fmt: skip
        return blur(band, self.rig.sensor.blur_px), self._first_row

    def render(self, frame: int, cart_mm: float, lasers: AbstractSet[int] = frozenset({1, 2})) -> ByteArray:
        """Take one picture.

        Parameters
        ----------
        frame
            Number that its noise belongs to.
        cart_mm
            Commanded position of the cart.
        lasers
            Numbers of the lasers that are on, from 1.

        Returns
        -------
        (height, width, 3) array of uint8
            Blue, green, red.
        """
        seeds = frame_seeds(self.seed, frame, 3)
        band, first_row = self.laser_dn(cart_mm, lasers, speckle_seeds=seeds[1:])
        return self.rig.sensor.expose(self.room_dn(cart_mm), band, first_row, int(seeds[0]), self._table)
