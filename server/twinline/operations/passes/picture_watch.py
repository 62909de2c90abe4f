"""Whether the pictures of a laser pass show what they should: every laser's stripe, and a scene that moves.

Neither the board nor the camera knows that a laser has gone dark or that a motor has lost its steps; the pictures do. A
few of them are looked at on their way into the recording, at half size.
"""

from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np

from twinline.arrays import ByteArray, FloatArray
from twinline.devices.camera import CameraFrame

Texture: TypeAlias = np.ndarray[tuple[int, ...], np.dtype[np.float32]]

LOOK_MM = 3.0
"""Travel between pictures that are looked at."""

LOOK_S = 0.15
"""Time between them."""

_LIT_DN = 20
_ALONG = {"along-u": 0, "along-v": 1}
_FEWER = 0.65
_STILL = 0.9
_TEXTURE_DN = 1.2
_BLOCK_PX = 8
_MARGIN_PX = 21
"""Twice as far as the filter of the texture carries a stripe."""

_FEWEST_BLOCKS = 30
_FEWEST_LOOKS = 3


@dataclass(frozen=True, eq=False)
class _Look:
    """One picture.

    Attributes
    ----------
    cart_mm
        Where the cart was told to be.
    stripes
        How many a column has (a row, for stripes along v), up to 2.
    first_px, last_px
        Where the first and the last of them lie on average; NaN without any.
    texture, unlit
        What the room's light shows, and where no laser interferes.
    """

    cart_mm: float
    stripes: float
    first_px: float
    last_px: float
    texture: Texture
    unlit: ByteArray


class PictureWatch:
    """Looks at some of the pictures of one leg.

    Parameters
    ----------
    stripe_runs
        Whether stripes run along u or along v.
    """

    def __init__(self, stripe_runs: str) -> None:
        self._axis = _ALONG[stripe_runs]
        self._next_s = -np.inf
        self._last: _Look | None = None
        self._best: dict[frozenset[int], _Look] = {}
        self._missing: dict[frozenset[int], str] = {}
        self._weak_since_mm: dict[frozenset[int], float] = {}
        self._weak: dict[frozenset[int], int] = {}
        self._moving = self._still = 0
        self._still_since_mm = 0.0

    def frame(self, frame: CameraFrame, lasers: frozenset[int], cart_mm: float) -> None:
        """Look at a picture, if the last one was long enough ago.

        Parameters
        ----------
        lasers
            That are switched on.
        cart_mm
            Where the cart should be, to some millimetres.
        """
        far = self._last is None or abs(cart_mm - self._last.cart_mm) >= LOOK_MM
        if not (lasers and far and frame.host_time_s >= self._next_s):
            return
        picture = _half(frame)
        if picture is None:
            return
        self._next_s = frame.host_time_s + LOOK_S
        look = self._look(picture, cart_mm)
        self._see_light(look, lasers)
        if self._last is not None:
            self._see_movement(self._last, look)
        self._last = look

    def warnings(self) -> tuple[str, ...]:
        """What was wrong until the last picture, a sentence each."""
        found = []
        for lasers, count in self._weak.items():
            if count >= _FEWEST_LOOKS:
                found.append(
                    f"From {self._weak_since_mm[lasers]:.0f} mm on the pictures lack the stripe of "
                    f"{self._missing[lasers]}; check its power and what is in its way, and repeat the laser pass."
                )
        if self._still >= _FEWEST_LOOKS:
            found.append(
                f"From {self._still_since_mm:.0f} mm on the picture stands still while the cart should move, so it "
                "seems to lose steps; check motor and load, home the cart, and repeat the scan."
            )
        return tuple(found)

    def _look(self, picture: ByteArray, cart_mm: float) -> _Look:
        light, grey = _laser_light(picture), picture if picture.ndim == 2 else picture[:, :, 1]
        lit = light >= _LIT_DN
        starts = np.diff(lit.astype(np.int8), axis=self._axis, prepend=0) == 1
        unlit = np.asarray(cv2.dilate(lit.astype(np.uint8), np.ones((_MARGIN_PX, _MARGIN_PX), np.uint8)) == 0, np.uint8)
        smooth = np.asarray(grey, np.float32)
        texture = cv2.GaussianBlur(smooth, (0, 0), 1.0) - cv2.boxFilter(smooth, -1, (11, 11))
        stripes = float(np.minimum(starts.sum(axis=self._axis), 2).mean())
        seen = starts.any(axis=self._axis)
        first = starts.argmax(axis=self._axis)[seen]
        last = starts.shape[self._axis] - 1 - np.flip(starts, self._axis).argmax(axis=self._axis)[seen]
        ends = (float(first.mean()), float(last.mean())) if len(first) else (np.nan, np.nan)
        return _Look(cart_mm, stripes, *ends, np.asarray(texture, np.float32), unlit)

    def _see_light(self, look: _Look, lasers: frozenset[int]) -> None:
        best = self._best.setdefault(lasers, look)
        if look.stripes > best.stripes:
            self._best[lasers] = best = look
        if look.stripes >= _FEWER * best.stripes:
            self._weak[lasers] = 0
            return
        if not self._weak.get(lasers):
            self._weak_since_mm[lasers] = look.cart_mm
            self._missing[lasers] = _missing(lasers, best, look)
        self._weak[lasers] = self._weak.get(lasers, 0) + 1

    def _see_movement(self, before: _Look, now: _Look) -> None:
        alike = _likeness(before, now)
        if alike is None:
            return
        if alike < _STILL:
            self._still = 0
            return
        if not self._still:
            self._still_since_mm = before.cart_mm
        self._still += 1


def _laser_light(picture: ByteArray) -> ByteArray:
    """How much brighter each pixel is than the room makes it: of a purer colour, or than its neighbourhood."""
    if picture.ndim == 3:
        blue, green, red = cv2.split(picture)
        middle = cv2.max(cv2.min(blue, green), cv2.min(cv2.max(blue, green), red))
        return np.asarray(cv2.subtract(cv2.max(cv2.max(blue, green), red), middle), np.uint8)
    return np.asarray(cv2.subtract(picture, cv2.medianBlur(picture, 15)), np.uint8)


def _missing(lasers: frozenset[int], best: _Look, look: _Look) -> str:
    """Whose stripe a picture lacks: laser 1's is the one at larger v (u)."""
    if len(lasers) == 1 or not np.isfinite(look.first_px):
        return " and ".join(f"laser {laser}" for laser in sorted(lasers))
    place_px = 0.5 * (look.first_px + look.last_px)
    return "laser 1" if abs(place_px - best.first_px) < abs(place_px - best.last_px) else "laser 2"


def _half(frame: CameraFrame) -> ByteArray | None:
    """The picture at half size; None where it cannot be decoded."""
    if frame.encoding == "jpeg":
        picture = cv2.imdecode(np.frombuffer(frame.data, np.uint8), cv2.IMREAD_REDUCED_COLOR_2)
        return None if picture is None else np.asarray(picture, np.uint8)
    width, height = frame.image_size
    return np.frombuffer(frame.data, np.uint8).reshape(height, width, -1).squeeze()[::2, ::2]


def _likeness(before: _Look, now: _Look) -> float | None:
    """Correlation of two pictures' texture without shift: 1 for the same view; None where there is no texture."""
    dark = _block_means(before.unlit & now.unlit) > 0.999
    a, b = before.texture, now.texture
    spread_a, spread_b = _block_means(a * a), _block_means(b * b)
    textured = dark & (np.minimum(spread_a, spread_b) > _TEXTURE_DN**2)
    if textured.sum() < _FEWEST_BLOCKS:
        return None
    together = _block_means(a * b)[textured] / np.sqrt(spread_a[textured] * spread_b[textured])
    return float(np.median(together))


def _block_means(values: FloatArray | ByteArray | Texture) -> FloatArray:
    """Means over squares; the texture itself has none, so that these are its variances and covariances."""
    rows, columns = (size // _BLOCK_PX for size in values.shape)
    cut = np.asarray(values[: rows * _BLOCK_PX, : columns * _BLOCK_PX], np.float32)
    return np.asarray(cv2.resize(cut, (columns, rows), interpolation=cv2.INTER_AREA), np.float64)
