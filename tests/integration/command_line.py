"""The command line as a user meets it: a process, its exit status, and what it says and leaves behind."""

import os
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

Done = subprocess.CompletedProcess[str]


def twinline(
    *arguments: object, start: Sequence[str] = ("-m", "twinline"), before: Callable[[], None] | None = None
) -> Done:
    """Run the command to its end.

    Parameters
    ----------
    start
        How Python is told what to run.
    before
        Called in the new process before the command takes over.
    """
    command = [sys.executable, *start, *(str(argument) for argument in arguments)]
    environment = {**os.environ, "NO_COLOR": "1", "COLUMNS": "400"}
    return subprocess.run(
        command, capture_output=True, encoding="utf-8", check=False, env=environment, preexec_fn=before, timeout=240
    )


def files_below(folder: Path) -> set[str]:
    """Every file and folder below a folder, hidden ones too."""
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*")}


def require_refusal(done: Done, *words: str) -> str:
    """The command failed with one sentence, which holds all the words; returns the sentence."""
    assert done.returncode == 1, f"exit status {done.returncode}\n{done.stdout}\n{done.stderr}"
    assert done.stdout == ""
    assert done.stderr.startswith("twinline: ")
    assert done.stderr.endswith(".\n")
    sentence = done.stderr.removeprefix("twinline: ").removesuffix("\n")
    assert "\n" not in sentence
    assert not re.search(r"\. +[A-Z]", sentence), f"more than one sentence: {sentence}"
    for word in words:
        assert word in sentence, f"{word!r} is not in: {sentence}"
    return sentence
