"""The relief: a king's face with a headdress, in smooth low relief on a slab, drawn from a few formulas of our own."""

import numpy as np
import trimesh

from twinline.arrays import FloatArray

HALF_X_MM, HALF_Y_MM = 48.0, 38.0
SLAB_MM = 4.0
_STEP_MM = 0.5


def relief_mesh() -> trimesh.Trimesh:
    """The closed surface, its foot on z = 0, the forehead towards -x."""
    x = np.linspace(-HALF_X_MM, HALF_X_MM, int(2 * HALF_X_MM / _STEP_MM) + 1)
    y = np.linspace(-HALF_Y_MM, HALF_Y_MM, int(2 * HALF_Y_MM / _STEP_MM) + 1)
    a, b = np.meshgrid(x, y, indexing="ij")
    return _slab(a, b, relief_height_mm(a, b))


def relief_height_mm(x: FloatArray, y: FloatArray) -> FloatArray:
    """Height of the surface above the bed at places on the slab, millimetres."""
    side = np.abs(y)
    head = 15.0 * _positive(1.0 - ((x - 2.0) / 25.0) ** 2 - (y / 17.5) ** 2) ** 0.7
    cloth = 7.0 * _positive(1.0 - ((x + 6.0) / 34.0) ** 2 - (y / 33.0) ** 2) ** 0.6
    lappets = 6.0 * _ramp(1.0 - np.abs(side - 21.0) / 8.0, 0.25) * _ramp((46.0 - x) / 4.0, 0.5) * _ramp(x / 4.0, 0.5)
    cloth = _larger(cloth, lappets)
    folds = 0.28 * np.sin(2 * np.pi * (0.5 * x + 0.32 * side) / 2.6)
    cloth = cloth + folds * _ramp(cloth / 3.0 - 0.4, 0.3) * _ramp(
        (side - 14.0) / 4.0 + _ramp(-(x + 14.0) / 4.0, 0.5), 0.4
    )
    band = 1.1 * np.exp(-0.5 * ((x + 17.0 - 0.012 * y**2) / 1.6) ** 2) * _ramp((16.5 - side) / 2.0, 0.4)
    height = _larger(head + band, cloth)
    height = height + _features(x, side)
    beard = 7.0 * np.exp(-0.5 * (y / 2.6) ** 2) * _ramp((44.0 - x) / 2.0, 0.5) * _ramp((x - 24.0) / 2.0, 0.5)
    serpent = _bump(x + 22.0, y, 4.2, 1.3, 3.2) + _bump(x + 18.5, y, 1.4, 1.6, 1.6)
    return np.asarray(SLAB_MM + _larger(height, beard) + serpent)


def _features(x: FloatArray, side: FloatArray) -> FloatArray:
    """Nose, brows, eyes, lips, cheeks and chin, symmetric about y = 0."""
    nose = (
        _bump(x - 1.5, side, 5.6, 1.7, 4.6)
        + _bump(x - 6.2, side, 1.9, 2.6, 2.2)
        + _bump(x - 6.6, side - 2.9, 1.4, 1.2, 1.0)
    )
    brows = _bump(x + 8.6 - 0.10 * (side - 7.5) ** 2 / 4.0, side - 7.6, 1.1, 4.4, 1.5)
    sockets = _bump(x + 4.2, side - 7.4, 2.3, 3.8, -2.3)
    eyes = _bump(x + 4.2, side - 7.4, 1.25, 2.5, 1.9) + _bump(x + 4.2, side - 11.8, 0.8, 2.6, 0.7)
    lips = (
        _bump(x - 11.6, side, 0.95, 3.9, 1.5)
        + _bump(x - 14.2, side, 1.15, 3.3, 1.7)
        + _bump(x - 12.9, side, 0.6, 4.4, -1.0)
    )
    round_parts = _bump(x - 5.5, side - 9.0, 5.0, 4.0, 0.9) + _bump(x - 19.5, side, 2.6, 4.0, 1.9)
    ears = _bump(x + 2.0, side - 18.6, 4.2, 1.5, 3.4) + _bump(x + 2.0, side - 18.4, 2.2, 0.7, -1.6)
    return np.asarray(nose + brows + sockets + eyes + lips + round_parts + ears)


def _bump(x: FloatArray, y: FloatArray, wide_x: float, wide_y: float, high: float) -> FloatArray:
    return np.asarray(high * np.exp(-0.5 * ((x / wide_x) ** 2 + (y / wide_y) ** 2)))


def _positive(value: FloatArray) -> FloatArray:
    """About max(value, 0), with a soft foot."""
    return np.asarray(0.03 * np.logaddexp(0.0, value / 0.03))


def _ramp(value: FloatArray, width: float) -> FloatArray:
    """From 0 to 1 about value 0, smoothly."""
    return np.asarray(0.5 * (1.0 + np.tanh(value / width)))


def _larger(one: FloatArray, other: FloatArray) -> FloatArray:
    """About the larger of two heights, without a crease."""
    return np.asarray(0.7 * np.logaddexp(one / 0.7, other / 0.7))


def _slab(x: FloatArray, y: FloatArray, height: FloatArray) -> trimesh.Trimesh:
    """Close a height field with upright walls and a foot at z = 0."""
    rows, columns = x.shape
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    top = np.concatenate([np.stack([a, b, c], axis=-1).reshape(-1, 3), np.stack([a, c, d], axis=-1).reshape(-1, 3)])
    # Once round the border, seen from above against the clock.
    rim = np.concatenate([index[:-1, 0], index[-1, :-1], index[:0:-1, -1], index[0, :0:-1]])
    foot = rows * columns + np.arange(len(rim))
    rim_next, foot_next = np.roll(rim, -1), np.roll(foot, -1)
    walls = np.concatenate([np.stack([rim, foot, foot_next], axis=1), np.stack([rim, foot_next, rim_next], axis=1)])
    middle = np.full(len(foot), rows * columns + len(rim))
    base = np.stack([foot_next, foot, middle], axis=1)
    upper = np.column_stack([x.ravel(), y.ravel(), height.ravel()])
    lower = np.column_stack([x.ravel()[rim], y.ravel()[rim], np.zeros(len(rim))])
    vertices = np.concatenate([upper, lower, np.zeros((1, 3))])
    return trimesh.Trimesh(vertices, np.concatenate([top, walls, base]), process=False)
