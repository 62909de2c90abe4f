"""A first camera and first poses, from views of which some may be false."""

import cv2
import numpy as np

from twinline.arrays import BoolArray, FloatArray, IntArray
from twinline.calibration.bundle import Sightings, Solution, residuals, solve, view_rms

_FOCAL_RANGE = (0.4, 6.0)
_FOCAL_STEPS = 15
_STRANGE = 3.0
_STRANGE_AT_FIRST = 5.0
_LEAST_STRANGE_PX = 0.05
_ROUNDS = 6
_SOFTENING_STEPS = 5


def first_solution(sightings: Sightings, size: tuple[int, int], guess: FloatArray | None = None) -> Solution:
    """Pinhole without distortion that suits most views best, by trying focal lengths, with the poses that go with it.

    Parameters
    ----------
    size
        Width and height of the image in pixels.
    guess : (3, 3) array, optional
        A camera matrix to try as well.
    """
    width, height = size
    lengths = np.geomspace(*_FOCAL_RANGE, _FOCAL_STEPS) * max(size)
    centre = ((width - 1) / 2, (height - 1) / 2)
    cameras = [np.array([f, f, *centre]) for f in lengths]
    if guess is not None:
        cameras.append(np.array([guess[0, 0], guess[1, 1], guess[0, 2], guess[1, 2]]))
    trials = [_with_poses(sightings, np.concatenate([camera, np.zeros(5)])) for camera in cameras]
    return min(trials, key=lambda trial: float(np.median(view_rms(sightings, trial))))


def _with_poses(sightings: Sightings, theta: FloatArray) -> Solution:
    matrix = np.array([[theta[0], 0, theta[2]], [0, theta[1], theta[3]], [0, 0, 1.0]])
    rotations, translations = np.empty((len(sightings), 3, 3)), np.empty((len(sightings), 3))
    for i in range(len(sightings)):
        use = sightings.weights[i] > 0
        rotations[i], translations[i] = board_pose(sightings.board_mm[i, use], sightings.pixels[i, use], matrix)
    return Solution(theta, rotations, translations)


def board_pose(board_mm: FloatArray, pixels: FloatArray, matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Approximate pose ``camera_from_board`` of a flat board in a picture without distortion.

    T. Collins, A. Bartoli, "Infinitesimal Plane-Based Pose Estimation", IJCV 109 (2014).

    Returns
    -------
    (3, 3) array, (3,) array
        Rotation, and translation in millimetres; a frontal pose where none can be found.
    """
    try:
        found, turn, shift = cv2.solvePnP(board_mm, pixels, matrix, None, flags=cv2.SOLVEPNP_IPPE)
    except cv2.error:
        found = False
    if found and np.isfinite(turn).all() and np.isfinite(shift).all() and shift[2, 0] > 0:
        return np.asarray(cv2.Rodrigues(turn)[0]), np.asarray(shift, dtype=np.float64).ravel()
    spread_px = max(float(np.ptp(pixels, axis=0).max()), 1.0)
    spread_mm = max(float(np.ptp(board_mm, axis=0).max()), 1e-6)
    depth = float(matrix[0, 0]) * spread_mm / spread_px
    aim = np.linalg.solve(matrix, np.append(pixels.mean(axis=0), 1.0)) * depth
    return np.eye(3), np.asarray(aim - board_mm.mean(axis=0))


def trusted_views(sightings: Sightings, start: Solution) -> tuple[BoolArray, Solution]:
    """Views that agree with each other, and a camera with radial and tangential distortion fitted to them.

    A view is strange if, with a pose of its own, the camera of the trusted views misses its corners by more than three
    times what is usual among them. False views can only be recognised while they are fewer than the true ones.

    Returns
    -------
    (v,) bool array
        The trusted views.
    Solution
        Poses of all views, the strange ones' fitted to the common camera.
    """
    best = start
    rms = view_rms(sightings, best)
    trusted = rms <= _STRANGE_AT_FIRST * np.median(rms)
    count = 6 if trusted.sum() < 4 else 8
    active = np.arange(count)
    for _ in range(_ROUNDS):
        best = _softly(sightings, best, trusted, active)
        rms = view_rms(sightings, best)
        limit = max(_STRANGE * float(np.median(rms[trusted])), _LEAST_STRANGE_PX)
        again = rms <= limit
        if not again.any() or np.array_equal(again, trusted):
            break
        trusted = again
    return trusted, best


def _softly(sightings: Sightings, start: Solution, trusted: BoolArray, active: IntArray) -> Solution:
    """A fit of the trusted views with a soft-L1 loss, and of the other views' poses to its camera."""
    core, best = sightings.take(trusted), start.take(trusted)
    weights = core.weights
    for _ in range(_SOFTENING_STEPS):
        error = np.linalg.norm(residuals(core, best), axis=2)
        scale = max(1.5 * float(np.median(error[weights > 0])), 1e-9)
        softened = Sightings(core.board_mm, core.pixels, weights / np.sqrt(1.0 + (error / scale) ** 2))
        best = solve(softened, best, active, max_steps=15)
    poses = solve(sightings, Solution(best.theta, start.rotations, start.translations_mm), np.arange(0), max_steps=30)
    rotations, translations = poses.rotations.copy(), poses.translations_mm.copy()
    rotations[trusted], translations[trusted] = best.rotations, best.translations_mm
    return Solution(best.theta, rotations, translations)
