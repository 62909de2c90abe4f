"""The scans that the server keeps: clouds in files, each with the account of how it came about."""

import shutil
import threading
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Literal
from uuid import uuid4

import structlog

from twinline.errors import InputError, NotFoundError
from twinline.operations.records import make_folder, read_record, write_record
from twinline.reconstruction.result import FrameProblem

log = structlog.get_logger()

RigOrigin = Literal["given", "uploaded", "capture", "nominal"]
RECORD_FILE = "scan.json"
PLY_FILE = "cloud.ply"
GLB_FILE = "cloud.glb"
MEDIA_TYPES = {PLY_FILE: "model/ply", GLB_FILE: "model/gltf-binary"}
"""Files of a scan and their types."""

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Scan:
    """One reconstructed pass.

    Attributes
    ----------
    bounds_mm
        Smallest and largest x, y, z in the bed frame; None for an empty cloud.
    median_sigma_mm
        Median of the points' standard deviation; None for an empty cloud.
    problems
        The first of `problem_count` frames that gave nothing.
    """

    id: str
    name: str
    job_id: str
    capture_id: str
    created_at: datetime
    points: int
    frames: int
    frames_used: int
    problem_count: int
    problems: tuple[FrameProblem, ...]
    counts: dict[str, int]
    warnings: tuple[str, ...]
    elapsed_s: float
    method: str
    sources: tuple[str, ...]
    every: int
    rig_name: str
    rig_origin: RigOrigin
    bounds_mm: tuple[Vector, Vector] | None
    median_sigma_mm: float | None
    software_version: str


@dataclass(frozen=True)
class ScanFile:
    """One file of a scan."""

    name: str
    path: Path
    media_type: str
    size_bytes: int


class ScanShelf:
    """Keeps scans in a folder; any thread may call any method.

    Parameters
    ----------
    folder
        Made if it does not exist.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = make_folder(folder)
        self._lock = threading.Lock()
        self._scans: dict[str, Scan] = {}

    def restore(self) -> None:
        """Read the records of earlier runs, and remove what an interrupted job left."""
        for folder in self._folder.iterdir():
            path = folder / RECORD_FILE
            if not path.is_file():
                shutil.rmtree(folder, ignore_errors=True)
                continue
            try:
                scan = read_record(Scan, path)
            except InputError as error:
                log.warning("scan record skipped", reason=error.detail)
                continue
            self._scans[scan.id] = scan

    def records(self) -> list[Scan]:
        """All scans, newest first."""
        with self._lock:
            return sorted(self._scans.values(), key=lambda scan: scan.created_at, reverse=True)

    def get(self, scan_id: str) -> Scan:
        """One scan.

        Raises
        ------
        NotFoundError
            If there is none with this id.
        """
        with self._lock:
            scan = self._scans.get(scan_id)
        if scan is None:
            raise NotFoundError(f"There is no scan {scan_id}.")
        return scan

    def new_folder(self) -> tuple[str, Path]:
        """An id and an empty folder for another scan; it counts once `keep` was called."""
        scan_id = f"s-{uuid4().hex[:12]}"
        return scan_id, make_folder(self._folder / scan_id)

    def discard(self, scan_id: str) -> None:
        """Remove the folder of a scan that did not come about."""
        shutil.rmtree(self._folder / scan_id, ignore_errors=True)

    def keep(self, scan: Scan) -> None:
        """Record a scan whose files are written.

        Raises
        ------
        OutputError
            If its record cannot be written.
        """
        write_record(self._folder / scan.id / RECORD_FILE, scan)
        with self._lock:
            self._scans[scan.id] = scan

    def files(self, scan_id: str) -> list[ScanFile]:
        """The files of a scan that exist; none of a scan that has been deleted."""
        paths = [(self._folder / scan_id / name, kind) for name, kind in MEDIA_TYPES.items()]
        return [ScanFile(path.name, path, kind, path.stat().st_size) for path, kind in paths if path.is_file()]

    def file(self, scan_id: str, name: str) -> ScanFile:
        """One file of a scan.

        Raises
        ------
        NotFoundError
            If the scan or the file does not exist.
        """
        for file in self.files(self.get(scan_id).id):
            if file.name == name:
                return file
        raise NotFoundError(f"Scan {scan_id} has no file {name}; it has {', '.join(MEDIA_TYPES)}.")

    def delete(self, scan_id: str) -> None:
        """Delete a scan and its files."""
        self.get(scan_id)
        with self._lock:
            self._scans.pop(scan_id, None)
        shutil.rmtree(self._folder / scan_id, ignore_errors=True)
