"""Small records on disk: a dataclass as a JSON file that is whole or absent."""

from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from twinline.errors import InputError, OutputError
from twinline.operations.exports.atomic import atomic_path

T = TypeVar("T")


def write_record(path: Path, record: object) -> None:
    """Write a dataclass as JSON; an older file stands until the new one is whole.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    with atomic_path(path) as temporary:
        temporary.write_bytes(_adapter(type(record)).dump_json(record, indent=1))


def read_record(kind: type[T], path: Path) -> T:
    """Read what `write_record` wrote.

    Raises
    ------
    InputError
        If the file cannot be read or is no such record; the field is named.
    """
    try:
        record: T = _adapter(kind).validate_json(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}.") from error
    except ValidationError as error:
        problem = error.errors()[0]
        where = ".".join(str(part) for part in problem["loc"]) or "the file"
        raise InputError(f"{path} is not a record of this version: {where}: {problem['msg']}.") from error
    return record


def make_folder(path: Path) -> Path:
    """Make a folder with its parents, if it is not there.

    Raises
    ------
    OutputError
        If it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"The folder {path} cannot be made: {error.strerror or error}.") from error
    return path


@lru_cache
def _adapter_of(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def _adapter(kind: Any) -> TypeAdapter[Any]:
    return _adapter_of(kind)
