"""A run as a table to read, as JSON, and as the generated part of PERFORMANCE.md."""

import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from twinline.bench.figures import Figure, Quartiles, Ratio, Report, Section
from twinline.errors import OutputError

BEGIN = "<!-- bench: begin -->"
END = "<!-- bench: end -->"
_HEADER = ("measured", "median", "quartiles", "against", "ratio", "quartiles", "must / aim", "verdict")


def to_json(report: Report) -> str:
    """Everything, with the verdicts."""
    document = asdict(report)
    for section, found in zip(document["sections"], report.sections, strict=True):
        for figure, original in zip(section["figures"], found.figures, strict=True):
            for ratio, of in zip(figure["ratios"], original.ratios, strict=True):
                ratio["verdict"] = of.verdict
    document["machine"]["versions"] = dict(report.machine.versions)
    document["missed"] = list(report.missed)
    return json.dumps(document, indent=1)


def to_text(report: Report) -> str:
    """Tables for a terminal."""
    blocks = [_machine_line(report)]
    for section in report.sections:
        rows = [_HEADER, *_rows(section)]
        widths = [max(len(row[i]) for row in rows) for i in range(len(_HEADER))]
        lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
        blocks.append("\n".join([f"{section.title} ({section.rounds} rounds)", *lines]))
    return "\n\n".join(blocks)


def to_markdown(report: Report) -> str:
    """Tables for PERFORMANCE.md, between the markers."""
    blocks = [f"{BEGIN}\nWritten by `twinline bench --write`; do not edit by hand. {_machine_line(report)}"]
    for section in report.sections:
        rows = [_HEADER, ("---",) * len(_HEADER), *_rows(section)]
        table = "\n".join("| " + " | ".join(row) + " |" for row in rows)
        rounds = f"{section.rounds} rounds" if section.rounds > 1 else "one run"
        blocks.append(f"### {section.title}\n\n{section.method} {rounds.capitalize()}.\n\n{table}")
    return "\n\n".join(blocks) + f"\n{END}"


def write_markdown(path: Path, report: Report) -> None:
    """Put a run between the markers of a document, leaving the rest of it alone.

    Raises
    ------
    OutputError
        The document cannot be read or written, or has not exactly one pair of markers.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path} cannot be read: {error.strerror or error}.") from error
    before, begun, rest = text.partition(BEGIN)
    _, ended, after = rest.partition(END)
    if not (begun and ended) or BEGIN in rest:
        raise OutputError(f"{path} must hold one pair of lines {BEGIN} and {END}, between which the tables go.")
    try:
        path.write_text(before + to_markdown(report) + after, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}.") from error


def _machine_line(report: Report) -> str:
    machine = report.machine
    versions = ", ".join(f"{name} {number}" for name, number in machine.versions)
    caches = ", ".join(machine.caches) or "caches unknown"
    return f"{report.date}; {machine.processor}, {machine.cores} cores, {caches}; {machine.system}; {versions}."


def _rows(section: Section) -> Iterator[tuple[str, ...]]:
    for figure in section.figures:
        first = (figure.name, f"{_number(figure.value.median)} {figure.unit}", _spread(figure))
        if not figure.ratios:
            yield (*first, "", "", "", "", "")
        for place, ratio in enumerate(figure.ratios):
            yield (*(first if place == 0 else ("", "", "")), *_ratio_cells(ratio))


def _spread(figure: Figure) -> str:
    return _range(figure.value)


def _range(value: Quartiles) -> str:
    return "" if value.low == value.high else f"{_number(value.low)} to {_number(value.high)}"


def _ratio_cells(ratio: Ratio) -> tuple[str, ...]:
    must = "" if ratio.must is None else f"{ratio.must:g}"
    aim = "" if ratio.aim is None else f" / {ratio.aim:g}"
    return (ratio.against, f"{_number(ratio.value.median)} x", _range(ratio.value), must + aim, ratio.verdict)


def _number(value: float) -> str:
    """Three digits, and no exponents."""
    if value >= 100:
        return f"{value:.0f}"
    return f"{value:.1f}" if value >= 10 else f"{value:.2f}"
