"""The verdict on a calibration: what makes it good, what leaves it usable, and what refuses it."""

from dataclasses import replace

import numpy as np
import pytest

from tests.unit.calibration.scanner_samples import crooked_rig
from twinline.calibration.joint import JointResult, first_scatter
from twinline.calibration.joint_types import Rows
from twinline.calibration.scanner import ScannerData, ScannerResult, scanner_of_rig
from twinline.calibration.scanner_evidence import (
    REFUSED_REJECTED,
    REFUSED_SATURATED,
    REFUSED_SHAPE_SD_MM,
    Agreement,
    GroupEvidence,
    Verdict,
)
from twinline.calibration.scanner_verdict import judge

FINE = (
    GroupEvidence("laser 1 on the bed", 60, 0.010, 0.011, 0.0, 0.0, 0.015),
    GroupEvidence("laser 2 on the bed", 60, 0.010, 0.011, 0.0, 0.0, 0.015),
    GroupEvidence("laser 1 against laser 2", 80, 0.020, 0.022, 0.0, 0.01, 0.02),
)
AGREED = (Agreement("laser 1 against laser 2", 900, 0.0, 0.03, 0.1),)


def result() -> ScannerResult:
    scanner = scanner_of_rig(crooked_rig())
    number = len(scanner.vector())
    none = np.empty(0)
    rows = Rows(none, none, none, np.empty(0, np.int64), np.empty(0, bool), np.empty((0, 2)), None)
    joint = JointResult(scanner, np.eye(number), rows, none, first_scatter(), np.eye(number), (), 0)
    return ScannerResult(
        scanner, scanner, np.eye(number), np.ones(number, bool), (), scanner, joint, joint, None, (), None, 1.0, ()
    )


def verdict(
    *, groups: tuple[GroupEvidence, ...] = FINE, after: tuple[Agreement, ...] = AGREED, shape_mm: float = 0.02,
    saturated: float = 0.0,
) -> tuple[Verdict, str]:  # fmt: skip
    # Camera and travel are not calibrated here; what is missing of them is no doubt then.
    data = ScannerData(crooked_rig(), frozenset({"sheets", "tof"}), saturated_share=(saturated, 0.0))
    found, reasons = judge(data, result(), groups, shape_mm, after, ())
    return found, " ".join(reasons)


def test_where_nothing_speaks_against_it_a_calibration_is_good() -> None:
    assert verdict() == ("good", "")


@pytest.mark.parametrize(
    ("change", "expected", "words"),
    [
        ({"shape_mm": 0.2}, "usable", "add what is missing"),
        ({"shape_mm": REFUSED_SHAPE_SD_MM + 1}, "refused", "objects of different heights"),
        ({"shape_mm": float("nan")}, "refused", "uncertain"),
        ({"saturated": 0.5}, "usable", "shorten the exposure"),
        ({"saturated": REFUSED_SATURATED + 0.05}, "refused", "95 % of the stripes of laser 1 are saturated"),
        ({"groups": FINE[:1]}, "refused", "No stripe of laser 2"),
        ({"groups": (*FINE[:2], replace(FINE[2], rejected_share=0.3))}, "usable", "30 % of the observations"),
        (
            {"groups": (*FINE[:2], replace(FINE[2], rejected_share=REFUSED_REJECTED + 0.1))},
            "refused",
            "contradict the others",
        ),
        ({"groups": (*FINE[:2], replace(FINE[2], systematic_mm=0.2))}, "usable", "more than their noise explains"),
        ({"groups": (*FINE[:2], replace(FINE[2], held_out_mm=0.3))}, "usable", "held-out groups miss by 0.300 mm"),
        ({"after": (replace(AGREED[0], p90_mm=0.9),)}, "usable", "one place in ten"),
        ({"after": (replace(AGREED[0], typical_mm=0.8, p90_mm=2.0),)}, "refused", "record the pass again"),
    ],
)
def test_each_trap_fails_with_the_next_step(change: dict[str, object], expected: Verdict, words: str) -> None:
    found, reasons = verdict(**change)  # type: ignore[arg-type]
    assert found == expected
    assert words in reasons


def test_what_refuses_comes_first() -> None:
    _, reasons = verdict(shape_mm=REFUSED_SHAPE_SD_MM + 1, saturated=0.5)
    assert reasons.index("objects of different heights") < reasons.index("shorten the exposure")
