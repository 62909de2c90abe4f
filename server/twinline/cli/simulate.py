"""``twinline simulate``."""

from pathlib import Path

import typer

from twinline.cli.progress import progress
from twinline.devices.simulator.capture import render_capture


def run_simulate(output: Path, scene: str, seed: int, pitch_mm: float) -> None:
    """Render a scene into a new capture folder."""
    with progress("Frames") as report:
        rendered = render_capture(output, scene, seed=seed, pitch_mm=pitch_mm, report=report)
    typer.echo(f"{len(rendered.cart_mm)} frames of scene {scene}: {output}")
