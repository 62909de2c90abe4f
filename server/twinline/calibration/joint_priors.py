"""What is known of a scanner before its joint adjustment, as normal distributions.

A calibrated camera and a measured travel enter with the covariance of their own calibration; the rest with what a ruler
and a data sheet are worth. A prior never replaces an observation: it holds the directions that none of them sees, and
the evidence names those.
"""

import numpy as np

from twinline.arrays import BoolArray, FloatArray
from twinline.calibration.bundle import PARAMETERS as CAMERA
from twinline.calibration.intrinsics import IntrinsicsResult
from twinline.calibration.joint_model import Scanner
from twinline.calibration.joint_types import Prior
from twinline.calibration.travel import TravelResult
from twinline.geometry.rig import Covariance

FOCAL_SHARE = 0.015
CENTRE_SHARE = 0.015
LENS_SD = (0.1, 0.1, 0.001, 0.001, 1e-9)
TRAVEL_ANGLE_RAD = 0.02
TRAVEL_SHARE = 0.006
BED_ANGLE_RAD = 0.02
BED_SHARE = 0.015
BASELINE_MM = 6.0
SHEET_ANGLE_RAD = 0.1
SHEET_YAW_RAD = 0.03
TOF_PLACE_MM = 8.0
TOF_TILT_RAD = 0.015
TOF_FOUND_MM = 0.4
SLIDE_ANGLE_RAD = 0.02
SLIDE_SHARE = 0.003
TOF_GAIN_SHARE = 0.001
"""The data sheet calls the sensor linear; its slope is the only length that a scan without a board knows."""
TOF_LAG_S = 0.02

_EXACT = 1e-9


def camera_prior(scanner: Scanner, result: IntrinsicsResult | None, known: Covariance | None = None) -> Prior:
    """The camera by its own calibration, else by a covariance kept with a rig, else by its data sheet."""
    information = np.zeros((9, 9))
    covariance = result.covariance if result is not None else known
    names = [f"camera.{name}" for name in CAMERA]
    if covariance is not None and any(name in covariance.names for name in names):
        here = [i for i, name in enumerate(names) if name in covariance.names]
        there = [covariance.names.index(names[i]) for i in here]
        information[np.ix_(here, here)] = inverse_information(covariance.matrix[np.ix_(there, there)])
        for i in set(range(9)) - set(here):
            information[i, i] = 1.0 / _EXACT**2
    else:
        focal, centre = FOCAL_SHARE * scanner.camera[0], CENTRE_SHARE * scanner.size[0]
        information = np.diag(1.0 / np.array([focal, focal, centre, centre, *LENS_SD]) ** 2)
        # Pixels are square to a few parts in a thousand, whatever the focal length is.
        both = np.zeros(9)
        both[:2] = 1.0, -1.0
        information += np.outer(both, both) / (0.002 * scanner.camera[0]) ** 2
    return Prior(np.arange(9), scanner.camera.copy(), information)


def motion_prior(scanner: Scanner, result: TravelResult | None) -> Prior:
    """Travel and bed by the board in motion/, else nominal."""
    index = np.arange(9, 15)
    values = np.concatenate([scanner.travel, scanner.bed])
    if result is not None:
        return Prior(
            index, values, inverse_information(result.matrix), np.arange(9), scanner.camera.copy(), result.by_camera
        )
    information = np.zeros((6, 6))
    information[:3, :3] = _direction(scanner.travel, TRAVEL_ANGLE_RAD, TRAVEL_SHARE)
    information[3:, 3:] = _direction(scanner.bed, BED_ANGLE_RAD, BED_SHARE)
    return Prior(index, values, information)


def sheet_priors(scanner: Scanner, nominal: FloatArray) -> list[Prior]:
    """The lasers as built: baseline, angle and yaw of a ruler and a protractor.

    Parameters
    ----------
    nominal : (lasers, 3) array
        Inverse-depth parameters.
    """
    priors = []
    for k, m in enumerate(nominal):
        across = 1 if scanner.stripe_runs == "along-u" else 0
        along = 1 - across
        slope = abs(float(m[across])) + 1e-9
        sd = np.empty(3)
        sd[across] = BASELINE_MM * slope**2
        sd[along] = SHEET_YAW_RAD * float(np.linalg.norm(m))
        sd[2] = SHEET_ANGLE_RAD * (1.0 + (float(m[2]) / slope) ** 2) * slope
        priors.append(Prior(np.arange(15 + 3 * k, 18 + 3 * k), m.copy(), np.diag(1.0 / sd**2)))
    return priors


def tof_priors(scanner: Scanner, nominal: Scanner) -> list[Prior]:
    """The ToF sensor's mount by a ruler, its slope by the data sheet.

    Parameters
    ----------
    nominal
        Scanner whose ToF part is as built.
    """
    if nominal.tof is None:
        return []
    tof = nominal.tof
    start = 15 + 3 * len(scanner.sheets)
    return [
        Prior(np.arange(start, start + 3), tof.position, np.eye(3) / TOF_PLACE_MM**2),
        Prior(np.arange(start + 3, start + 5), np.zeros(2), np.eye(2) / TOF_TILT_RAD**2),
        Prior(np.arange(start + 5, start + 8), tof.slide, _direction(tof.slide, SLIDE_ANGLE_RAD, SLIDE_SHARE)),
        Prior(np.array([start + 8]), np.array([tof.gain]), np.eye(1) / (TOF_GAIN_SHARE * tof.gain) ** 2),
        Prior(np.array([start + 9]), np.array([tof.lag_s]), np.eye(1) / TOF_LAG_S**2),
    ]


def tof_place_prior(scanner: Scanner, distance_mm: float) -> Prior:
    """The ToF sensor where a search has laid its readings over the lasers' height map.

    The search places the beam's end, so the sensor itself may move as far as its beam tilts.

    Parameters
    ----------
    distance_mm
        Usual distance from the sensor to what it measured.
    """
    assert scanner.tof is not None
    tof = scanner.tof
    start = 15 + 3 * len(scanner.sheets)
    axes = scanner.axes()
    loose = np.diag(1.0 / np.array([TOF_FOUND_MM, TOF_FOUND_MM, 100.0]) ** 2)
    return Prior(
        np.arange(start, start + 3),
        tof.position.copy(),
        axes.T @ loose @ axes,
        np.arange(start + 3, start + 5),
        tof.tilt.copy(),
        -distance_mm * tof.beam_axes[:2].T,
    )


def free_parameters(scanner: Scanner, parts: frozenset[str]) -> BoolArray:
    """Which parameters an adjustment of the named parts may move.

    The bed always may: it belongs to no instrument. k3 may only where a lens model has it.
    """
    free = []
    for name in scanner.names():
        part = name.split(".")[0].rstrip("12")
        free.append(part == "bed" or (part == "sheet" and "sheets" in parts) or part in parts)
    out = np.array(free)
    out[8] &= scanner.camera[8] != 0.0
    if scanner.tof is not None and scanner.tof.lag_s <= 0.0:
        out[-1] = False
    return out


def _direction(vector: FloatArray, angle_rad: float, share: float) -> FloatArray:
    """Information on a vector known to an angle in direction and to a share in length."""
    length = float(np.linalg.norm(vector))
    unit = vector / length
    along = np.outer(unit, unit)
    return np.asarray(along / (share * length) ** 2 + (np.eye(3) - along) / (angle_rad * length) ** 2)


def nominal_covariance(scanner: Scanner, nominal: Scanner) -> FloatArray:
    """What a ruler and a data sheet know of every parameter, (p, p).

    Parameters
    ----------
    nominal
        The scanner as built, under the bed pose of ``scanner``.
    """
    priors = [camera_prior(nominal, None), motion_prior(nominal, None), *sheet_priors(nominal, nominal.sheets)]
    if scanner.tof is not None:
        priors += tof_priors(scanner, nominal)
    theta = scanner.vector()
    information = np.zeros((len(theta), len(theta)))
    for prior in priors:
        design = prior.rows(theta)[1]
        information += design.T @ design
    return inverse_information(information)


def inverse_information(covariance: FloatArray) -> FloatArray:
    """Inverse of a symmetric positive matrix whose rows differ by many orders of magnitude."""
    scale = np.sqrt(np.diagonal(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    inverse = (vectors / np.maximum(values, 1e-12)) @ vectors.T / np.outer(scale, scale)
    return np.asarray((inverse + inverse.T) / 2)
