"""Strict reading of JSON objects: every field is asked for by name, and what nobody asked for is an error."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import NoReturn, TypeVar, cast

from twinline.errors import CaptureError

MAX_NUMBER = 1e6
"""Largest number, in whatever unit, that describes a scanner."""

_Choice = TypeVar("_Choice", bound=str)


def parse_object(data: bytes, path: Path) -> "Fields":
    """The fields of the JSON object that a file holds.

    Raises
    ------
    CaptureError
        If it is not UTF-8, not JSON, not an object, gives a field twice, or holds NaN or Infinity.
    """
    try:
        value = json.loads(data.decode("utf-8-sig"), object_pairs_hook=_no_duplicates, parse_constant=_no_constant)
    except UnicodeDecodeError as error:
        raise CaptureError(f"{path} is not a text file in UTF-8.") from error
    except json.JSONDecodeError as error:
        raise CaptureError(f"{path} is not JSON: {error.msg} in line {error.lineno}, column {error.colno}.") from error
    except (ValueError, RecursionError) as error:
        raise CaptureError(f"{path} is not usable JSON: {error}.") from error
    return Fields(path, "", value)


class Fields:
    """The fields of one JSON object, each asked for once; what nobody asked for is unknown."""

    def __init__(self, path: Path, prefix: str, value: object) -> None:
        self._path = path
        self._prefix = prefix
        if not isinstance(value, dict):
            where = f"{prefix.rstrip('.')} " if prefix else ""
            raise CaptureError(f"{path}: {where}must be an object of named fields, not {_shown(value)}.")
        self._fields = cast("Mapping[str, object]", value)
        self._known: list[str] = []

    def fail(self, name: str, must: str) -> NoReturn:
        """Raise the error that says what a field must be and what it is."""
        raise CaptureError(f"{self._path}: {self._prefix}{name} must be {must}, not {_shown(self._fields[name])}.")

    def has(self, name: str) -> bool:
        """Whether an optional field is given; from now on it is known."""
        self._known.append(name)
        return name in self._fields

    def get(self, name: str) -> object:
        """The value of a required field, unchecked."""
        if not self.has(name):
            raise CaptureError(f"{self._path}: the field {self._prefix}{name} is missing.")
        return self._fields[name]

    def nested(self, name: str) -> "Fields":
        """The fields of a required object."""
        return Fields(self._path, f"{self._prefix}{name}.", self.get(name))

    def objects(self, name: str) -> list["Fields"]:
        """The fields of each object in a required list."""
        value = self.get(name)
        if not isinstance(value, list):
            self.fail(name, "a list")
        return [Fields(self._path, f"{self._prefix}{name}[{i}].", item) for i, item in enumerate(value)]

    def text(self, name: str) -> str:
        """A required text that is not blank."""
        value = self.get(name)
        # Half of a surrogate pair is legal in JSON but cannot be printed or written to any file.
        if not isinstance(value, str) or not value.strip() or not value.isprintable():
            self.fail(name, "a text in one line that is not empty")
        return value

    def choice(self, name: str, allowed: tuple[_Choice, ...]) -> _Choice:
        """A required text that is one of those allowed."""
        value = self.get(name)
        for choice in allowed:
            if value == choice:
                return choice
        self.fail(name, "one of " + ", ".join(f'"{a}"' for a in allowed))

    def number(self, name: str, low: float, high: float, *, open_low: bool = True) -> float:
        """A required number above ``low`` (or from it, if not ``open_low``) and at most ``high``."""
        value = as_number(self.get(name))
        if value is None or not low <= value <= high or (open_low and value == low):
            bounds = f"above {low:g} and at most {high:g}" if open_low else f"from {low:g} to {high:g}"
            self.fail(name, f"a number {bounds}")
        return value

    def whole(self, name: str, low: int, high: int) -> int:
        """A required whole number from ``low`` to ``high``."""
        value = self.get(name)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            self.fail(name, f"a whole number from {low} to {high}")
        return value

    def numbers(self, name: str, count: int) -> tuple[float, ...]:
        """A required list of ``count`` finite numbers of reasonable size."""
        value = self.get(name)
        numbers = [as_number(item) for item in value] if isinstance(value, list) and len(value) == count else []
        finite = tuple(n for n in numbers if n is not None and abs(n) <= MAX_NUMBER)
        if len(finite) != count:
            self.fail(name, f"a list of {count} numbers")
        return finite

    def done(self) -> None:
        """Raise an error for the first field that nobody asked for."""
        for name in self._fields:
            if name not in self._known:
                raise CaptureError(
                    f"{self._path}: the field {self._prefix}{_shown(name)[1:-1]} is unknown; "
                    f"known are {', '.join(self._known)}."
                )


def as_number(value: object) -> float | None:
    """The finite number a JSON value is; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def _shown(value: object) -> str:
    # Shortened before it is written out: a file may hold a number of thousands of digits.
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) > 10**30:
        return "so large a number"
    text = json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _no_duplicates(pairs: list[tuple[str, object]]) -> dict[str, object]:
    fields: dict[str, object] = {}
    for name, value in pairs:
        if name in fields:
            raise ValueError(f"the field {name[:60]!r} is given twice")
        fields[name] = value
    return fields


def _no_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a number in JSON")
