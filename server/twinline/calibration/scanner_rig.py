"""From an adjusted scanner to a rig: the same in the bed frame, with its covariance."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from twinline.arrays import BoolArray, FloatArray
from twinline.calibration.bundle import PARAMETERS as CAMERA
from twinline.calibration.joint_model import Scanner
from twinline.calibration.scanner import scanner_of_rig
from twinline.geometry.noise import NoiseModel
from twinline.geometry.rig import Covariance, Rig, Transform

_STEP_SDS = 0.01
_TOF = ("x", "y", "z", "beam_x", "beam_y", "slide_x", "slide_y", "slide_z", "gain", "lag")
_LEAST_SD = 1e-15
_HELD_CAMERA_SD = 1e-8


def make_rig(
    base: Rig, scanner: Scanner, covariance: FloatArray, sources: Mapping[str, str], noise: NoiseModel | None
) -> Rig:
    """The rig of an adjusted scanner.

    The bed frame's origin lies under the camera at cart position 0, its x axis along the travel; the ToF sensor is the
    base's where the scanner has none.

    Parameters
    ----------
    covariance : (p, p) array
        Of `Scanner.vector`.
    """
    tof = base.tof
    if scanner.tof is not None and base.tof is not None:
        tof = scanner.as_tof(base.tof.range_mm)
    axes = scanner.axes()
    old = scanner_of_rig(base)
    return replace(
        base,
        camera=base.camera if _same(old.camera, scanner.camera) else scanner.as_camera(),
        sheets=base.sheets if _same(old.sheets, scanner.sheets) else scanner.as_sheets(),
        bed_from_camera=Transform(axes, np.array([0.0, 0.0, scanner.height_mm()])),
        travel=axes @ scanner.travel,
        tof=tof,
        noise=noise,
        covariance=rig_covariance(scanner, covariance),
        sources=dict(sources),
        evidence={},
    )


def _same(old: FloatArray, new: FloatArray) -> bool:
    """Whether a part was not adjusted: then it keeps its bits."""
    return bool(np.allclose(old, new, rtol=1e-12, atol=1e-18))


def rig_covariance(scanner: Scanner, covariance: FloatArray) -> Covariance:
    """Covariance of the rig's parameters; those known exactly are left out."""
    names = _names(scanner)
    theta = scanner.vector()
    sd = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    middle = scanner.axes()
    jacobian = np.zeros((len(names), len(theta)))
    for i in np.flatnonzero(sd > 0):
        step = _STEP_SDS * sd[i]
        ends = []
        for sign in (1.0, -1.0):
            moved = theta.copy()
            moved[i] += sign * step
            ends.append(_rig_values(scanner.with_vector(moved), middle))
        jacobian[:, i] = (ends[0] - ends[1]) / (2.0 * step)
    matrix = jacobian @ covariance @ jacobian.T
    known = _inexact(names, matrix)
    matrix = matrix[np.ix_(known, known)]
    return Covariance(tuple(n for n, k in zip(names, known, strict=True) if k), (matrix + matrix.T) / 2)


def _inexact(names: tuple[str, ...], matrix: FloatArray) -> BoolArray:
    sd = np.sqrt(np.maximum(np.diagonal(matrix), 0.0))
    lens = np.array([name.startswith("camera.") for name in names])
    return np.asarray(sd > np.where(lens, _HELD_CAMERA_SD, _LEAST_SD))


def _names(scanner: Scanner) -> tuple[str, ...]:
    names = [f"camera.{n}" for n in CAMERA]
    names += [f"sheet{k + 1}.{n}" for k in range(len(scanner.sheets)) for n in "abc"]
    names += ["bed.rx", "bed.ry", "bed.rz", "bed.x", "bed.y", "bed.z", "travel.x", "travel.y", "travel.z"]
    if scanner.tof is not None:
        names += [f"tof.{n}" for n in _TOF]
    return tuple(names)


def _rig_values(scanner: Scanner, middle: FloatArray) -> FloatArray:
    """The rig's parameters in the order of `_names`; rotations against ``middle``."""
    axes = scanner.axes()
    turn = axes @ middle.T
    small = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    height = scanner.height_mm()
    parts = [scanner.camera, scanner.sheets.ravel(), small, np.array([0.0, 0.0, height]), axes @ scanner.travel]
    if scanner.tof is not None:
        t = scanner.tof
        beam = axes @ t.beam
        position = axes @ t.position + np.array([0.0, 0.0, height])
        parts += [position, beam[:2], axes @ t.slide, np.array([t.gain, t.lag_s])]
    return np.concatenate(parts)
