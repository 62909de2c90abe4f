"""Photographs of a calibration board held or laid under the camera, for captures that are made at leisure.

Each pixel is the mean over rays through it, which meet the board's plane or the bed behind it.
"""

import numpy as np

from twinline.arrays import ByteArray, FloatArray
from twinline.calibration.board import Board
from twinline.devices.simulator.baking import LAMP, LAMP_SHARE, OPEN_BED_LIGHT
from twinline.devices.simulator.board_print import printed_face
from twinline.devices.simulator.compiled import loop
from twinline.devices.simulator.machine import SimulatedRig
from twinline.devices.simulator.sensor import blur
from twinline.devices.simulator.world import Material

_SUBPIXELS = 4
_TEXEL_MM = 0.05


class BoardViews:
    """Photographs one board with one machine's camera.

    Parameters
    ----------
    bed
        What is behind the board.
    level_dn : (float, float, float)
        Grey levels of blue, green and red of a white surface that faces the lamp.
    """

    def __init__(
        self, board: Board, rig: SimulatedRig, bed: Material, level_dn: tuple[float, float, float], *, seed: int
    ) -> None:
        self._rig = rig
        self._seed = seed
        self._face, first = printed_face(board, _TEXEL_MM)
        self._first = np.array(first)
        self._board = board
        width, height = rig.image_size
        self._corners = rig.lens.slopes(np.arange(width + 1) - 0.5, np.arange(height + 1) - 0.5)
        self._level = np.array(level_dn)
        self._bed = bed

    def middle_mm(self) -> FloatArray:
        """(3,) middle of the board's points in its own frame."""
        return np.asarray(self._board.points_mm().mean(axis=0))

    def photograph(self, number: int, camera_from_board: FloatArray, origin_mm: FloatArray) -> ByteArray:
        """Take a picture.

        Parameters
        ----------
        number
            That its noise belongs to.
        camera_from_board : (3, 3) array
            Rotation; the board's z axis points into it.
        origin_mm : (3,) array
            The board's origin in the camera frame.

        Returns
        -------
        (height, width, 3) array of uint8
            Blue, green, red.
        """
        rig, sensor = self._rig, self._rig.sensor
        width, height = rig.image_size
        lamp = np.array(LAMP) / np.linalg.norm(LAMP)
        facing = max(float(lamp @ (rig.bed_from_camera @ -camera_from_board[:, 2])), 0.0)
        share = np.empty((height, width), dtype=np.float32)
        paper = np.empty((height, width), dtype=np.float32)
        _cover(
            self._corners, np.ascontiguousarray(camera_from_board.T), camera_from_board.T @ origin_mm, self._face,
            self._first, _TEXEL_MM, share, paper,
        )  # fmt: skip
        light = 1.0 - LAMP_SHARE + LAMP_SHARE * facing
        bed = np.array(self._bed.albedo) * OPEN_BED_LIGHT
        mean = light * share[..., np.newaxis] + (1.0 - paper[..., np.newaxis]) * bed
        mean = blur((mean * self._level).astype(np.float32), sensor.blur_px)
        noise = np.random.default_rng([self._seed, 3, number]).standard_normal(mean.shape, dtype=np.float32)
        noisy = mean + noise * np.sqrt(sensor.read_dn**2 + mean / sensor.electrons_per_dn)
        return np.asarray(np.clip(np.rint(noisy), 0, 255), dtype=np.uint8)


@loop
def _cover(
    corners: FloatArray,
    board_from_camera: FloatArray,
    origin: FloatArray,
    face: FloatArray,
    first: FloatArray,
    texel_mm: float,
    share: FloatArray,
    paper: FloatArray,
) -> None:  # pragma: no cover - compiled
    """Find how much of each pixel the board covers (``paper``) and how much light its print gives back (``share``).

    ``corners`` are the slopes of the rays through the corners of the pixels, ``origin`` the board's origin against the
    eye in the board's frame.
    """
    turn = board_from_camera
    for row in range(share.shape[0]):
        for column in range(share.shape[1]):
            total, hits = 0.0, 0
            for n in range(_SUBPIXELS * _SUBPIXELS):
                p, q = (n // _SUBPIXELS + 0.5) / _SUBPIXELS, (n % _SUBPIXELS + 0.5) / _SUBPIXELS
                sx = (corners[row, column, 0] * (1 - q) + corners[row, column + 1, 0] * q) * (1 - p) + (
                    corners[row + 1, column, 0] * (1 - q) + corners[row + 1, column + 1, 0] * q
                ) * p
                sy = (corners[row, column, 1] * (1 - q) + corners[row, column + 1, 1] * q) * (1 - p) + (
                    corners[row + 1, column, 1] * (1 - q) + corners[row + 1, column + 1, 1] * q
                ) * p
                dz = turn[2, 0] * sx + turn[2, 1] * sy + turn[2, 2]
                if dz <= 0.0:
                    continue
                t = origin[2] / dz
                x = (turn[0, 0] * sx + turn[0, 1] * sy + turn[0, 2]) * t - origin[0]
                y = (turn[1, 0] * sx + turn[1, 1] * sy + turn[1, 2]) * t - origin[1]
                j = int(np.floor((x - first[0]) / texel_mm + 0.5))
                i = int(np.floor((y - first[1]) / texel_mm + 0.5))
                if 0 <= i < face.shape[0] and 0 <= j < face.shape[1]:
                    total += face[i, j]
                    hits += 1
            share[row, column] = total / (_SUBPIXELS * _SUBPIXELS)
            paper[row, column] = hits / (_SUBPIXELS * _SUBPIXELS)
