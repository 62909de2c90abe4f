"""Rig files: a calibrated scanner as ``rig.json``."""

from pathlib import Path

from twinline.errors import RigError
from twinline.geometry.rig import Rig
from twinline.geometry.rig_json import rig_from_json, rig_to_json
from twinline.recording.atomic_file import atomic_path

_MAX_BYTES = 50_000_000


def read_rig(path: Path) -> Rig:
    """Read a rig.

    Raises
    ------
    RigError
        If the file cannot be read, or is no rig; names the file and the field.
    """
    try:
        with path.open("rb") as stream:
            data = stream.read(_MAX_BYTES + 1)
    except OSError as error:
        raise RigError(f"{path} cannot be read: {error.strerror or error}.") from error
    if len(data) > _MAX_BYTES:
        raise RigError(f"{path} is larger than {_MAX_BYTES} bytes; it is no rig file.")
    try:
        return rig_from_json(data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise RigError(f"{path} is not a text file in UTF-8.") from error
    except RigError as error:
        raise RigError(f"{path}: {error.detail}", code=error.code) from error


def write_rig(path: Path, rig: Rig) -> None:
    """Write a rig under a temporary name, flush it and rename it, so that a reader never sees half of it.

    Raises
    ------
    OutputError
        If the file cannot be written; nothing is left behind then.
    RigError
        If the rig holds something that JSON cannot.
    """
    text = rig_to_json(rig)
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
