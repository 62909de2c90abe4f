"""How long the command line takes to begin, against Python itself."""

import os
import subprocess
import sys
from pathlib import Path

import twinline
from twinline.bench.figures import Figure, Quartiles, Section
from twinline.bench.turns import Subject, compare, take_turns

PYTHON = "python -c pass"
VERSION = "twinline --version"
IMPORT = "import of the command line"
RECONSTRUCTION = "import of the reconstruction"
_US_PER_MS = 1e3


def start_up(rounds: int) -> Section:
    """Fresh processes, from their start to their end."""
    commands = {
        PYTHON: ["-c", "pass"],
        VERSION: ["-m", "twinline", "--version"],
        IMPORT: ["-c", "import twinline.cli"],
        RECONSTRUCTION: ["-c", "import twinline.reconstruction.offline"],
    }
    times = take_turns({name: _fresh(command) for name, command in commands.items()}, rounds, waiting=True)
    for name in times:
        times[name] /= _US_PER_MS
    figures = [
        Figure(name, Quartiles.of(times[name]), "ms", () if name == PYTHON else (compare(times, name, PYTHON),))
        for name in commands
    ]
    return Section(
        "start-up",
        "Start-up",
        "Processes from start to end, files and compiled code in the system's cache.",
        rounds,
        tuple(figures),
    )


def _fresh(arguments: list[str]) -> Subject:
    return lambda _: _run(arguments)


def _run(arguments: list[str]) -> None:
    # The same package as here, whether installed or on the path.
    here = str(Path(twinline.__file__).resolve().parents[1])
    path = os.pathsep.join(part for part in (here, os.environ.get("PYTHONPATH", "")) if part)
    subprocess.run(
        [sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL, env={**os.environ, "PYTHONPATH": path}
    )
