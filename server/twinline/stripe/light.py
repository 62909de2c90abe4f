"""Which light of a picture is measured, without copying the picture where that can be helped."""

from dataclasses import dataclass

import cv2
import numpy as np

from twinline.arrays import ByteArray, FloatArray, IntArray
from twinline.errors import StripeError
from twinline.stripe.model import Channel

_INDEX = {"blue": 0, "green": 1, "red": 2}


@dataclass(frozen=True, eq=False)
class Light:
    """A view of a picture for the extraction kernels.

    Attributes
    ----------
    flat : (rows, columns * step) uint8 array
        The picture, channels side by side, stripes running along its rows.
    off : array like flat, or (1, 1) array
        The same with the lasers off; used only where ``has_off``.
    search : array like flat
        ``flat`` less ``off``, not below 0, for the coarse peaks.
    step, channel, minus
        Channels per pixel, the channel to read, and the channel to subtract from it (-1: none).
    """

    flat: ByteArray
    off: ByteArray
    search: ByteArray
    has_off: bool
    step: int
    channel: int
    minus: int

    @property
    def columns(self) -> int:
        """Pixels along the stripe."""
        return int(self.flat.shape[1]) // self.step

    @property
    def rows(self) -> int:
        """Pixels across the stripe."""
        return int(self.flat.shape[0])

    def raw(self, rows: IntArray, columns: IntArray) -> ByteArray:
        """Grey levels as recorded of the pixels at (rows, columns), which broadcast."""
        return np.asarray(self.flat[rows, columns * self.step + self.channel], dtype=np.uint8)

    def values(self, rows: IntArray, columns: IntArray) -> FloatArray:
        """Measured light in DN of the pixels at (rows, columns), which broadcast: less the other channel, less off."""
        at, under = columns * self.step + self.channel, columns * self.step + self.minus
        light = self.flat[rows, at].astype(np.float64)
        if self.minus >= 0:
            light -= self.flat[rows, under]
        if self.has_off:
            light -= self.off[rows, at]
            if self.minus >= 0:
                light += self.off[rows, under]
        return np.asarray(light)


def take_light(image: ByteArray, channel: Channel, *, along_v: bool, off: ByteArray | None = None) -> Light:
    """Choose the light of a picture.

    Parameters
    ----------
    image : (height, width) or (height, width, 3) uint8 array
        Gray, or blue, green, red.
    channel
        "auto" is gray for gray pictures and red for colour.
    along_v
        Whether stripes run along v; the picture is then transposed, so that they run along the rows.
    off : array like image, optional
        The same view with the lasers off.

    Raises
    ------
    StripeError
        If the arrays are not pictures, differ in shape, or lack the channel.
    """
    _check(image, "picture")
    if off is not None:
        _check(off, "laser-off picture")
        if off.shape[:2] != image.shape[:2]:
            raise StripeError(
                f"The laser-off picture is {off.shape[1]} x {off.shape[0]} px but the picture is "
                f"{image.shape[1]} x {image.shape[0]}: both must come from the same camera setting."
            )
        if off.ndim != image.ndim:
            image, off = _luma(image), _luma(off)
    gray = image.ndim == 2
    if gray and channel in ("red", "green", "blue", "red-blue"):
        raise StripeError(f'The picture has one channel, so "{channel}" cannot be taken from it; use "gray".')
    if channel in ("luma", "gray"):
        image, off = _luma(image), None if off is None else _luma(off)
        gray = True
    if along_v:
        image = cv2.transpose(image)  # type: ignore[assignment]
        off = None if off is None else cv2.transpose(off)  # type: ignore[assignment]
    step, plus, minus = 1, 0, -1
    if not gray:
        step = 3
        plus, minus = (2, 0) if channel == "red-blue" else (_INDEX.get(channel, 2), -1)
    flat = _flat(image)
    if off is None:
        return Light(flat, np.empty((1, 1), np.uint8), flat, False, step, plus, minus)
    flat_off = _flat(off)
    return Light(flat, flat_off, np.asarray(cv2.subtract(flat, flat_off), dtype=np.uint8), True, step, plus, minus)


def _check(image: ByteArray, what: str) -> None:
    if image.dtype != np.uint8 or not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)):
        raise StripeError(f"A {what} must be 8 bits deep with one or three channels, not {image.dtype} {image.shape}.")
    if min(image.shape[:2]) < 1:
        raise StripeError(f"The {what} is empty.")


def _luma(image: ByteArray) -> ByteArray:
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def _flat(image: ByteArray) -> ByteArray:
    return np.ascontiguousarray(image).reshape(image.shape[0], -1)
