"""Sections of ACCURACY.md that programs write between two markers."""

import sys
from collections.abc import Sequence
from pathlib import Path

ACCURACY = Path(__file__).resolve().parents[2] / "server" / "ACCURACY.md"
HEADING = "# Accuracy: measured\n"


def with_section(text: str, name: str, body: str) -> str:
    """The file with a section replaced, or appended where there is none yet."""
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    block = f"{begin}\n{body.strip()}\n{end}\n"
    if begin in text and end in text:
        before, rest = text.split(begin, 1)
        return before + block + rest.split(end, 1)[1].removeprefix("\n")
    return f"{(text or HEADING).rstrip()}\n\n{block}"


def write_section(name: str, body: str, arguments: Sequence[str]) -> None:
    """Put a section into ACCURACY.md; with ``--print`` among the arguments, on standard output instead."""
    if "--print" in arguments:
        sys.stdout.write(body)
        return
    text = ACCURACY.read_text(encoding="utf-8") if ACCURACY.exists() else HEADING
    ACCURACY.write_text(with_section(text, name, body), encoding="utf-8")
