"""``twinline bench``."""

import os
from pathlib import Path

import typer

from twinline.cli.progress import progress


def run_bench(*, json: bool, write: Path | None = None) -> None:
    """Measure, and print a table or JSON; with ``write``, also put the tables into that document."""
    # A linear-algebra library starts its threads when it is first imported, and several on one core would only get
    # into each other's way.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from twinline.bench.report import to_json, to_text, write_markdown
    from twinline.bench.suite import run_suite

    with progress("Measuring", quiet=json) as bar:
        report = run_suite(tell=lambda _, done, total: bar(done, total))
    typer.echo(to_json(report) if json else to_text(report))
    if write is not None:
        write_markdown(write, report)
    for name in report.missed:
        typer.echo(f"twinline: {name} misses its target.", err=True)
