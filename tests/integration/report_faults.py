"""Writes the tables of faults: ``python -m tests.integration.report_faults``."""

from pathlib import Path
from tempfile import TemporaryDirectory

from tests.integration import board_faults, report_board_faults
from tests.integration.scan_faults import BEFORE, FAULT_AT_MM, FAULT_ROW, FAULTS, Fault, Outcome, outcome

FILE = Path(__file__).resolve().parents[2] / "server" / "FAULTS.md"
HEAD = f"""\
# Faults, what happens, and what the user reads

Written by `python -m tests.integration.report_faults` (do not edit by hand), from the same faults that
`tests/integration/test_scan_faults.py` and `test_board_faults.py` let happen on the simulated machine.

## Faults during a scan

The fault comes before the scan begins, in the laser pass while the cart is at {FAULT_AT_MM:g} mm, or in row
{FAULT_ROW + 1} of the ToF pass. *Dark after* is the time from then until truly no laser shone; with a full disk it is
that of the next write, at most half a second. In no case does anything hang; in all of them the lasers are off and the
axes stand in the end, and what was recorded opens again. A pass that goes on does so where it stopped: there is no gap
and no overlap of more than the distance of two lines.

| fault | during | what happens | dark after | what the user reads |
|---|---|---|---|---|
"""


def table(outcomes: list[Outcome]) -> str:
    """The part of the file that tells of scans."""
    rows = []
    for fault, seen in zip(FAULTS, outcomes, strict=True):
        dark = "-" if seen.dark_after_ms is None else f"{-(-seen.dark_after_ms // 50) * 50} ms"
        if seen.dark_after_ms is not None and seen.dark_after_ms <= 10:
            dark = "at once"
        rows.append(f"| {fault.name} | {fault.during} | {_happens(fault, seen)} | {dark} | {seen.reads or '-'} |\n")
    return HEAD + "".join(rows)


def _happens(fault: Fault, seen: Outcome) -> str:
    if seen.code:
        return f"{'does not begin' if fault.during == BEFORE else 'ends'}: `{seen.code}`"
    if seen.legs > 1:
        return "stops, and goes on by itself"
    if fault.harmless:
        return "is completed"
    return "is completed, and noticed" if seen.reads else "is completed; **not noticed**"


def main() -> None:
    with TemporaryDirectory() as folder:
        outcomes = [outcome(fault, Path(folder) / str(number)) for number, fault in enumerate(FAULTS)]
    board = report_board_faults.table([board_faults.outcome(fault) for fault in board_faults.FAULTS])
    FILE.write_text(f"{table(outcomes)}\n{board}", encoding="utf-8")


if __name__ == "__main__":
    main()
