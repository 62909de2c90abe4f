"""The machine as it really is: a camera, lasers and a cart that are all a little out of true.

What the owner of such a machine would know of it stands beside what is true, and only the former reaches a capture's
``capture.json``.
"""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from twinline.arrays import FloatArray
from twinline.devices.simulator.lens import Lens
from twinline.devices.simulator.sensor import Sensor
from twinline.devices.simulator.tof_beam import SimulatedTofMount
from twinline.devices.simulator.turns import turn_deg
from twinline.errors import SettingsError

__all__ = ["Side", "SimulatedLaser", "SimulatedRig", "StripeRuns", "ideal_rig", "turn_deg"]

StripeRuns = Literal["along-u", "along-v"]
Side = Literal["+u", "-u", "+v", "-v"]


@dataclass(frozen=True)
class SimulatedLaser:
    """One line laser on the cart.

    Attributes
    ----------
    side
        Side of the image towards which the laser stands. "+v" and "+u" are ahead of the camera, the others behind.
    known_baseline_mm, known_angle_deg
        What the owner believes: distance from the camera along the travel, and angle of the sheet to that line.
    baseline_error_mm, angle_error_deg
        What is to be added for the truth.
    yaw_deg
        Turn of the sheet about the vertical.
    roll_deg
        Turn of the sheet about its own line of steepest descent, before the yaw; it slants the stripe.
    aside_mm, above_mm
        Place of the light's origin against the camera centre, across the travel and upwards.
    width_mm
        Standard deviation of the light across the sheet.
    brightness_dn
        Grey levels of a white surface that faces the laser 400 mm away.
    response : (float, float, float)
        Grey levels of blue, green and red for one grey level of its light, the highest of them 1: its colour. None
        takes the sensor's own, which is for red light.
    """

    side: Side
    known_baseline_mm: float
    known_angle_deg: float
    baseline_error_mm: float = 0.0
    angle_error_deg: float = 0.0
    yaw_deg: float = 0.0
    roll_deg: float = 0.0
    aside_mm: float = 0.0
    above_mm: float = 0.0
    width_mm: float = 0.45
    brightness_dn: float = 340.0
    response: tuple[float, float, float] | None = None

    @property
    def ahead(self) -> float:
        """+1 for a laser ahead of the camera, -1 for one behind it."""
        return 1.0 if self.side[0] == "+" else -1.0

    @property
    def source_mm(self) -> FloatArray:
        """(3,) origin of the light against the camera centre, on the bed's axes, mm.

        The baseline is stated at the camera's height, so a laser that hangs higher or lower stands where its sheet is.
        """
        angle = np.radians(self.known_angle_deg + self.angle_error_deg)
        baseline = self.known_baseline_mm + self.baseline_error_mm
        return np.array([self.ahead * (baseline + self.above_mm / np.tan(angle)), self.aside_mm, self.above_mm])

    @property
    def normal(self) -> FloatArray:
        """(3,) unit normal of the sheet on the bed's axes."""
        angle = np.radians(self.known_angle_deg + self.angle_error_deg)
        fall = np.array([-self.ahead * np.cos(angle), 0.0, -np.sin(angle)])
        line = turn_deg(fall, self.roll_deg) @ turn_deg(np.array([0.0, 0.0, 1.0]), self.yaw_deg) @ [0.0, 1.0, 0.0]
        normal = np.cross(fall, line)
        return np.asarray(normal / np.linalg.norm(normal))


@dataclass(frozen=True)
class SimulatedRig:
    """The whole machine.

    The bed frame has x along the intended travel, y across, z up and z = 0 on the bed; the camera centre is above its
    origin while the cart stands at 0.

    Attributes
    ----------
    image_size : (int, int)
        Width and height in pixels. The lens is given for this size.
    camera_height_mm, known_camera_height_mm
        Height of the camera centre above the bed: the truth, and what the owner measured.
    tilt_deg : (float, float, float)
        Small turn of the camera about its own x, y and z axes.
    known_focal_px
        Focal length the owner would guess from the data sheet.
    travel_yaw_deg, travel_scale
        Direction of the real travel in the bed's plane, and real millimetres per commanded one.
    tof
        The point distance sensor; None for a machine without one.
    """

    image_size: tuple[int, int] = (1280, 720)
    stripe_runs: StripeRuns = "along-u"
    lens: Lens = field(
        default_factory=lambda: Lens(
            focal_px=(1034.6, 1033.9),
            centre_px=(648.5, 363.6),
            radial=(-0.112, 0.061, 0.0),
            tangential=(0.0006, -0.0004),
        )
    )
    camera_height_mm: float = 431.3
    known_camera_height_mm: float = 430.0
    tilt_deg: tuple[float, float, float] = (0.42, -0.55, 0.35)
    known_focal_px: float = 1030.0
    lasers: tuple[SimulatedLaser, ...] = field(
        default_factory=lambda: (
            SimulatedLaser("+v", 251.5, 65.5, 0.13, 0.2536, yaw_deg=0.4, roll_deg=0.5, aside_mm=1.5, above_mm=2.0),
            SimulatedLaser("-v", 251.5, 62.5, -0.02, -0.0101, yaw_deg=-0.3, roll_deg=0.4, aside_mm=-2.0, above_mm=-1.0),
        )
    )
    travel_yaw_deg: float = 0.6
    travel_scale: float = 1.0053
    sensor: Sensor = field(default_factory=Sensor)
    tof: SimulatedTofMount | None = field(default_factory=SimulatedTofMount)

    def __post_init__(self) -> None:
        if min(self.image_size) < 16 or self.camera_height_mm <= 0:
            raise SettingsError(
                f"The simulated camera needs at least 16 x 16 pixels and a height above 0 mm, not "
                f"{self.image_size[0]} x {self.image_size[1]} pixels at {self.camera_height_mm} mm."
            )
        axis = "v" if self.stripe_runs == "along-u" else "u"
        sides = [laser.side for laser in self.lasers]
        if not 1 <= len(sides) <= 2 or len(set(sides)) != len(sides) or any(side[1] != axis for side in sides):
            raise SettingsError(
                f"A simulated machine whose stripes run {self.stripe_runs} needs one or two lasers on the sides "
                f"+{axis} and -{axis}, not {', '.join(sides) or 'none'}."
            )

    @property
    def bed_from_camera(self) -> FloatArray:
        """(3, 3) rotation from the camera's axes to the bed's."""
        if self.stripe_runs == "along-u":
            upright = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
        else:
            upright = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
        x, y, z = np.eye(3)
        about_x, about_y, about_z = self.tilt_deg
        return np.asarray(upright @ turn_deg(z, about_z) @ turn_deg(y, about_y) @ turn_deg(x, about_x))

    @property
    def travel(self) -> FloatArray:
        """(3,) real movement in the bed frame per commanded millimetre."""
        yaw = np.radians(self.travel_yaw_deg)
        return np.asarray(self.travel_scale * np.array([np.cos(yaw), np.sin(yaw), 0.0]))

    def eye_mm(self, cart_mm: float) -> FloatArray:
        """(3,) camera centre in the bed frame while the cart stands at a commanded position."""
        return np.asarray(np.array([0.0, 0.0, self.camera_height_mm]) + self.travel * cart_mm)

    def cropped(self, image_size: tuple[int, int]) -> "SimulatedRig":
        """The same machine reading out only the middle of its sensor (or more than it, at the same pixel size)."""
        left = (self.image_size[0] - image_size[0]) // 2
        top = (self.image_size[1] - image_size[1]) // 2
        lens = Lens(
            self.lens.focal_px,
            (self.lens.centre_px[0] - left, self.lens.centre_px[1] - top),
            self.lens.radial,
            self.lens.tangential,
        )
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return SimulatedRig(**{**values, "image_size": image_size, "lens": lens})


def ideal_rig() -> SimulatedRig:
    """A machine exactly as its owner believes it to be: no tilt, no distortion, no error anywhere."""
    truth = SimulatedRig()
    width, height = truth.image_size
    return SimulatedRig(
        lens=Lens((truth.known_focal_px, truth.known_focal_px), ((width - 1) / 2, (height - 1) / 2)),
        camera_height_mm=truth.known_camera_height_mm,
        tilt_deg=(0.0, 0.0, 0.0),
        lasers=tuple(
            SimulatedLaser(laser.side, laser.known_baseline_mm, laser.known_angle_deg) for laser in truth.lasers
        ),
        travel_yaw_deg=0.0,
        travel_scale=1.0,
    )
