"""Strict reading of the small CSV tables of a capture folder."""

import csv
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from twinline.errors import CaptureError

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_WHOLE = re.compile(r"\d{1,9}", re.ASCII)


@dataclass(frozen=True)
class Row:
    """One line of a table: where it stands and its cells by column name, without surrounding blanks."""

    path: Path
    line: int
    cells: dict[str, str]

    def error(self, cause: str) -> CaptureError:
        """The error that says what is wrong in this line."""
        return CaptureError(f"{self.path}, line {self.line}: {cause}")

    def text(self, column: str) -> str:
        """A cell that must not be empty."""
        value = self.cells[column]
        if not value:
            raise self.error(f"{column} is empty; write a value.")
        return value

    def number(self, column: str) -> float:
        """A cell that must be a finite decimal number."""
        value = self.text(column)
        number = parse_number(value)
        if number is None:
            raise self.error(f"{column} must be a number with a decimal point, not {value[:40]!r}.")
        return number


def parse_number(text: str) -> float | None:
    """The finite number a cell holds, in plain decimal notation with a point; None if it holds none."""
    if not _NUMBER.fullmatch(text):
        return None
    number = float(text)
    return number if math.isfinite(number) else None


def parse_whole(text: str) -> int | None:
    """The whole number, 0 or more and below a thousand million, that a cell holds; None if it holds none."""
    return int(text) if _WHOLE.fullmatch(text) else None


def read_table(path: Path, required: Sequence[str], optional: Sequence[str] = ()) -> Iterator[Row]:
    """Lines of a CSV file with a header, one after the other, so that a long table needs no memory.

    Columns may stand in any order. Empty lines are skipped.

    Parameters
    ----------
    path
        The file: UTF-8, comma separated.
    required, optional
        Names of the columns; any other name is an error.

    Raises
    ------
    CaptureError
        If the file cannot be read, a column is missing, unknown or there twice, or a line has too few or too many
        cells. Names the file and the line.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.reader(stream, strict=True)
            header = _header(path, next(reader, []), required, optional)
            for cells in reader:
                if not cells or (len(cells) == 1 and not cells[0].strip()):
                    continue
                if len(cells) != len(header):
                    raise CaptureError(
                        f"{path}, line {reader.line_num}: {len(cells)} values where the header names {len(header)} "
                        f"columns ({','.join(header)}); write one value per column, with a decimal point."
                    )
                values = (cell.strip() for cell in cells)
                yield Row(path, reader.line_num, dict(zip(header, values, strict=True)))
    except OSError as error:
        raise CaptureError(f"{path} cannot be read: {error.strerror or error}.") from error
    except UnicodeDecodeError as error:
        raise CaptureError(f"{path} is not a text file in UTF-8; save it as CSV in UTF-8.") from error
    except csv.Error as error:
        raise CaptureError(f"{path} is not a CSV file: {error}.") from error


def _header(path: Path, cells: Sequence[str], required: Sequence[str], optional: Sequence[str]) -> tuple[str, ...]:
    header = tuple(cell.strip() for cell in cells)
    expected = ",".join(required) + "".join(f"[,{name}]" for name in optional)
    if not any(header):
        raise CaptureError(f"{path} is empty; its first line must be {expected}.")
    for name in required:
        if name not in header:
            raise CaptureError(f"{path} has no column {name!r}; its first line must be {expected}.")
    for name in header:
        if name not in required and name not in optional:
            raise CaptureError(f"{path} has an unknown column {name[:40]!r}; its first line must be {expected}.")
        if header.count(name) > 1:
            raise CaptureError(f"{path} has the column {name!r} twice; its first line must be {expected}.")
    return header
