"""Travel of the cart and pose of the bed, from a board that lies still while the cart carries the camera past it.

Everything is in the camera's own frame at cart position 0: a point that stands still in the world is seen at
``p(cart) = p(0) - travel * cart_mm``. The board has one pose and the cart one direction for all views, so that a long
travel makes up for a small board. The camera itself is not adjusted; how its uncertainty carries over is kept as a
linear dependence, so that a later adjustment may move all of them together.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from twinline.arrays import BoolArray, FloatArray
from twinline.calibration.bundle import camera_jacobian
from twinline.calibration.camera_start import board_pose
from twinline.calibration.views import BoardView
from twinline.errors import CalibrationError
from twinline.geometry.camera import Camera, distort_jacobian

_MAX_STEPS = 50
_STOP = 1e-10
_STRANGE = 4.0
_LEAST_VIEWS = 2
_LEAST_TRAVEL_MM = 1.0
_LEAST_SHIFT_PX = 5.0
_GOOD_SCALE_SD = 0.001
_MEDIAN_PER_SIGMA = 1.17741
# No bed and no board is flatter than this over its size, however well the corners are measured.
_BED_TILT_SD_RAD = 2e-4
_BED_HEIGHT_SD_MM = 0.05
_OTHER_ORIGIN_MM = 100.0
_MOST_RMS_PX = 2.0


@dataclass(frozen=True, eq=False)
class TravelResult:
    """Travel and bed in the camera frame at cart position 0.

    Attributes
    ----------
    travel : (3,) array
        Millimetres per commanded millimetre by which the cart moves the camera, in the camera frame.
    bed : (3,) array
        The bed plane as inverse distances: ``bed . p = 1`` for points p of the bed, per millimetre, at the middle of
        these views. Their cart may count from elsewhere than that of another pass; a travel that is not parallel to the
        bed then makes its distance uncertain, and ``matrix`` says so.
    matrix : (6, 6) array
        Covariance of travel and bed at a fixed camera.
    by_camera : (6, 9) array
        Their derivatives by the camera's parameters (`bundle.PARAMETERS`).
    rms_px, held_out_px
        Root mean square distance of corners from their prediction, and the same for every view under the travel of
        the others.
    rejected_share
        Share of the views' corners left out as gross errors.
    views, dropped
        Names of the views used, and of those that contradict the others.
    """

    travel: FloatArray
    bed: FloatArray
    matrix: FloatArray
    by_camera: FloatArray
    rms_px: float
    held_out_px: float
    rejected_share: float
    views: tuple[str, ...]
    dropped: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def scale(self) -> float:
        """Real millimetres per commanded millimetre."""
        return float(np.linalg.norm(self.travel))


@dataclass(frozen=True, eq=False)
class _Sightings:
    """Corners of all views: in the board's frame (n, 3), in the picture (n, 2), cart (n,), view number (n,)."""

    board_mm: FloatArray
    pixels: FloatArray
    cart_mm: FloatArray
    view: FloatArray

    def take(self, rows: BoolArray) -> "_Sightings":
        return _Sightings(self.board_mm[rows], self.pixels[rows], self.cart_mm[rows], self.view[rows])


@dataclass(frozen=True, eq=False)
class _State:
    """Pose of the board at the middle of the travel, and the travel."""

    rotation: FloatArray
    translation: FloatArray
    travel: FloatArray


def calibrate_travel(
    views: Sequence[BoardView],
    cart_mm: FloatArray,
    camera: Camera,
    *,
    thickness_mm: float = 0.0,
    inflation: float = 1.0,
) -> TravelResult:
    """Find travel and bed from views of one board that did not move.

    Parameters
    ----------
    views
        As `views.inspect_view` gives them; unusable ones are left out.
    cart_mm : (n,) array
        Commanded position of each view.
    thickness_mm
        Height of the board's printed face above the bed.
    inflation
        Ratio of variances by which views disagree more than their corners' noise explains, from the intrinsic
        calibration.

    Raises
    ------
    CalibrationError
        ``too-few-views``, ``no-travel`` or ``views-contradict``, with the next step.
    """
    usable = [i for i, view in enumerate(views) if view.usable]
    if len(usable) < _LEAST_VIEWS:
        raise CalibrationError(
            f"The board is seen in {len(usable)} of {len(views)} views of motion/; at least {_LEAST_VIEWS}, better 5, "
            "are needed, taken at different positions of the cart with the board lying still.",
            code="too-few-views",
        )
    carts = np.asarray(cart_mm, dtype=np.float64)[usable]
    if np.ptp(carts) < _LEAST_TRAVEL_MM:
        raise CalibrationError(
            f"The cart positions of motion/ span {np.ptp(carts):g} mm, so there is no travel to measure; move the "
            "cart by at least half of the field of view between the first and the last view, and list the positions "
            "in motion/frames.csv.",
            code="no-travel",
        )
    middle = float(carts.mean())
    seen = _stack([views[i] for i in usable], carts - middle)
    state = _start(seen, [views[i] for i in usable], carts - middle, camera)
    state, kept, dropped = _robust(seen, state, camera)
    rest = seen.take(kept)
    _require_motion(rest, views, usable, dropped)
    _require_fit(rest, state, camera)
    error = _residuals(rest, state, camera)
    freedom = max(error.size - 9, 1)
    variance = float((error**2).sum()) / freedom
    by_camera, by_state = _jacobian(rest, state, camera)
    inverse = np.linalg.inv(by_state.T @ by_state)
    to_result = _result_derivatives(state, thickness_mm)
    matrix = to_result @ (inverse * variance * max(inflation, 1.0)) @ to_result.T
    bed = _bed(state, thickness_mm)
    matrix[3:, 3:] += _flatness(bed, _OTHER_ORIGIN_MM * float(bed @ state.travel) / float(np.linalg.norm(bed)))
    sd = float(np.sqrt(state.travel @ matrix[:3, :3] @ state.travel)) / float(state.travel @ state.travel)
    warnings: tuple[str, ...] = ()
    if sd > _GOOD_SCALE_SD:
        weak = (
            f"The scale of the travel is known to {100 * sd:.2f} % only; let the board cross the whole field of view "
            "in motion/."
        )
        warnings = (weak,)
    return TravelResult(
        travel=state.travel,
        bed=bed,
        matrix=(matrix + matrix.T) / 2,
        by_camera=-to_result @ inverse @ by_state.T @ by_camera,
        rms_px=float(np.sqrt((error**2).sum() / len(error))),
        held_out_px=_held_out(rest, state, camera),
        rejected_share=1.0 - float(kept.mean()),
        views=tuple(views[i].name for k, i in enumerate(usable) if k not in dropped),
        dropped=tuple(views[usable[k]].name for k in dropped),
        warnings=warnings,
    )


def _stack(views: Sequence[BoardView], carts: FloatArray) -> _Sightings:
    return _Sightings(
        np.concatenate([view.board_mm for view in views]),
        np.concatenate([view.pixels for view in views]),
        np.concatenate([np.full(len(view.ids), cart) for view, cart in zip(views, carts, strict=True)]),
        np.concatenate([np.full(len(view.ids), number) for number, view in enumerate(views)]),
    )


def _start(seen: _Sightings, views: Sequence[BoardView], carts: FloatArray, camera: Camera) -> _State:
    """Each view's own pose; the travel from the slope of their positions by medians, which false views do not move."""
    pinhole = np.eye(3)
    rotations, places = [], []
    for number, view in enumerate(views):
        rows = seen.view == number
        rays = camera.rays(view.pixels)[:, :2]
        rotation, translation = board_pose(seen.board_mm[rows], rays, pinhole)
        rotations.append(rotation)
        places.append(rotation @ view.board_mm.mean(axis=0) + translation)
    middles = np.array(places)
    first, last = np.triu_indices(len(views), 1)
    apart = carts[last] - carts[first]
    far = np.abs(apart) >= 0.3 * np.ptp(carts)
    travel = -np.median((middles[last] - middles[first])[far] / apart[far, None], axis=0)
    still = middles + travel * carts[:, None]
    best = int(np.argmin(np.linalg.norm(still - np.median(still, axis=0), axis=1)))
    rotation = rotations[best]
    return _State(rotation, np.median(still, axis=0) - rotation @ views[best].board_mm.mean(axis=0), travel)


def _robust(seen: _Sightings, state: _State, camera: Camera) -> tuple[_State, BoolArray, list[int]]:
    """Fit with soft weights first, then without the views and corners that lie far off."""
    weights = np.ones(len(seen.view))
    for _ in range(5):
        state = _solve(seen, state, camera, weights)
        length = np.linalg.norm(_residuals(seen, state, camera), axis=1)
        scale = max(float(np.median(length)) / _MEDIAN_PER_SIGMA, 0.02)
        weights = 1.0 / np.sqrt(1.0 + (length / (2.0 * scale)) ** 2)
    views = np.unique(seen.view)
    level = np.array([np.median(length[seen.view == view]) for view in views])
    limit = _STRANGE * max(float(np.median(level)), 0.05)
    dropped = [int(view) for view, off in zip(views, level, strict=True) if off > limit]
    kept = ~np.isin(seen.view, dropped)
    for _ in range(2):
        state = _solve(seen.take(kept), state, camera, np.ones(int(kept.sum())))
        length = np.linalg.norm(_residuals(seen, state, camera), axis=1)
        scale = float(np.median(length[kept])) / _MEDIAN_PER_SIGMA
        kept = ~np.isin(seen.view, dropped) & (length < 5.0 * max(scale, 0.02))
    return _solve(seen.take(kept), state, camera, np.ones(int(kept.sum()))), kept, dropped


def _require_motion(rest: _Sightings, views: Sequence[BoardView], usable: Sequence[int], dropped: list[int]) -> None:
    if len(usable) - len(dropped) < _LEAST_VIEWS or 2 * len(dropped) > len(usable):
        names = ", ".join(views[usable[k]].name for k in dropped[:5])
        raise CalibrationError(
            f"{len(dropped)} of {len(usable)} views of motion/ contradict a straight travel ({names}); the board must "
            "lie still and frames.csv must hold each picture's position: take them again.",
            code="views-contradict",
        )
    middles = np.array([rest.pixels[rest.view == view].mean(axis=0) for view in np.unique(rest.view)])
    if np.ptp(middles, axis=0).max() < _LEAST_SHIFT_PX:
        raise CalibrationError(
            f"The board moves by {np.ptp(middles, axis=0).max():.1f} px between the views of motion/ although the cart "
            "was commanded to travel; it must lie on the bed, not ride on the cart.",
            code="no-travel",
        )


def _require_fit(rest: _Sightings, state: _State, camera: Camera) -> None:
    rms = float(np.sqrt((_residuals(rest, state, camera) ** 2).sum(axis=1).mean()))
    if rms > _MOST_RMS_PX:
        raise CalibrationError(
            f"The views of motion/ contradict a straight travel: their corners are {rms:.1f} px off (limit "
            f"{_MOST_RMS_PX:g}); the board must lie still, frames.csv must hold each picture's position, and the "
            "camera must be the calibrated one.",
            code="views-contradict",
        )


def _points(seen: _Sightings, state: _State) -> tuple[FloatArray, FloatArray]:
    turned = seen.board_mm @ state.rotation.T
    return turned, turned + state.translation - state.travel * seen.cart_mm[:, None]


def _residuals(seen: _Sightings, state: _State, camera: Camera) -> FloatArray:
    predicted = camera.project(_points(seen, state)[1])
    return np.nan_to_num(predicted - seen.pixels, nan=1e4)


def _jacobian(seen: _Sightings, state: _State, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Derivatives of the image points by the camera, (2n, 9), and by rotation, translation and travel, (2n, 9)."""
    turned, points = _points(seen, state)
    z = np.maximum(points[:, 2], 1e-6)
    x, y = points[:, 0] / z, points[:, 1] / z
    theta = np.concatenate([[camera.fx, camera.fy, camera.cx, camera.cy], camera.distortion])
    a, b, d = distort_jacobian(x, y, camera.distortion)
    by_x = np.stack([camera.fx * a, camera.fy * b], axis=-1)
    by_y = np.stack([camera.fx * b, camera.fy * d], axis=-1)
    by_point = np.stack([by_x, by_y, -(x[:, None] * by_x + y[:, None] * by_y)], axis=-1) / z[:, None, None]
    by_state = np.concatenate(
        [np.cross(turned[:, None, :], by_point), by_point, -by_point * seen.cart_mm[:, None, None]], axis=2
    )
    return camera_jacobian(x, y, theta).reshape(-1, 9), by_state.reshape(-1, 9)


def _solve(seen: _Sightings, state: _State, camera: Camera, weights: FloatArray) -> _State:
    """Weighted least squares by Levenberg-Marquardt."""
    root = np.sqrt(np.repeat(weights, 2))
    error = _residuals(seen, state, camera).ravel() * root
    damping = 1e-6
    for _ in range(_MAX_STEPS):
        jacobian = _jacobian(seen, state, camera)[1] * root[:, None]
        normal = jacobian.T @ jacobian
        scale = np.sqrt(np.diagonal(normal)) + 1e-12
        system = normal / np.outer(scale, scale) + damping * np.eye(9)
        step = -np.linalg.solve(system, (jacobian.T @ error) / scale) / scale
        trial = _State(
            cv2.Rodrigues(step[:3])[0] @ state.rotation, state.translation + step[3:6], state.travel + step[6:]
        )
        trial_error = _residuals(seen, trial, camera).ravel() * root
        before, after = float(error @ error), float(trial_error @ trial_error)
        if after > before * (1 + 1e-14):
            damping *= 10
            if damping > 1e8:
                break
            continue
        state, error, damping = trial, trial_error, max(damping / 10, 1e-12)
        if before - after <= _STOP * before:
            break
    return state


def _bed(state: _State, thickness_mm: float) -> FloatArray:
    normal = state.rotation[:, 2]
    return np.asarray(normal / (normal @ state.translation + thickness_mm))


def _result_derivatives(state: _State, thickness_mm: float) -> FloatArray:
    """Derivatives of (travel, bed) by (rotation, translation, travel), (6, 9)."""
    normal = state.rotation[:, 2]
    distance = float(normal @ state.translation) + thickness_mm
    by_normal = np.eye(3) / distance - np.outer(normal, state.translation) / distance**2
    turn = -_cross(normal)
    out = np.zeros((6, 9))
    out[:3, 6:] = np.eye(3)
    out[3:, :3] = by_normal @ turn
    out[3:, 3:6] = -np.outer(normal, normal) / distance**2
    return out


def _cross(v: FloatArray) -> FloatArray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _flatness(bed: FloatArray, height_mm: float) -> FloatArray:
    """Covariance of the bed plane by what board and bed are not flat, and by ``height_mm`` of uncertain height."""
    size = float(np.linalg.norm(bed))
    normal = bed / size
    across = np.eye(3) - np.outer(normal, normal)
    return np.asarray(
        across * (size * _BED_TILT_SD_RAD) ** 2
        + np.outer(normal, normal) * size**4 * (_BED_HEIGHT_SD_MM**2 + height_mm**2)
    )


def _held_out(seen: _Sightings, state: _State, camera: Camera) -> float:
    """Root mean square distance of each view's corners from the prediction of the other views."""
    views = np.unique(seen.view)
    if len(views) < _LEAST_VIEWS + 1:
        return float("nan")
    squares = []
    for view in views:
        out = seen.view == view
        others = _solve(seen.take(~out), state, camera, np.ones(int((~out).sum())))
        squares.append((_residuals(seen.take(out), others, camera) ** 2).sum(axis=1))
    return float(np.sqrt(np.concatenate(squares).mean()))
