"""Numbers to colours for the 3-D view."""

from collections.abc import Sequence

import numpy as np

from twinline.arrays import ByteArray, FloatArray
from twinline.fusion.cloud import PointCloud, Source
from twinline.operations.display import ColourMode

SCALED = {ColourMode.HEIGHT: "mm", ColourMode.SIGMA: "mm", ColourMode.INTENSITY: "grey levels"}
"""Colour modes with a scale, and the unit of its ends."""

# The panel's ramp: lightness grows with the value, so that it is read without colour vision too.
_ANCHORS = np.array([[47, 42, 107], [49, 86, 140], [39, 127, 142], [53, 167, 121], [144, 210, 67], [246, 227, 59]])
_SCALE: ByteArray = np.stack(
    [np.interp(np.linspace(0, 5, 256), np.arange(6), _ANCHORS[:, channel]) for channel in range(3)], axis=1
).astype(np.uint8)

# The panel's colours of the sources on its dark theme: the stage is always dark.
_SOURCES: ByteArray = np.full((256, 3), 128, np.uint8)
_SOURCES[Source.LASER_1] = (63, 169, 232)
_SOURCES[Source.LASER_2] = (240, 171, 46)
_SOURCES[Source.BOTH_LASERS] = (47, 197, 150)
_SOURCES[Source.TOF] = (221, 143, 186)
_SOURCES[Source.FILLED] = (141, 151, 166)
_SCALE.setflags(write=False)
_SOURCES.setflags(write=False)


def scalar(cloud: PointCloud, mode: ColourMode) -> FloatArray | None:
    """The number that a mode with a scale shows.

    Returns
    -------
    (n,) float32 array or None
        In the unit that `SCALED` names; None for the other modes.
    """
    if mode is ColourMode.HEIGHT:
        return cloud.points_mm[:, 2]
    if mode is ColourMode.SIGMA:
        return cloud.sigma_mm
    if mode is ColourMode.INTENSITY:
        return cloud.intensity
    return None


def value_range(parts: Sequence[FloatArray | None]) -> tuple[float, float] | None:
    """Ends of a scale, so that a few wild points do not wash out the rest.

    Most of a scan is bare bed, so that the top of a small object is a matter of thousandths of the points; what lies
    further out than the middle 98 % are long is taken as wild.

    Parameters
    ----------
    parts : sequence of (n,) arrays
        NaN counts as absent.

    Returns
    -------
    (float, float) or None
        None where there is no number.
    """
    known = [part for part in parts if part is not None]
    # A stride bounds the cost of sorting; of 50 000 numbers fifty lie beyond either end.
    stride = max(1, sum(len(part) for part in known) // 50_000)
    sample = np.concatenate([part[::stride] for part in known]) if known else np.empty(0)
    sample = sample[np.isfinite(sample)]
    if not len(sample):
        return None
    lowest, low, high, highest = np.percentile(sample, (0.1, 1.0, 99.0, 99.9))
    reach = high - low
    return float(max(lowest, low - reach)), float(min(highest, high + reach))


def colours(cloud: PointCloud, mode: ColourMode, ends: tuple[float, float] | None) -> ByteArray:
    """Colour of every point.

    Parameters
    ----------
    ends
        Values of the two ends of the scale, for modes that have one.

    Returns
    -------
    (n, 3) uint8 array
        Red, green, blue; points without a number are grey.
    """
    if mode is ColourMode.COLOUR:
        return cloud.colour
    if mode is ColourMode.SOURCE:
        return _SOURCES[cloud.source]
    values = scalar(cloud, mode)
    if values is None or ends is None:
        return np.full((len(cloud), 3), 128, np.uint8)
    low, high = ends
    position = (values - low) / max(high - low, 1e-9)
    known = np.isfinite(position)
    index = (np.clip(np.where(known, position, 0.0), 0.0, 1.0) * 255).astype(np.uint8)
    return np.where(known[:, None], _SCALE[index], np.uint8(128))
