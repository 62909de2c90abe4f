"""Strict reading of JSON objects: every field is named in what goes wrong with it."""

import json
import math

import numpy as np

from twinline.arrays import FloatArray
from twinline.errors import RigError


def parse_object(text: str) -> "Fields":
    """The top-level object of a JSON text.

    Raises
    ------
    RigError
        The text is not JSON, holds NaN or Infinity, names a field twice, or is not an object.
    """
    try:
        value = json.loads(text, object_pairs_hook=_without_duplicates, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise RigError(f"The rig is not valid JSON: {error}.") from error
    return Fields(value, "")


def _without_duplicates(pairs: list[tuple[str, object]]) -> dict[str, object]:
    fields = dict(pairs)
    if len(fields) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"the field {max(names, key=names.count)!r} is given twice")
    return fields


def _refuse_constant(name: str) -> object:
    raise ValueError(f"{name} is not a JSON number")


class Fields:
    """The fields of one JSON object; each may be taken once, and `finish` refuses those that nobody took.

    Parameters
    ----------
    path
        Where the object stands, as in ``sheets[1]``; empty for the top level.
    """

    def __init__(self, value: object, path: str) -> None:
        if not isinstance(value, dict):
            raise wrong(path, "must be an object {...}", value)
        self._left: dict[str, object] = dict(value)
        self.path = path

    def path_of(self, name: str) -> str:
        """Full path of a field."""
        return f"{self.path}.{name}" if self.path else name

    def has(self, name: str) -> bool:
        """Whether the field is there, not yet taken, and not null."""
        return self._left.get(name) is not None

    def take(self, name: str) -> object:
        """Any value, as it is."""
        if name not in self._left:
            raise RigError(f"The rig lacks the field {self.path_of(name)}.")
        return self._left.pop(name)

    def finish(self) -> None:
        """Refuse fields that were not taken; null counts as absent only for fields that are known."""
        if self._left:
            names = ", ".join(self.path_of(name) for name in self._left)
            raise RigError(f"The rig has the unknown field {names}: correct its spelling or remove it.")

    def drop_null(self, *names: str) -> None:
        """Treat null in these optional fields as absent."""
        for name in names:
            if name in self._left and self._left[name] is None:
                del self._left[name]

    def text(self, name: str) -> str:
        """A string."""
        value = self.take(name)
        if not isinstance(value, str):
            raise wrong(self.path_of(name), "must be a text", value)
        return value

    def number(self, name: str) -> float:
        """A finite number."""
        return _number(self.take(name), self.path_of(name))

    def whole(self, name: str) -> int:
        """A whole number."""
        value = self.take(name)
        if isinstance(value, bool) or not isinstance(value, int):
            raise wrong(self.path_of(name), "must be a whole number", value)
        return value

    def vector(self, name: str, length: int) -> FloatArray:
        """Finite numbers, exactly ``length`` of them."""
        return np.array(_numbers(self.take(name), length, self.path_of(name)))

    def matrix(self, name: str, rows: int, columns: int) -> FloatArray:
        """Finite numbers, ``rows`` lists of ``columns`` each."""
        path, value = self.path_of(name), self.take(name)
        if not isinstance(value, list) or len(value) != rows:
            raise wrong(path, f"must be a list of {rows} rows", value)
        numbers = [_numbers(row, columns, f"{path}[{i}]") for i, row in enumerate(value)]
        return np.array(numbers, dtype=np.float64).reshape(rows, columns)

    def texts(self, name: str) -> tuple[str, ...]:
        """A list of strings."""
        path, value = self.path_of(name), self.take(name)
        if not isinstance(value, list):
            raise wrong(path, "must be a list of texts", value)
        for i, item in enumerate(value):
            if not isinstance(item, str):
                raise wrong(f"{path}[{i}]", "must be a text", item)
        return tuple(value)

    def child(self, name: str) -> "Fields":
        """A nested object."""
        return Fields(self.take(name), self.path_of(name))

    def children(self, name: str) -> list["Fields"]:
        """A list of nested objects."""
        path, value = self.path_of(name), self.take(name)
        if not isinstance(value, list):
            raise wrong(path, "must be a list of objects", value)
        return [Fields(item, f"{path}[{i}]") for i, item in enumerate(value)]

    def rest(self) -> dict[str, object]:
        """All fields that are left, as they are."""
        taken, self._left = self._left, {}
        return taken


def wrong(path: str, expected: str, value: object) -> RigError:
    """The error for a field that holds something else than expected."""
    shown = json.dumps(value)
    shown = shown if len(shown) <= 60 else shown[:57] + "..."
    return RigError(f"The rig's field {path} {expected}, not {shown}." if path else f"A rig {expected}, not {shown}.")


def _number(value: object, path: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise wrong(path, "must be a number", value)
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise RigError(f"The rig's field {path} is too large for a number.")
    return number


def _numbers(value: object, length: int, path: str) -> list[float]:
    if not isinstance(value, list) or len(value) != length:
        raise wrong(path, f"must be a list of {length} numbers", value)
    return [_number(item, f"{path}[{i}]") for i, item in enumerate(value)]
