"""Unpacking a capture that came as a zip from anywhere."""

import shutil
import stat
import struct
import zipfile
import zlib
from collections.abc import Iterator
from lzma import LZMAError
from pathlib import Path, PurePosixPath

from twinline.errors import CaptureError, OutputError

DEFAULT_MAX_BYTES = 64 * 2**30
DEFAULT_MAX_FILES = 200_000

_BLOCK = 1 << 20
_MAX_DEPTH = 8
# One entry of the archive's directory: its fixed part, and names and extra fields of unusual length.
_ENTRY_BYTES = 46 + 1024
# Resource forks that one desktop system adds beside the files.
_FOREIGN_FOLDER = "__MACOSX"


def unpack_capture(
    zip_path: Path,
    target_folder: Path,
    *,
    max_bytes: int = DEFAULT_MAX_BYTES,
    max_files: int = DEFAULT_MAX_FILES,
) -> Path:
    """Unpack a zipped capture folder.

    Nothing is written outside ``target_folder``; links are refused; the limits hold for what really comes out of the
    archive, whatever it claims. After an error the target folder is as empty as before.

    Parameters
    ----------
    target_folder
        Missing or empty folder to unpack to.
    max_bytes, max_files
        Largest total size and number of files.

    Returns
    -------
    Path
        The folder that holds ``capture.json``: the target itself, or the only folder in it that has one.

    Raises
    ------
    CaptureError
        If the file is no zip, is damaged or encrypted, holds unsafe names or links, exceeds a limit, or holds no
        capture or several.
    OutputError
        If the target folder is not empty or cannot be written.
    """
    existed = target_folder.exists()
    try:
        target_folder.mkdir(parents=True, exist_ok=True)
        if any(target_folder.iterdir()):
            raise OutputError(f"{target_folder} is not empty; unpack to an empty folder.")
    except OSError as error:
        raise OutputError(f"{target_folder} cannot be used: {error.strerror or error}.") from error
    try:
        _unpack(zip_path, target_folder, max_bytes, max_files)
        return _find_capture(zip_path, target_folder)
    except BaseException:
        _remove_contents(target_folder)
        if not existed:
            target_folder.rmdir()
        raise


def _unpack(zip_path: Path, target: Path, max_bytes: int, max_files: int) -> None:
    try:
        if _directory_bytes(zip_path) > max_files * _ENTRY_BYTES:
            raise _too_many(zip_path, max_files)
        archive = zipfile.ZipFile(zip_path)
    except OSError as error:
        raise CaptureError(f"{zip_path} cannot be read: {error.strerror or error}.") from error
    except (zipfile.BadZipFile, ValueError, struct.error) as error:
        raise CaptureError(f"{zip_path} is not a zip file, or it is damaged.") from error
    with archive:
        entries = [e for e in archive.infolist() if PurePosixPath(e.filename).parts[:1] != (_FOREIGN_FOLDER,)]
        if len(entries) > max_files:
            raise _too_many(zip_path, max_files)
        left = max_bytes
        for entry in entries:
            destination = target / _safe_name(zip_path, entry)
            if entry.is_dir():
                _make_folder(destination)
                continue
            _make_folder(destination.parent)
            left = _unpack_file(zip_path, archive, entry, destination, left)
            if left < 0:
                raise CaptureError(
                    f"{zip_path} unpacks to more than {max_bytes} bytes; unpack it yourself, or split it."
                )


def _unpack_file(zip_path: Path, archive: zipfile.ZipFile, entry: zipfile.ZipInfo, destination: Path, left: int) -> int:
    """Unpack one file block by block; returns the bytes left of the allowance, negative once it is exceeded."""
    if entry.flag_bits & 1:
        raise CaptureError(f"{zip_path} is encrypted; make a zip without a password.")
    try:
        with destination.open("xb") as output:
            for block in _blocks(zip_path, archive, entry):
                left -= len(block)
                if left < 0:
                    break
                output.write(block)
    except FileExistsError as error:
        raise CaptureError(f"{zip_path} holds {entry.filename} twice.") from error
    except OSError as error:
        raise OutputError(f"{destination} cannot be written: {error.strerror or error}.") from error
    return left


def _blocks(zip_path: Path, archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> Iterator[bytes]:
    try:
        with archive.open(entry) as source:
            while block := source.read(_BLOCK):
                yield block
    except (zipfile.BadZipFile, zlib.error, LZMAError, EOFError, OSError, NotImplementedError, ValueError) as error:
        raise CaptureError(f"{zip_path} is damaged: {entry.filename} cannot be unpacked ({error}).") from error


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder} cannot be made: {error.strerror or error}.") from error


def _safe_name(zip_path: Path, entry: zipfile.ZipInfo) -> PurePosixPath:
    name = PurePosixPath(entry.filename)
    unsafe = (
        name.is_absolute()
        or not name.parts
        or ".." in name.parts
        or len(name.parts) > _MAX_DEPTH
        or any(ord(c) < 32 or c in '\\:*?"<>|' for c in entry.filename)
    )
    if unsafe:
        raise CaptureError(
            f"{zip_path} holds a file with the unsafe name {entry.filename[:80]!r}; nothing was unpacked."
        )
    mode = entry.external_attr >> 16
    if stat.S_IFMT(mode) not in (0, stat.S_IFREG, stat.S_IFDIR):
        raise CaptureError(f"{zip_path}: {entry.filename[:80]!r} is a link or a device; nothing was unpacked.")
    return name


def _too_many(zip_path: Path, max_files: int) -> CaptureError:
    return CaptureError(f"{zip_path} holds more than {max_files} files; unpack it yourself, or split it.")


def _directory_bytes(path: Path) -> int:
    """Size of the archive's directory as its end record states it; read before the directory is loaded as a whole."""
    with path.open("rb") as stream:
        length = stream.seek(0, 2)
        start = max(length - 22 - 65535 - 20, 0)
        stream.seek(start)
        tail = stream.read()
        at = tail.rfind(b"PK\x05\x06")
        if at < 0 or len(tail) < at + 22:
            raise zipfile.BadZipFile("no end record")
        size = int(struct.unpack_from("<L", tail, at + 12)[0])
        if at >= 20 and tail[at - 20 : at - 16] == b"PK\x06\x07":
            (offset,) = struct.unpack_from("<Q", tail, at - 12)
            stream.seek(min(offset, length))
            record = stream.read(56)
            size = max(size if size != 0xFFFFFFFF else 0, int(struct.unpack_from("<Q", record, 40)[0]))
    return size


def _find_capture(zip_path: Path, target: Path) -> Path:
    found = sorted(target.rglob("capture.json"), key=lambda p: len(p.parts))
    if not found:
        raise CaptureError(f"{zip_path} holds no capture.json; zip a whole capture folder.")
    if len(found) > 1 and len(found[0].parts) == len(found[1].parts):
        names = " and ".join(str(p.relative_to(target)) for p in found[:2])
        raise CaptureError(f"{zip_path} holds several captures ({names}); zip one capture folder.")
    return found[0].parent


def _remove_contents(folder: Path) -> None:
    for path in folder.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
