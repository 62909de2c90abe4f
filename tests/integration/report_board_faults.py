"""The table of faults of board and cable; ``python -m tests.integration.report_faults`` writes it."""

from pathlib import Path

from tests.integration.board_faults import FAULT_AFTER_S, FAULTS, Outcome

FILE = Path(__file__).resolve().parents[2] / "server" / "FAULTS.md"
HEAD = f"""\
## Faults of the board and its cable

What the driver alone makes of them, with nobody to wait and to go on: the machine is in the middle of something,
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
