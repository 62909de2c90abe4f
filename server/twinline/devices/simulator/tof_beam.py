"""The spot of the point distance sensor: where the machine really holds it, and how far its light travels."""

from dataclasses import dataclass

import numpy as np

from twinline.arrays import FloatArray
from twinline.devices.simulator.bvh import ray_stack
from twinline.devices.simulator.compiled import loop
from twinline.devices.simulator.raycast import cast
from twinline.devices.simulator.turns import turn_deg
from twinline.devices.simulator.world import World

_RING_RAYS = 6


@dataclass(frozen=True)
class SimulatedTofMount:
    """Place of the sensor on its slide, as it is and as the owner knows it.

    Attributes
    ----------
    place_mm, known_mm : (float, float, float)
        Sensor while the slide stands at 0, against the camera's foot point on the bed (x along the travel, y across,
        z above the bed): the truth, and what a ruler gave.
    tilt_deg : (float, float)
        Turn of the beam, which points down, about x and then about y.
    slide_yaw_deg, slide_scale
        Turn of the slide's direction from y about the vertical, and real millimetres per commanded one.
    slide_range_mm : (float, float)
        Positions of the limit switches.
    spot_radius_mm
        Radius of the spot; the sensor sees the mean over it.
    """

    place_mm: tuple[float, float, float] = (-104.0, -98.5, 136.6)
    known_mm: tuple[float, float, float] = (-105.0, -100.0, 136.0)
    tilt_deg: tuple[float, float] = (-0.4, 0.5)
    slide_yaw_deg: float = -0.6
    slide_scale: float = 1.0
    slide_range_mm: tuple[float, float] = (0.0, 200.0)
    spot_radius_mm: float = 0.3

    @property
    def beam(self) -> FloatArray:
        """(3,) unit direction of the light on the bed's axes."""
        x, y, _ = np.eye(3)
        return np.asarray(turn_deg(y, self.tilt_deg[1]) @ turn_deg(x, self.tilt_deg[0]) @ [0.0, 0.0, -1.0])

    @property
    def slide(self) -> FloatArray:
        """(3,) real movement on the bed's axes per commanded millimetre of the slide."""
        yaw = np.radians(self.slide_yaw_deg)
        return np.asarray(self.slide_scale * np.array([-np.sin(yaw), np.cos(yaw), 0.0]))

    @property
    def spot_mm(self) -> FloatArray:
        """(rays, 3) origins of the rays that stand for the spot, against its middle, square to the beam."""
        beam = self.beam
        across = np.cross(beam, (0.0, 1.0, 0.0))
        across /= np.linalg.norm(across)
        along = np.cross(beam, across)
        # One ray in the middle and a ring of six at this radius have an even disc's second moment, radius^2 / 4.
        ring = self.spot_radius_mm * np.sqrt((_RING_RAYS + 1) / (2 * _RING_RAYS))
        angles = 2 * np.pi * np.arange(_RING_RAYS) / _RING_RAYS
        places = ring * (np.cos(angles)[:, np.newaxis] * across + np.sin(angles)[:, np.newaxis] * along)
        return np.concatenate([np.zeros((1, 3)), places])


def true_distances_mm(
    world: World, mount: SimulatedTofMount, travel: FloatArray, cart_mm: FloatArray, slide_mm: FloatArray
) -> FloatArray:
    """Distance to the nearest surface, mean over the spot.

    Parameters
    ----------
    travel : (3,) array
        Real movement of the cart per commanded millimetre, bed frame.
    cart_mm, slide_mm : (n,) arrays
        Where cart and slide stand.

    Returns
    -------
    (n,) array
        Millimetres from the sensor; infinity where a ray of the spot meets nothing.
    """
    cart = np.ascontiguousarray(cart_mm, dtype=np.float64)
    slide = np.ascontiguousarray(slide_mm, dtype=np.float64)
    answer = np.empty(len(cart))
    _spot_means(
        np.array(mount.place_mm), np.ascontiguousarray(travel), np.ascontiguousarray(mount.slide), mount.beam,
        mount.spot_mm, cart, slide, world.bvh.corners, world.bvh.nodes,
        ray_stack(), answer,
    )  # fmt: skip
    return answer


@loop
def _spot_means(
    place: FloatArray,
    travel: FloatArray,
    slide: FloatArray,
    beam: FloatArray,
    spot: FloatArray,
    cart_mm: FloatArray,
    slide_mm: FloatArray,
    corners: FloatArray,
    nodes: FloatArray,
    stack: FloatArray,
    answer: FloatArray,
) -> None:  # pragma: no cover - compiled
    for i in range(cart_mm.size):
        total = 0.0
        for k in range(spot.shape[0]):
            x = place[0] + travel[0] * cart_mm[i] + slide[0] * slide_mm[i] + spot[k, 0]
            y = place[1] + travel[1] * cart_mm[i] + slide[1] * slide_mm[i] + spot[k, 1]
            z = place[2] + travel[2] * cart_mm[i] + slide[2] * slide_mm[i] + spot[k, 2]
            ground = -z / beam[2] if beam[2] < 0.0 else np.inf
            reach, _ = cast(x, y, z, beam[0], beam[1], beam[2], 0.0, ground, False, corners, nodes, stack)
            total += reach
        answer[i] = total / spot.shape[0]
