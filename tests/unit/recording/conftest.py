import json
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.unit.recording.sample_captures import description, write_pictures


@pytest.fixture
def write_capture(tmp_path: Path) -> Callable[..., Path]:
    """A function that writes a capture folder with the given frames and changes to ``capture.json``."""

    def write(frames: int = 5, suffix: str = ".png", **changes: object) -> Path:
        folder = tmp_path / "capture"
        folder.mkdir()
        (folder / "capture.json").write_text(json.dumps(description() | changes))
        if frames:
            write_pictures(folder / "laser", frames, suffix)
        return folder

    return write
