"""Stripes of the two-laser scanner's pictures as the command line finds them, and where they really are."""

import csv
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

INLIER_PX = 2.0
"""Rows further from the fitted line than this show something else, such as the glow where the board lets light in."""

BUST_ROWS = (54, 1119)
"""First and last image row in which the stripe lies on the bust, by the enlarged difference picture."""

RIM_ROWS, RIM_U = (1225, 1276), 779.0
"""Below the bust the same laser draws a short stripe on the rim of the turntable: real light, at a known place."""

FAINT_ROWS, FAINT_FROM, FAINT_TO = (1120, 1224), (1120.0, 599.0), (1224.0, 779.0)
"""Between the two it runs over the black top of the turntable, some 10 DN bright: real light as well."""

# fmt: off
_BUST_ROWS = [
    55.0, 96, 146, 207, 234, 262, 270, 300, 323, 373, 413, 504, 524, 534, 604, 610, 633, 641, 671,
    686, 746, 786, 847, 877, 912, 933, 963, 998, 1023, 1069, 1117,
]
_BUST_COLUMNS = [
    592.0, 560, 529, 512, 516, 553, 567, 578, 567, 571, 562, 555, 545, 524, 519, 550, 547, 558, 563,
    546, 567, 574, 567, 558, 557, 561, 541, 543, 550, 580, 598,
]
# fmt: on
"""Where the stripe on the bust bends, read off the enlarged difference picture."""

BUST_REACH_PX = 15.0
"""How far from that polyline the stripe may lie: it is drawn by eye, and the stripe itself is 10 px wide."""


@dataclass(frozen=True)
class Board:
    """A picture of both stripes on the chessboard, and the rows between which each crosses the board."""

    suffix: str
    right_rows: tuple[int, int]
    left_rows: tuple[int, int]

    def rows(self, laser: int) -> tuple[int, int]:
        """Of laser 1, the right one, or laser 2."""
        return self.right_rows if laser == 1 else self.left_rows


BOARDS = (Board("-x", (450, 1026), (459, 1018)), Board("", (460, 1020), (454, 1035)))


@dataclass(frozen=True)
class Straightness:
    """A robust straight line ``u = slope v + offset`` through a stripe on the board.

    Attributes
    ----------
    rows
        Image rows on the board.
    found, inliers
        How many of them gave a centre, and how many a centre within 2 px of the line.
    inlier_rms_px, all_rms_px
        Root mean square distance from the line over the inliers and over all that were found.
    """

    slope: float
    offset: float
    rows: int
    found: int
    inliers: int
    inlier_rms_px: float
    all_rms_px: float

    def at(self, v: float) -> float:
        """Where the line is in row ``v``."""
        return self.slope * v + self.offset


def find_stripes(picture: Path, off: Path | None, output: Path, *options: str) -> dict[int, Floats]:
    """Run ``twinline stripes``; rows (v, u) of each laser."""
    background = [] if off is None else ["--off", str(off)]
    command = [sys.executable, "-m", "twinline", "stripes", str(picture), "-o", str(output), *background, *options]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", check=False)
    if done.returncode:
        raise RuntimeError(done.stderr)
    stripes: dict[int, list[tuple[float, float]]] = {}
    with output.open(newline="", encoding="utf-8") as file:
        for line in csv.DictReader(file):
            stripes.setdefault(int(line["laser"]), []).append((float(line["v"]), float(line["u"])))
    return {laser: np.array(rows) for laser, rows in stripes.items()}


def straightness(stripe: Floats, rows: tuple[int, int], seed: int = 7) -> Straightness:
    """Fit a straight line to the part of a stripe (n, 2) between two image rows, whatever a minority of rows says."""
    v, u = stripe[(stripe[:, 0] >= rows[0]) & (stripe[:, 0] <= rows[1])].T
    rng = np.random.default_rng(seed)
    best = np.zeros(len(v), bool)
    for _ in range(300):
        a, b = rng.choice(len(v), 2, replace=False)
        slope = (u[b] - u[a]) / (v[b] - v[a])
        near = np.abs(u - u[a] - slope * (v - v[a])) < INLIER_PX
        best = near if near.sum() > best.sum() else best
    slope, offset = 0.0, 0.0
    for _ in range(5):
        slope, offset = (float(c) for c in np.polyfit(v[best], u[best], 1))
        best = np.abs(u - slope * v - offset) < INLIER_PX
    residual = u - slope * v - offset
    return Straightness(
        slope,
        offset,
        rows[1] - rows[0] + 1,
        len(v),
        int(best.sum()),
        float(np.sqrt(np.mean(residual[best] ** 2))),
        float(np.sqrt(np.mean(residual**2))),
    )


@dataclass(frozen=True)
class BustCount:
    """Rows of the bust picture, by what was found in them.

    Attributes
    ----------
    shown
        Rows that show the stripe on the bust.
    found
        How many of them gave a centre on it.
    false
        Rows with a centre where there is no laser light.
    rim, faint
        Rows with a centre on the real stripe on the turntable's rim, and on its black top.
    """

    shown: int
    found: int
    false: int
    rim: int
    faint: int


def count_bust(stripe: Floats) -> BustCount:
    """Sort the centres (v, u) of the bust picture."""
    v, u = stripe.T
    on_bust = (v >= BUST_ROWS[0]) & (v <= BUST_ROWS[1])
    on_bust &= np.abs(u - np.interp(v, _BUST_ROWS, _BUST_COLUMNS)) <= BUST_REACH_PX
    rim = (v >= RIM_ROWS[0]) & (v <= RIM_ROWS[1]) & (np.abs(u - RIM_U) < 8.0)
    between = np.interp(v, [FAINT_FROM[0], FAINT_TO[0]], [FAINT_FROM[1], FAINT_TO[1]])
    faint = (v >= FAINT_ROWS[0]) & (v <= FAINT_ROWS[1]) & (np.abs(u - between) < 12.0)
    return BustCount(
        shown=BUST_ROWS[1] - BUST_ROWS[0] + 1,
        found=int(on_bust.sum()),
        false=int((~on_bust & ~rim & ~faint).sum()),
        rim=int(rim.sum()),
        faint=int(faint.sum()),
    )
