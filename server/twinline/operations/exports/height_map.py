"""Height maps as 16-bit pictures with their scale, and as a table.

TIFF is Adobe, "TIFF Revision 6.0" (1992), baseline with one strip; PNG is W3C, "Portable Network Graphics", third
edition.
"""

import json
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twinline.arrays import FloatArray
from twinline.errors import OutputError
from twinline.operations.exports.atomic import atomic_path
from twinline.operations.exports.provenance import Provenance

_LARGEST = 65535
# A micrometre a step, unless the heights need more.
_LEAST_STEP_MM = 0.001


@dataclass(frozen=True, eq=False)
class HeightMapArrays:
    """A height map to write.

    Attributes
    ----------
    z_mm : (ny, nx) array
        Heights at the cells' middles; NaN means "no measurement".
    x0_mm, y0_mm
        Place of the cell [0, 0].
    pitch_mm
        Distance of neighbouring cells.
    """

    z_mm: FloatArray
    x0_mm: float
    y0_mm: float
    pitch_mm: float


@dataclass(frozen=True, eq=False)
class HeightPicture:
    """A height map as 16-bit numbers.

    Attributes
    ----------
    pixels : (ny, nx) uint16 array
        The picture as seen from above: its first row has the largest y. 0 means "no measurement".
    scale : dict
        What the numbers mean: ``z = z_of_1_mm + (value - 1) * step_mm``, places, pitch.
    """

    pixels: NDArray[np.uint16]
    scale: dict[str, str | float]


def height_picture(path: Path, heights: HeightMapArrays, provenance: Provenance) -> HeightPicture:
    """The numbers of a picture and what they mean.

    Raises
    ------
    OutputError
        If nothing was measured.
    """
    known = np.isfinite(heights.z_mm)
    if not known.any():
        raise OutputError(f"{path} cannot be written: the height map has no measurement.")
    z = np.asarray(heights.z_mm, dtype=np.float64)
    low, high = float(z[known].min()), float(z[known].max())
    step = max(_LEAST_STEP_MM, (high - low) / (_LARGEST - 1))
    values = np.where(known, np.round((np.where(known, z, low) - low) / step) + 1.0, 0.0)
    ny = z.shape[0]
    scale: dict[str, str | float] = {
        "format": "twinline-height-map",
        "meaning": "z_mm = z_of_1_mm + (value - 1) * step_mm; 0 has no measurement; "
        "x_mm = x_of_first_column_mm + column * pitch_mm; y_mm = y_of_first_row_mm - row * pitch_mm",
        "z_of_1_mm": low,
        "step_mm": step,
        "x_of_first_column_mm": heights.x0_mm,
        "y_of_first_row_mm": heights.y0_mm + (ny - 1) * heights.pitch_mm,
        "pitch_mm": heights.pitch_mm,
        **dict(provenance.lines()),
    }
    return HeightPicture(values.astype(np.uint16)[::-1], scale)


def write_height_png(path: Path, heights: HeightMapArrays, provenance: Provenance) -> None:
    """Write a 16-bit gray PNG; the scale stands as JSON in its text ``Description``, the pitch in ``pHYs``.

    Raises
    ------
    OutputError
        If the file cannot be written, or nothing was measured; nothing is left behind then.
    """
    picture = height_picture(path, heights, provenance)
    ny, nx = picture.pixels.shape
    # Each row begins with its filter: 2 stands for the difference to the row above, which heights compress well by.
    rows = picture.pixels.astype(">u2").view(np.uint8).reshape(ny, 2 * nx)
    lines = np.empty((ny, 2 * nx + 1), np.uint8)
    lines[:, 0] = 2
    lines[0, 1:] = rows[0]
    lines[1:, 1:] = rows[1:] - rows[:-1]
    per_metre = round(1000.0 / heights.pitch_mm)
    text = json.dumps(picture.scale, ensure_ascii=True)
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        stream.write(b"\x89PNG\r\n\x1a\n")
        stream.write(_chunk(b"IHDR", struct.pack(">IIBBBBB", nx, ny, 16, 0, 0, 0, 0)))
        stream.write(_chunk(b"pHYs", struct.pack(">IIB", per_metre, per_metre, 1)))
        stream.write(_chunk(b"tEXt", b"Description\0" + text.encode("ascii")))
        stream.write(_chunk(b"IDAT", zlib.compress(lines.tobytes(), 6)))
        stream.write(_chunk(b"IEND", b""))


def write_height_tiff(path: Path, heights: HeightMapArrays, provenance: Provenance) -> None:
    """Write a 16-bit gray TIFF; the scale stands as JSON in ``ImageDescription``, the pitch in the resolution.

    Raises
    ------
    OutputError
        If the file cannot be written, or nothing was measured; nothing is left behind then.
    """
    picture = height_picture(path, heights, provenance)
    ny, nx = picture.pixels.shape
    text = json.dumps(picture.scale, ensure_ascii=True).encode("ascii") + b"\0"
    text += b"\0" * (len(text) % 2)
    data = picture.pixels.astype("<u2").tobytes()
    # Pixels per centimetre as a fraction, exact to a nanometre of pitch.
    resolution = struct.pack("<II", 10_000_000, max(round(heights.pitch_mm * 1_000_000), 1))
    short, long, ascii_, rational = 3, 4, 2, 5
    after = 8 + 2 + 13 * 12 + 4
    places = (after, after + len(text), after + len(text) + 8)
    tags = (
        (256, long, 1, nx),
        (257, long, 1, ny),
        (258, short, 1, 16),
        (259, short, 1, 1),
        (262, short, 1, 1),
        (270, ascii_, len(text), places[0]),
        (273, long, 1, places[2]),
        (277, short, 1, 1),
        (278, long, 1, ny),
        (279, long, 1, len(data)),
        (282, rational, 1, places[1]),
        (283, rational, 1, places[1]),
    )
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        stream.write(b"II*\0" + struct.pack("<IH", 8, 13))
        for tag, kind, number, value in (*tags, (296, short, 1, 3)):
            stream.write(struct.pack("<HHII", tag, kind, number, value))
        stream.write(struct.pack("<I", 0) + text + resolution + data)


def write_height_csv(path: Path, heights: HeightMapArrays) -> None:
    """Write a table: x in the first line, y at the beginning of each further one, an empty cell for no measurement.

    Raises
    ------
    OutputError
        If the file cannot be written; nothing is left behind then.
    """
    ny, nx = heights.z_mm.shape
    x = heights.x0_mm + heights.pitch_mm * np.arange(nx)
    with atomic_path(path) as temporary, temporary.open("w", encoding="ascii", newline="\n") as stream:
        stream.write(",".join(["y_mm\\x_mm", *(f"{value:.4f}" for value in x.tolist())]) + "\n")
        stream.writelines(_table_lines(heights, ny))


def _table_lines(heights: HeightMapArrays, ny: int) -> Iterator[str]:
    for row in range(ny):
        cells = ["" if value != value else f"{value:.4f}" for value in heights.z_mm[row].tolist()]
        yield ",".join([f"{heights.y0_mm + row * heights.pitch_mm:.4f}", *cells]) + "\n"


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
