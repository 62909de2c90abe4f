"""What a calibration of a scanner can be believed on: numbers that can fail, with the limits that make a verdict.

`scanner_account` fills them in and `scanner_verdict` judges them. Residuals are given over all observations, with the
share that the robust loss rejected, and over groups that were left out of the fit. What no observation determines is
named.
"""

from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

Verdict = Literal["good", "usable", "refused"]

HIGH_CORRELATION = 0.95
UNSEEN_SHARE = 0.5
REJECTED_WEIGHT = 0.1
GOOD_SHAPE_SD_MM = 0.05
REFUSED_SHAPE_SD_MM = 3.0
GOOD_AGREEMENT_MM = 0.05
REFUSED_AGREEMENT_MM = 0.5
GOOD_REJECTED = 0.2
REFUSED_REJECTED = 0.5
GOOD_HELD_OUT_RATIO = 2.0
GOOD_SATURATED = 0.3
REFUSED_SATURATED = 0.9


@dataclass(frozen=True)
class GroupEvidence:
    """One kind of observation.

    Attributes
    ----------
    observations
        Groups, each of which counts once.
    rms_mm, held_out_mm
        Root mean square residual over all of them, none left out for its size, and over those that an adjustment did
        without; NaN if there are none.
    mean_mm
        What is left systematically.
    rejected_share
        Share whose weight in the robust loss fell below 0.1.
    systematic_mm
        Standard deviation of a group beyond the noise of its measurements.
    """

    kind: str
    observations: int
    rms_mm: float
    held_out_mm: float
    mean_mm: float
    rejected_share: float
    systematic_mm: float


@dataclass(frozen=True)
class ParameterEvidence:
    """One parameter: value, standard deviation, and the share of its variance that only the prior holds (0 to 1)."""

    name: str
    value: float
    sd: float
    from_prior: float


@dataclass(frozen=True)
class Agreement:
    """Difference of two height maps at the same places, robust and in full: median, median and 90th percentile size."""

    pair: str
    cells: int
    median_mm: float
    typical_mm: float
    p90_mm: float


@dataclass(frozen=True, eq=False)
class ScannerEvidence:
    """The whole account.

    Attributes
    ----------
    parts_used
        Parts of the capture that served as observations, in words.
    correlations
        Pairs of parameters above 0.95.
    unseen
        Parameters that no observation determines; a prior holds them.
    shape_sd_mm
        Root mean square uncertainty that the calibration gives to the shape of a scan over the swept volume, a motion
        of the whole excepted.
    before, after
        Agreement of the sensors on the same scan under the rig before and after.
    stray_share
        Share of the stripes that contradict their surroundings, per laser.
    """

    verdict: Verdict
    reasons: tuple[str, ...]
    parts_used: tuple[str, ...]
    groups: tuple[GroupEvidence, ...]
    parameters: tuple[ParameterEvidence, ...]
    correlations: tuple[tuple[str, str, float], ...]
    unseen: tuple[str, ...]
    shape_sd_mm: float
    before: tuple[Agreement, ...]
    after: tuple[Agreement, ...]
    stray_share: tuple[float, ...]
    camera_rms_px: float
    camera_held_out_px: float
    travel_rms_px: float
    travel_held_out_px: float
    travel_scale: float
    notes: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """The same as plain JSON values; what is not known is null."""
        return {name: _plain(value) for name, value in asdict(self).items()}


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value
