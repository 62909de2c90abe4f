"""The captures that the server knows: uploaded, rendered, or folders of this machine that are used in place."""

import os
import shutil
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Literal
from uuid import uuid4

import structlog

from twinline.errors import CaptureError, InputError, NotFoundError, TwinlineError
from twinline.geometry.rig import Rig
from twinline.operations.clock import Clock
from twinline.operations.records import make_folder, read_record, write_record
from twinline.recording.capture import Capture

log = structlog.get_logger()

Origin = Literal["upload", "folder", "demo"]
RECORD_FILE = "capture-record.json"
GIVEN_RIG_FILE = "given-rig.json"


@dataclass(frozen=True)
class CaptureRecord:
    """One known capture.

    Attributes
    ----------
    path
        The capture folder.
    image_size
        Width and height in pixels.
    lasers
        Number of lasers.
    laser_frames, reference_frames
        Frames of the two passes; 0 where there is no such pass.
    has_rig
        Whether a calibrated rig is at hand, given or in the folder.
    """

    id: str
    name: str
    origin: Origin
    path: Path
    created_at: datetime
    image_size: tuple[int, int]
    stripe_runs: str
    lasers: int
    laser_frames: int
    reference_frames: int
    has_rig: bool


class CaptureShelf:
    """Keeps captures in a folder, each with its record.

    Any thread may call any method.

    Parameters
    ----------
    folder
        Made if it does not exist.
    open_capture, read_rig
        As in `twinline.recording`.
    """

    def __init__(
        self,
        folder: Path,
        clock: Clock,
        open_capture: Callable[[Path], Capture],
        read_rig: Callable[[Path], Rig],
    ) -> None:
        self._folder = make_folder(folder)
        self._clock = clock
        self._open = open_capture
        self._read_rig = read_rig
        self._lock = threading.Lock()
        self._records: dict[str, CaptureRecord] = {}

    def restore(self) -> None:
        """Read the records of earlier runs, and remove what an interrupted upload left."""
        for folder in self._folder.iterdir():
            path = folder / RECORD_FILE
            if not path.is_file():
                shutil.rmtree(folder, ignore_errors=True)
                continue
            try:
                record = read_record(CaptureRecord, path)
            except InputError as error:
                log.warning("capture record skipped", reason=error.detail)
                continue
            self._records[record.id] = record

    def records(self) -> list[CaptureRecord]:
        """All captures, newest first."""
        with self._lock:
            return sorted(self._records.values(), key=lambda record: record.created_at, reverse=True)

    def get(self, capture_id: str) -> CaptureRecord:
        """One capture.

        Raises
        ------
        NotFoundError
            If there is none with this id.
        """
        with self._lock:
            record = self._records.get(capture_id)
        if record is None:
            raise NotFoundError(f"There is no capture {capture_id}.")
        return record

    def add_folder(self, path: Path) -> CaptureRecord:
        """Use a folder of this machine in place; it is never changed.

        Raises
        ------
        CaptureError
            If it is no absolute path, or no usable capture.
        """
        path = path.expanduser()
        if not path.is_absolute():
            raise CaptureError(f"{path} is not an absolute path; give the whole path of the capture folder.")
        capture = self._open(path)
        return self._register(self._new_id(), capture, "folder")

    def add(self, origin: Origin, fill: Callable[[Path], Path]) -> CaptureRecord:
        """Make a capture of our own.

        Parameters
        ----------
        fill
            Writes the files into the folder it is given and returns the capture folder, the same or one inside.

        Raises
        ------
        CaptureError
            If what was written is no usable capture; nothing of it is kept then.
        """
        capture_id = self._new_id()
        folder = make_folder(self._folder / capture_id)
        files = make_folder(folder / "files")
        try:
            return self._register(capture_id, self._open(fill(files)), origin)
        except TwinlineError as error:
            # The sender knows the names inside the capture, not where the server put them.
            raise type(error)(error.detail.replace(f"{files}{os.sep}", ""), code=error.code) from error
        finally:
            if capture_id not in self._records:
                shutil.rmtree(folder, ignore_errors=True)

    def give_rig(self, capture_id: str, data: bytes) -> CaptureRecord:
        """Keep a rig for a capture; it is used before the capture's own.

        Raises
        ------
        RigError
            If it is no rig file; the rig given before is kept then.
        """
        record = self.get(capture_id)
        path = self._folder / capture_id / GIVEN_RIG_FILE
        trial = path.with_name(f"trial-{uuid4().hex[:8]}.json")
        try:
            trial.write_bytes(data)
            self._read_rig(trial)
            trial.replace(path)
        except TwinlineError as error:
            raise type(error)(error.detail.replace(str(trial), "The given rig.json"), code=error.code) from None
        finally:
            trial.unlink(missing_ok=True)
        return self._keep(replace(record, has_rig=True))

    def given_rig(self, capture_id: str) -> Path | None:
        """The rig file that `give_rig` kept."""
        path = self._folder / self.get(capture_id).id / GIVEN_RIG_FILE
        return path if path.is_file() else None

    def delete(self, capture_id: str) -> None:
        """Forget a capture; what the server itself holds of it is deleted."""
        self.get(capture_id)
        shutil.rmtree(self._folder / capture_id, ignore_errors=True)
        with self._lock:
            self._records.pop(capture_id, None)

    def _new_id(self) -> str:
        return f"c-{uuid4().hex[:12]}"

    def _register(self, capture_id: str, capture: Capture, origin: Origin) -> CaptureRecord:
        make_folder(self._folder / capture_id)
        info = capture.info
        return self._keep(
            CaptureRecord(
                id=capture_id,
                name=info.name,
                origin=origin,
                path=capture.path,
                created_at=self._clock.now(),
                image_size=(int(info.image_size[0]), int(info.image_size[1])),
                stripe_runs=info.stripe_runs,
                lasers=len(info.lasers),
                laser_frames=0 if capture.laser is None else len(capture.laser),
                reference_frames=0 if capture.reference is None else len(capture.reference),
                has_rig=capture.has_rig,
            )
        )

    def _keep(self, record: CaptureRecord) -> CaptureRecord:
        write_record(self._folder / record.id / RECORD_FILE, record)
        with self._lock:
            self._records[record.id] = record
        return record
