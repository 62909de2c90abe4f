"""A capture folder: pictures of any line-laser scanner with a known travel, in ordinary files.

`open_capture` checks everything it can see without decoding a picture; pictures are read when they are needed.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from twinline.errors import CaptureError
from twinline.geometry import nominal
from twinline.geometry.camera import Camera
from twinline.geometry.rig import Rig, TofMount
from twinline.recording.capture_json import CaptureInfo, read_capture_json
from twinline.recording.container_walk import is_container
from twinline.recording.csv_table import read_table
from twinline.recording.frame_list import list_files, list_pictures, open_frames, plain_name
from twinline.recording.frames import FrameSequence
from twinline.recording.images import PictureFile
from twinline.recording.rig_file import read_rig
from twinline.recording.tof import TofSamples, read_tof, reading_unit, tof_line

RECORDING_SUFFIX = ".mcap"
_MAX_HEIGHT_MM = 1e6


@dataclass(frozen=True)
class SheetPair:
    """One pose of the board with the stripes on it, and the same without; ``name`` is the files' common stem."""

    name: str
    on: PictureFile
    off: PictureFile


@dataclass(frozen=True)
class HeightView:
    """A block of known height in the stripe (0 is the bare bed), and the same view with the lasers off, if given."""

    path: PictureFile
    height_mm: float
    off: PictureFile | None


@dataclass(frozen=True, eq=False)
class Capture:
    """An opened capture: this class for a folder of ordinary files, `RecordedCapture` for recordings.

    Attributes
    ----------
    path
        The folder, or the recording.
    laser, reference
        Laser pass over the objects, and over the empty bed; None where there is none.
    laser_off
        A picture with the lasers off; None where there is none.
    """

    path: Path
    info: CaptureInfo
    laser: FrameSequence | None
    reference: FrameSequence | None
    laser_off: PictureFile | None

    @property
    def problems(self) -> tuple[str, ...]:
        """What is missing of the capture although it was opened; a sentence each."""
        return ()

    def views(self) -> tuple[PictureFile, ...]:
        """Views of the calibration board, by name."""
        return list_pictures(self.path / "camera")

    def motion(self) -> FrameSequence | None:
        """The board lying still while the cart travels; None where there is no such part.

        Raises
        ------
        CaptureError
            As `open_frames`.
        """
        folder = self.path / "motion"
        if not folder.is_dir():
            return None
        return open_frames(folder, self.info.image_size, len(self.info.lasers), timed=False)

    def sheets(self) -> tuple[SheetPair, ...]:
        """Poses of the board with the stripes on and off, by name.

        Raises
        ------
        CaptureError
            If a picture has no partner of the same name.
        """
        on, off = _by_stem(self.path / "sheets" / "on"), _by_stem(self.path / "sheets" / "off")
        for there, here, other in ((on, off, "off"), (off, on, "on")):
            for stem, path in there.items():
                if stem not in here:
                    folder = self.path / "sheets" / other
                    raise CaptureError(
                        f"{path} has no partner of the same name in {folder}; add it or remove this one."
                    )
        return tuple(SheetPair(stem, on[stem], off[stem]) for stem in sorted(on))

    def heights(self) -> tuple[HeightView, ...]:
        """Blocks of known height; none where there is no such part.

        Raises
        ------
        CaptureError
            If ``heights.csv`` is missing, malformed, or names a missing picture.
        """
        folder = self.path / "heights"
        if not folder.is_dir():
            return ()
        table = folder / "heights.csv"
        if not table.is_file() and (self.path / "heights.csv").is_file():
            table = self.path / "heights.csv"
        if not table.is_file():
            raise CaptureError(
                f"{table} is missing, so the heights are unknown; write it with the header frame,height_mm and one "
                "line per picture."
            )
        return _read_heights(table, folder)

    def tof(self) -> TofSamples | None:
        """The ToF pass; None where there is none.

        Raises
        ------
        CaptureError
            If ``samples.csv`` is malformed, or ``capture.json`` does not describe the sensor.
        """
        path = self._tof_path()
        if path is None:
            return None
        if self.info.tof is None:
            raise CaptureError(
                f"{path} exists, but {self.path / 'capture.json'} has no field tof; describe the sensor."
            )
        return read_tof(path, self.info.tof)

    def rig(self) -> Rig:
        """The nominal rig of this capture; its ToF part takes readings in the unit of ``tof/samples.csv``."""
        return nominal_rig(self.info, self._tof_unit() or "adc")

    @property
    def has_rig(self) -> bool:
        """Whether a rig came with the capture."""
        return (self.path / "rig.json").is_file()

    def own_rig(self) -> Rig | None:
        """The rig that came with the capture, calibrated or not; None where there is none.

        Raises
        ------
        RigError
            If it cannot be read.
        """
        path = self.path / "rig.json"
        return read_rig(path) if path.is_file() else None

    def _tof_unit(self) -> nominal.TofUnit | None:
        path = self._tof_path()
        return None if path is None else reading_unit(path)

    def _tof_path(self) -> Path | None:
        path = self.path / "tof" / "samples.csv"
        return path if path.is_file() else None


def open_capture(path: Path) -> Capture:
    """Open a capture and check its description, its frame lists and that the files are there.

    Parameters
    ----------
    path
        A capture folder, or its ``capture.json``; a recording, or a folder with the recordings of one scan.

    Raises
    ------
    CaptureError
        Naming the file and, in it, the field or the line.
    FrameError
        If a video cannot be read.
    """
    folder = path.parent if path.name == "capture.json" else path
    if folder.is_file():
        if is_container(folder):
            return _open_recordings(folder, [folder])
        raise CaptureError(
            f"{folder} is neither a recording nor a folder; unpack it, or give the folder that holds capture.json."
        )
    try:
        empty = not any(folder.iterdir())
    except FileNotFoundError as error:
        raise CaptureError(f"{folder} does not exist; give a capture folder.") from error
    except OSError as error:
        raise CaptureError(f"{folder} cannot be listed: {error.strerror or error}.") from error
    if empty:
        raise CaptureError(f"{folder} is empty; a capture folder holds capture.json and, for a laser pass, laser/.")
    recordings = sorted(folder.glob(f"*{RECORDING_SUFFIX}"))
    if recordings and not (folder / "capture.json").exists():
        return _open_recordings(folder, recordings)
    info = read_capture_json(folder / "capture.json")
    laser = _open_pass(folder / "laser", info)
    return Capture(folder, info, laser, _open_pass(folder / "reference", info), _laser_off(folder / "laser"))


def _open_recordings(path: Path, files: list[Path]) -> Capture:
    # A recording gives a kind of capture, so its module stands on this one.
    from twinline.recording.recorded_capture import open_recorded

    return open_recorded(path, files)


def nominal_rig(info: CaptureInfo, tof_unit: nominal.TofUnit = "adc") -> Rig:
    """The scanner as its owner describes it, before any calibration.

    Parameters
    ----------
    tof_unit
        Unit of the ToF readings the rig is for.

    Raises
    ------
    RigError
        If the description is impossible.
    CaptureError
        If the description of the ToF sensor lacks what the unit needs.
    """
    lasers = [(laser.baseline_mm, float(np.radians(laser.angle_deg)), laser.side) for laser in info.lasers]
    camera = Camera(info.camera_matrix_guess, info.image_size)
    tof = _nominal_tof(info, tof_unit)
    return nominal.nominal_rig(info.name, camera, info.stripe_runs, lasers, info.camera_height_mm, tof)


def _nominal_tof(info: CaptureInfo, unit: nominal.TofUnit) -> TofMount | None:
    if info.tof is None:
        return None
    gain, offset = tof_line(info.tof, unit)
    mount = nominal.nominal_tof(np.array(info.tof.mount_mm), info.tof.range_mm, "distance_mm")
    return replace(mount, gain_mm_per_unit=gain, offset_mm=offset)


def _open_pass(folder: Path, info: CaptureInfo) -> FrameSequence | None:
    if not folder.is_dir():
        return None
    return open_frames(folder, info.image_size, len(info.lasers))


def _laser_off(folder: Path) -> Path | None:
    found = [p for p in list_pictures(folder) if p.stem == "off"]
    if len(found) > 1:
        raise CaptureError(
            f"{folder} holds {' and '.join(p.name for p in found)}; keep one picture with the lasers off."
        )
    return found[0] if found else None


def _by_stem(folder: Path) -> Mapping[str, Path]:
    pictures: dict[str, Path] = {}
    for path in list_pictures(folder):
        if path.stem in pictures:
            raise CaptureError(f"{folder} holds {pictures[path.stem].name} and {path.name}; keep one of them.")
        pictures[path.stem] = path
    return pictures


def _read_heights(table: Path, folder: Path) -> tuple[HeightView, ...]:
    files = list_files(folder)
    views: list[HeightView] = []
    for row in read_table(table, ("frame", "height_mm"), ("off_frame",)):
        height = row.number("height_mm")
        if not 0 <= height <= _MAX_HEIGHT_MM:
            raise row.error(f"height_mm must be 0 (the bare bed) or above, not {height:g}.")
        names = [plain_name(row, "frame")]
        if row.cells.get("off_frame"):
            names.append(plain_name(row, "off_frame"))
        for name in names:
            if name not in files:
                raise row.error(f"{name} is not in {folder}; copy it there or remove the line.")
        views.append(HeightView(folder / names[0], height, folder / names[1] if len(names) > 1 else None))
    if not views:
        raise CaptureError(f"{table} lists no pictures; write one line per picture below the header.")
    return tuple(views)
