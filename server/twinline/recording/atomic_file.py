"""Files that are whole or not there."""

import errno
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from twinline.errors import OutputError

_NEXT_STEP = {
    errno.ENOSPC: "free some space or choose another disk",
    errno.EDQUOT: "free some space or ask for a larger quota",
    errno.EFBIG: "the file is larger than this system allows",
    errno.EACCES: "choose a folder you may write to",
    errno.EPERM: "choose a folder you may write to",
    errno.EROFS: "choose a disk that is not read-only",
    errno.ENOENT: "make its folder first",
    errno.ENOTDIR: "part of its path is a file, not a folder",
    errno.ENAMETOOLONG: "choose a shorter name",
}


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Write a file under a temporary name, then flush it to disk and rename it.

    A reader never sees half a file, and an earlier file of the same name stays until the new one is whole. The
    temporary file lies in the same folder, keeps the suffix, and is removed after any error.

    Parameters
    ----------
    path
        Name of the finished file. A link is followed; the file it points to is replaced.

    Yields
    ------
    Path
        Existing, empty temporary file to write to and close.

    Raises
    ------
    OutputError
        If the file cannot be made, written or renamed, also for any OSError of the block; names the path and the cause.
    """
    target = _target(path)
    temporary = target.parent / f".{secrets.token_hex(8)}.part{target.suffix}"
    try:
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        yield temporary
        with temporary.open("rb+") as stream:
            os.fsync(stream.fileno())
        temporary.replace(target)
        _sync_folder(target.parent)
    except OSError as error:
        raise output_error(path, error) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _target(path: Path) -> Path:
    target = Path(os.path.realpath(path))
    try:
        mode = target.stat().st_mode
    except FileNotFoundError:
        return target
    except OSError as error:
        raise output_error(path, error) from error
    if stat.S_ISDIR(mode):
        raise OutputError(f"{path} cannot be written: it is a folder; give a file name.")
    if not stat.S_ISREG(mode):
        raise OutputError(f"{path} cannot be written: it is not an ordinary file.")
    return target


def _sync_folder(folder: Path) -> None:
    """Make the rename itself durable, where folders can be opened."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def output_error(path: Path, error: OSError) -> OutputError:
    """What it means that a file cannot be written: the cause and the next step."""
    cause = (error.strerror or str(error)).lower()
    step = _NEXT_STEP.get(error.errno or 0)
    return OutputError(f"{path} cannot be written: {cause}{'; ' + step if step else ''}.")
