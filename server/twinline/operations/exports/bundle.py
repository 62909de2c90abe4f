"""Zip of a scan: its results, recordings, settings and calibration in one file."""

import json
import zipfile
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

from twinline.errors import InputError, OutputError
from twinline.operations.exports.atomic import atomic_path
from twinline.operations.exports.provenance import Provenance

MANIFEST = "manifest.json"
# Compressed already: a second time costs minutes and saves nothing.
_STORED = frozenset({".jpg", ".jpeg", ".png", ".mcap", ".zip", ".mp4", ".avi"})


def write_zip(path: Path, files: Mapping[str, Path], provenance: Provenance) -> None:
    """Write files under given names, with a manifest of their sizes and of where they came from.

    Parameters
    ----------
    files
        Name inside the zip (with ``/`` between folders) and path of each file.

    Raises
    ------
    InputError
        If a name is absolute, leads out of the zip, or is that of the manifest, or a file cannot be read.
    OutputError
        If the zip cannot be written; nothing is left behind then.
    """
    for name, source in files.items():
        parts = PurePosixPath(name).parts
        if not parts or name.startswith("/") or ".." in parts or "\\" in name or name == MANIFEST:
            raise InputError(f"{name!r} cannot be the name of a file inside a zip; choose another one.")
        if not source.is_file():
            raise InputError(f"{source} is not there, so the scan cannot be packed; make it again or leave it out.")
    manifest = {
        "format": "twinline-scan",
        **dict(provenance.lines()),
        "files": {name: source.stat().st_size for name, source in files.items()},
    }
    with atomic_path(path) as temporary:
        try:
            with zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED, compresslevel=3) as archive:
                archive.writestr(MANIFEST, json.dumps(manifest, indent=1, ensure_ascii=False))
                for name, source in files.items():
                    stored = source.suffix.lower() in _STORED
                    archive.write(source, name, zipfile.ZIP_STORED if stored else zipfile.ZIP_DEFLATED)
        except (zipfile.BadZipFile, zipfile.LargeZipFile, ValueError) as error:
            raise OutputError(f"{path} cannot be written: {error}.") from error
