"""Writes the table of faults of board and cable: ``python -m tests.integration.report_board_faults``."""

from pathlib import Path

from tests.integration.board_faults import FAULT_AFTER_S, FAULTS, Outcome, outcome

FILE = Path(__file__).resolve().parents[2] / "server" / "FAULTS.md"
HEAD = f"""\
# Faults of the board and its cable

Written by `python -m tests.integration.report_board_faults` (do not edit by hand), from the same faults that
`tests/integration/test_board_faults.py` lets happen: the simulated machine is in the middle of something,
{FAULT_AFTER_S:g} s after its beginning, when the fault comes. *Dark after* is the time from then until no laser
shone; in no case does anything hang, and in each the machine works again after the remedy.

| fault | during | what happens | dark after | what the user reads | remedy |
|---|---|---|---|---|---|
"""


def table(outcomes: list[Outcome]) -> str:
    """The whole file."""
    rows = []
    for fault, seen in zip(FAULTS, outcomes, strict=True):
        happens = f"ends with `{seen.code}`" if seen.code else "is completed"
        if fault.during == "laser pass" and seen.code:
            happens += f"; the cart goes on {seen.moved_on_mm:.0f} mm"
        elif fault.during == "laser pass" and seen.moved_on_mm < 1.0:
            happens += " by the count of steps, but the cart stood"
        dark = "-" if seen.dark_after_ms is None else f"{max(seen.dark_after_ms, 1)} ms"
        if seen.dark_after_ms == 0:
            dark = "at once"
        rows.append(
            f"| {fault.name} | {fault.during} | {happens} | {dark} | {seen.reads or '-'} | {fault.remedy or '-'} |\n"
        )
    return HEAD + "".join(rows)


def main() -> None:
    FILE.write_text(table([outcome(fault) for fault in FAULTS]), encoding="utf-8")


if __name__ == "__main__":
    main()
