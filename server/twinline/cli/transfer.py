"""``twinline import`` and ``twinline export``."""

import json as json_text
from pathlib import Path

import typer

from twinline.cli.progress import progress
from twinline.errors import CaptureError
from twinline.recording.capture import open_capture
from twinline.recording.container_walk import is_container
from twinline.recording.folder_export import export_folder
from twinline.recording.folder_import import import_folder
from twinline.recording.recorded_capture import RecordedCapture
from twinline.recording.repair import repair


def run_import(source: Path, output: Path, *, json: bool) -> None:
    """Make a recording of a capture folder, or a whole recording of one that was cut off."""
    if source.is_file() and is_container(source):
        problems = repair(source, output)
        for problem in problems:
            typer.echo(f"twinline: {source}: {problem}.", err=True)
        _tell({"output": str(output), "problems": list(problems)}, f"repaired copy: {output}", json=json)
        return
    with progress("Pictures", quiet=json) as report:
        imported = import_folder(source, output, report=report)
    _tell(
        {"output": str(output), "pictures": imported.pictures, "readings": imported.readings, "problems": []},
        f"{imported.pictures} pictures and {imported.readings} ToF readings: {output}",
        json=json,
    )


def run_export(source: Path, output: Path, *, json: bool) -> None:
    """Make a capture folder of recordings."""
    capture = open_capture(source)
    if not isinstance(capture, RecordedCapture):
        raise CaptureError(
            f"{source} is a capture folder already; give a recording, or the folder of a scan's recordings."
        )
    with progress("Frames", quiet=json) as report:
        exported = export_folder(capture, output, report=report)
    for problem in exported.problems:
        typer.echo(f"twinline: {problem}", err=True)
    _tell(
        {
            "output": str(output),
            "pictures": exported.pictures,
            "readings": exported.readings,
            "problems": exported.problems,
        },
        f"{exported.pictures} pictures and {exported.readings} ToF readings: {output}",
        json=json,
    )


def _tell(summary: dict[str, object], line: str, *, json: bool) -> None:
    typer.echo(json_text.dumps(summary, indent=1) if json else line)
