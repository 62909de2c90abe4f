"""The calibration report: everything that its page shows, in plain numbers, so that a server can pass it on."""

from dataclasses import dataclass, fields, is_dataclass
from typing import Any, Literal

import numpy as np

from twinline.calibration.scanner_evidence import Agreement, GroupEvidence, ScannerEvidence, Verdict

Method = Literal["joint", "thesis"]
Seen = Literal["seen", "prior", "fixed"]
"""Whether observations determine a quantity, a prior holds it, or it was not adjusted."""


@dataclass(frozen=True)
class Histogram:
    """Counts of values in bins of ``width`` from ``low`` on; ``below`` and ``above`` lie outside of them."""

    low: float
    width: float
    counts: tuple[int, ...]
    below: int
    above: int

    @property
    def total(self) -> int:
        """Number of values."""
        return sum(self.counts) + self.below + self.above


@dataclass(frozen=True)
class GroupReport:
    """Residuals of one kind of observation: figures, and how they spread.

    Attributes
    ----------
    residuals
        All of them, in millimetres along the surface's normal.
    rejected
        Those among them that the robust loss gave up.
    held_out
        Those of a fifth that an adjustment did without; None if there are none.
    """

    figures: GroupEvidence
    residuals: Histogram
    rejected: Histogram
    held_out: Histogram | None


@dataclass(frozen=True)
class Quantity:
    """One property of the scanner in words: before, by either method, how sure, and whether it is seen.

    Attributes
    ----------
    decimals
        How many a reader wants to see.
    before, thesis, joint
        NaN where the method does not say.
    sd
        Standard deviation of the joint value; 0 where it was not adjusted.
    """

    part: str
    name: str
    unit: str
    decimals: int
    before: float
    thesis: float
    joint: float
    sd: float
    seen: Seen


@dataclass(frozen=True)
class HeightDifferences:
    """Map of one sensor's heights less another's.

    Attributes
    ----------
    low_mm
        x, y of its corner in the bed frame.
    size_mm
        Of a cell.
    reach_mm
        Up to where differences are worth telling apart; the same for all rigs.
    rows_mm
        Rows along y, columns along x (the travel); None where not both saw the place.
    """

    low_mm: tuple[float, float]
    size_mm: float
    reach_mm: float
    rows_mm: tuple[tuple[float | None, ...], ...]


@dataclass(frozen=True)
class PairReport:
    """How two sensors agree under one rig: figures on objects, typical size of the difference on the bed, picture."""

    figures: Agreement
    bed_typical_mm: float
    histogram: Histogram
    differences: HeightDifferences


@dataclass(frozen=True)
class Profile:
    """Points of one sensor on one line along the travel."""

    sensor: str
    x_mm: tuple[float, ...]
    height_mm: tuple[float, ...]


@dataclass(frozen=True)
class ScanUnderRig:
    """The same scan under one rig.

    Attributes
    ----------
    label
        "before", "thesis" or "joint".
    """

    label: str
    rig: str
    pairs: tuple[PairReport, ...]
    profiles: tuple[Profile, ...]


@dataclass(frozen=True)
class Convergence:
    """A Nelder-Mead run: best value so far and its parameters by iteration, and how large the simplex still was."""

    name: str
    value_name: str
    values: tuple[float, ...]
    parameters: dict[str, tuple[float, ...]]
    simplex_size: tuple[float, ...]
    restarts: tuple[int, ...]
    evaluations: int
    settled_after: int


@dataclass(frozen=True)
class ThesisReport:
    """The thesis's method on the same data: one line of figures per step, the runs, and what is weak.

    ``failure`` says why it gave nothing; without it and without runs it was not tried.
    """

    failure: str
    steps: tuple[tuple[str, str], ...]
    runs: tuple[Convergence, ...]
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class ViewReport:
    """One picture of the board: verdict, what to do about it, errors in pixels, and where its points lie."""

    name: str
    verdict: str
    used: bool
    reason: str
    rms_px: float
    held_out_px: float
    tilt_deg: float
    direction_deg: float
    corners_px: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class CoverageReport:
    """Where in the image and under which tilts the board was shown.

    Attributes
    ----------
    share
        Of a grid's cells with at least one point; NaN where no camera came of the views.
    advice
        Missing or not, and in words.
    """

    image_size: tuple[int, int]
    share: float
    views: tuple[ViewReport, ...]
    advice: tuple[tuple[bool, str], ...]


@dataclass(frozen=True)
class CalibrationReport:
    """The whole report.

    Attributes
    ----------
    capture, rig
        Names of the capture and of the rig that came of it.
    rig_id
        Of the rig; empty where the calibration was refused.
    made
        When, RFC 3339; software version in ``version``.
    method
        Which method's rig this is.
    verdict, code, reasons
        Of that method. ``code`` is the error's where it was refused, else empty.
    parts_used
        What it was calibrated from, in words.
    sources
        Where each part of the rig comes from.
    joint_failure
        Why the joint adjustment gave nothing; empty where it did.
    evidence
        The joint adjustment's whole account; None without it.
    scans
        The same scan before and under the result of each method.
    """

    capture: str
    rig: str
    rig_id: str
    made: str
    version: str
    method: Method
    verdict: Verdict
    code: str
    reasons: tuple[str, ...]
    parts_used: tuple[str, ...]
    sources: dict[str, str]
    joint_failure: str
    evidence: ScannerEvidence | None
    groups: tuple[GroupReport, ...]
    quantities: tuple[Quantity, ...]
    scans: tuple[ScanUnderRig, ...]
    thesis: ThesisReport
    coverage: CoverageReport | None

    def to_json(self) -> dict[str, Any]:
        """The same as plain JSON values; what is not known is null."""
        plain = plain_json(self)
        assert isinstance(plain, dict)
        return plain


def plain_json(value: Any) -> Any:
    """Dataclasses as objects, sequences as arrays, numbers that are not finite as null."""
    if isinstance(value, ScannerEvidence):
        return value.to_json()
    if is_dataclass(value):
        return {f.name: plain_json(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, dict):
        return {k: plain_json(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain_json(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value
