"""What a recording says about itself before its first frame: which pass, which scanner, how set, by which software."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal, TypeAlias, get_args
from uuid import uuid4

from twinline import __version__
from twinline.errors import CaptureError
from twinline.geometry.rig import Rig
from twinline.geometry.rig_json import rig_from_json
from twinline.recording.capture_json import CaptureInfo, parse_capture_json

PassKind: TypeAlias = Literal["laser", "tof", "capture"]
"""What was recorded: a laser pass, a ToF pass, or whatever a capture folder held."""

FORMAT = 1
"""Grows when a recording can no longer be read as before."""

METADATA = "twinline"
_KINDS: tuple[PassKind, ...] = get_args(PassKind)
CAPTURE_FILE, RIG_FILE, SETTINGS_FILE = "capture.json", "rig.json", "settings.json"


def new_scan_id() -> str:
    """An identity for a scan; every pass of it carries the same."""
    return f"s-{uuid4().hex[:12]}"


@dataclass(frozen=True, eq=False)
class PassHeader:
    """The head of a recording.

    Attributes
    ----------
    kind
        In a ToF pass, and only there, the telemetry's samples of the distance sensor are its readings.
    capture
        Text of the ``capture.json`` that describes the scanner.
    scan_id
        Passes of one scan share it.
    leg
        0 for the first recording of a part; 1, 2, ... for those that continue it after an interruption.
    started_at
        When the recording began.
    host_time_s
        The same moment in host time, which frames and telemetry are stamped with.
    rig
        Text of the ``rig.json`` in use; None where there was none.
    settings
        Whatever else was set: camera controls, speeds, the board's description. JSON values only.
    adc_per_count
        What the telemetry's ``adc`` is divided by to give counts of the converter that ``capture.json`` describes.
    adc_valid : (float, float) or None
        The telemetry's ``adc`` outside these limits is no reading: the sensor saw nothing within its range. None where
        no limits are known.
    share_places
        For parts that were made from a video: the frames at which a worker's share best begins.
    """

    kind: PassKind
    capture: str
    scan_id: str = field(default_factory=new_scan_id)
    leg: int = 0
    started_at: datetime = field(default_factory=lambda: datetime.now(UTC))
    host_time_s: float = 0.0
    rig: str | None = None
    settings: Mapping[str, object] = field(default_factory=dict)
    software_version: str = __version__
    adc_per_count: float = 1.0
    adc_valid: tuple[float, float] | None = None
    share_places: Mapping[str, tuple[int, ...]] = field(default_factory=dict)

    def info(self, path: Path) -> CaptureInfo:
        """The scanner's description; ``path`` is for an error's words only.

        Raises
        ------
        CaptureError
            If the text is no such description.
        """
        return parse_capture_json(self.capture.encode(), path / CAPTURE_FILE)

    def read_rig(self) -> Rig | None:
        """The rig that was in use.

        Raises
        ------
        RigError
            If the text is no rig.
        """
        return None if self.rig is None else rig_from_json(self.rig)

    def metadata(self) -> dict[str, str]:
        """What the container keeps as its metadata record."""
        return {
            "format": str(FORMAT),
            "kind": self.kind,
            "scan_id": self.scan_id,
            "leg": str(self.leg),
            "started_at": self.started_at.isoformat(),
            "host_time_s": repr(float(self.host_time_s)),
            "software_version": self.software_version,
            "adc_per_count": repr(float(self.adc_per_count)),
            "adc_valid": json.dumps(self.adc_valid),
            "share_places": json.dumps(self.share_places),
        }

    def files(self) -> dict[str, bytes]:
        """What the container keeps as attachments, by name."""
        files = {CAPTURE_FILE: self.capture.encode(), SETTINGS_FILE: json.dumps(self.settings, indent=1).encode()}
        if self.rig is not None:
            files[RIG_FILE] = self.rig.encode()
        return files


def parse_header(path: Path, metadata: Mapping[str, str] | None, files: Mapping[str, bytes]) -> PassHeader:
    """The head of a recording from the container's records.

    Raises
    ------
    CaptureError
        If the container was not written by Twinline, by a newer version, or is damaged at its very beginning.
    """
    if metadata is None:
        raise CaptureError(
            f"{path} does not say what it holds: it was not written by Twinline, or it was cut off right "
            "at its beginning."
        )
    try:
        written = int(metadata["format"])
        if written > FORMAT:
            raise CaptureError(
                f"{path} has recording format {written}, and this version reads up to {FORMAT}; update Twinline."
            )
        places = json.loads(metadata["share_places"])
        valid = json.loads(metadata.get("adc_valid", "null"))
        header = PassHeader(
            kind=next(kind for kind in _KINDS if kind == metadata["kind"]),
            capture=files[CAPTURE_FILE].decode(),
            scan_id=metadata["scan_id"],
            leg=int(metadata["leg"]),
            started_at=datetime.fromisoformat(metadata["started_at"]),
            host_time_s=float(metadata["host_time_s"]),
            rig=files[RIG_FILE].decode() if RIG_FILE in files else None,
            settings=json.loads(files.get(SETTINGS_FILE, b"{}")),
            software_version=metadata["software_version"],
            adc_per_count=float(metadata["adc_per_count"]),
            adc_valid=None if valid is None else (float(valid[0]), float(valid[1])),
            share_places={str(part): tuple(int(i) for i in row) for part, row in places.items()},
        )
    except (LookupError, ValueError, AttributeError, TypeError, StopIteration) as error:
        raise CaptureError(f"{path} is damaged at its beginning ({error}); nothing of it can be used.") from error
    if not (math.isfinite(header.host_time_s) and header.adc_per_count > 0 and header.started_at.tzinfo):
        raise CaptureError(f"{path} is damaged at its beginning; nothing of it can be used.")
    return header
