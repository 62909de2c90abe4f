"""``twinline simulate``."""

from pathlib import Path

import typer

from twinline.cli.progress import progress
from twinline.devices.simulator.capture import render_capture


def run_simulate(output: Path, scene: str, seed: int, pitch_mm: float, parts: str = "") -> None:
    """Render a scene into a new capture folder.

    Parameters
    ----------
    scene
        Name of a built-in scene, or path of a mesh file.
    parts
        Comma-separated: camera, motion, tof; what the folder holds beside the laser pass.
    """
    wanted = frozenset(part.strip() for part in parts.split(",") if part.strip())
    with progress("Frames") as report:
        rendered = render_capture(output, scene, seed=seed, pitch_mm=pitch_mm, parts=wanted, report=report)
    beside = f", with {', '.join(sorted(wanted))}" if wanted else ""
    typer.echo(f"{len(rendered.cart_mm)} frames of scene {scene}{beside}: {output}")
