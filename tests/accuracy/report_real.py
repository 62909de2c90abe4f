"""Measures the real data sets and writes what it finds into ACCURACY.md: ``python -m tests.accuracy.report_real``.

With ``--print`` the section goes to standard output and the file stays as it is. The data stand beside the checkout or
where ``TWINLINE_DATA`` says, as for the tests.
"""

import os
import shutil
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tests.accuracy.ciclop_stripes import BOARDS, count_bust, find_stripes, straightness
from tests.accuracy.rendered_scans import unfiltered
from tests.accuracy.rendered_truth import RenderedTruth, Score, read_truth
from tests.accuracy.report_section import write_section
from tests.accuracy.test_real_linear_stairs import TREADS, Stairs, scan, write_capture
from twinline.fusion.cloud import Source
from twinline.reconstruction.offline import reconstruct
from twinline.reconstruction.result import ReconstructionOptions
from twinline.recording.capture import Capture, open_capture
from twinline.stripe import METHODS

REPOSITORY = Path(__file__).resolve().parents[2]


def data(name: str) -> Path:
    """Folder of a data set."""
    root = Path(os.environ.get("TWINLINE_DATA") or REPOSITORY.parent / "shared" / "data")
    if not (root / name).is_dir():
        raise SystemExit(f"The data set {name} is not in {root}; set TWINLINE_DATA to the folder that holds it.")
    return root / name


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)]) + "\n"


def score_row(name: str, score: Score) -> list[str]:
    return [
        name,
        str(score.points),
        f"{score.rms_mm:.4f}",
        f"{score.objects_mm:.4f}",
        f"{score.median_mm:.4f}",
        f"{100 * score.gross:.4f} %",
        f"{100 * score.covered:.2f} %",
    ]


def rendered_rows(capture: Capture, truth: RenderedTruth) -> list[list[str]]:
    default = reconstruct(capture, truth.rig)
    points = default.cloud.points_mm
    rows = [
        ["must", "", "0.085", "0.100", "", "0.02 %", "92.5 %"],
        ["plain centroid, edges dropped (given)", "", "0.086", "0.100", "", "0.014 %", "92.9 %"],
        score_row("**maximum-likelihood, the default**", truth.score(points)),
    ]
    rows += [
        score_row(f"- of these, laser {source}", truth.score(points[default.cloud.source == source]))
        for source in (Source.LASER_1, Source.LASER_2)
    ]
    rows.append(score_row("- with points at edges kept", truth.score(unfiltered(capture, truth.rig).points_mm)))
    for method in METHODS[1:]:
        cloud = reconstruct(capture, truth.rig, ReconstructionOptions(method)).cloud
        rows.append(score_row(method, truth.score(cloud.points_mm)))
    return rows


def stairs_rows(stairs: Stairs) -> list[list[str]]:
    rows = []
    for tread in TREADS:
        heights = stairs.heights(tread)
        near = heights[np.abs(heights - tread.height_mm) < 1.0]
        valid = (np.abs(heights - tread.height_mm) < 0.3).sum() / tread.columns
        rows.append(
            [
                f"{tread.height_mm} mm",
                f"{np.median(heights):.3f} mm",
                f"{np.median(heights) - tread.height_mm:+.3f} mm",
                f"{near.std():.3f} mm" if len(near) > 1 else "",
                f"{100 * valid:.1f} % of {tread.columns}",
            ]
        )
    return rows


def board_rows(folder: Path) -> list[list[str]]:
    rows = []
    pictures = data("ciclop_two_laser") / "lasers_on_pattern"
    for board in BOARDS:
        for subtract in (True, False):
            off = pictures / f"laser-background-0-255-255-8{board.suffix}.png" if subtract else None
            options = () if subtract else ("--runs", "along-v", "--lasers", "2")
            picture = pictures / f"laser-0-255-255-8{board.suffix}.png"
            stripes = find_stripes(picture, off, folder / "stripes.csv", *options)
            for laser in (1, 2):
                line = straightness(stripes[laser], board.rows(laser))
                rows.append(
                    [
                        f"{picture.name}, {'right' if laser == 1 else 'left'}",
                        "yes" if subtract else "no",
                        f"u = {line.slope:.5f} v + {line.offset:.2f}",
                        f"{line.found} of {line.rows}",
                        f"{line.inliers}",
                        f"{line.inlier_rms_px:.3f} px",
                        f"{line.all_rms_px:.3f} px",
                    ]
                )
    return rows


def bust_rows(folder: Path) -> list[list[str]]:
    rows = []
    pictures = data("ciclop_two_laser") / "laser_on_object"
    for subtract in (True, False):
        off = pictures / "laser_background.png" if subtract else None
        count = count_bust(find_stripes(pictures / "laser.png", off, folder / "bust.csv")[1])
        rows.append(
            [
                "yes" if subtract else "no",
                f"{count.found} of {count.shown} ({100 * count.found / count.shown:.1f} %)",
                str(count.false),
                str(count.rim),
                str(count.faint),
            ]
        )
    return rows


def section() -> str:
    """The section with all its tables."""
    capture = open_capture(data("rendered_sample"))
    truth = read_truth(capture.path)
    scored = ["", "points", "RMS, mm", "on objects, mm", "median, mm", "beyond 1 mm", "covered"]
    with TemporaryDirectory() as name:
        folder = Path(name)
        source = data("linear_stairs")
        stairs = scan(write_capture(source, folder / "stairs"), folder / "stairs.ply")
        alone = write_capture(source, folder / "alone")
        shutil.rmtree(alone / "reference")
        without = scan(alone, folder / "alone.ply")
        boards, bust = board_rows(folder), bust_rows(folder)
    measured = ["caliper", "median", "error", "scatter", "rows within 0.3 mm"]
    return f"""## Real data

Written by `python -m tests.accuracy.report_real` (do not edit by hand); asserted by `python -m pytest tests/accuracy`.
The data sets are described in their own README files; none of them was made by code of this project.

### rendered_sample: a whole capture with known truth, true rig

Distance to the true surface of all points within 55 x 90 mm of the origin, clipped at 5 mm, and of those above 2 mm;
covered: share of the surface seen from above, on a grid of 0.5 mm, within 0.5 mm of a point
(`tests/accuracy/rendered_truth.py`).

{table(scored, rendered_rows(capture, truth))}
### linear_stairs: printed stairs, nominal rig, heights by caliper

The author's baseline, stand-off and scale as the rig, the reference pass subtracted position by position; must: 0.30 mm
and 95 % of the rows. A row counts in every frame in which the raw picture shows the tread's stripe saturated
(`tests/accuracy/test_real_linear_stairs.py`).

{table(measured, stairs_rows(stairs))}
Without the reference pass, from where the nominal rig expects the bed:

{table(measured, stairs_rows(without))}
### ciclop_two_laser: both stripes on the board

A robust straight line through the rows on the board; inliers lie within 2 px of it. Must: 0.40 px over the inliers,
with the laser-off picture (the scanner's own software: 0.37 and 0.38 px). Without it the direction has to be told.

{table(["stripe", "off subtracted", "line", "found", "inliers", "RMS of inliers", "RMS of all found"], boards)}
### ciclop_two_laser: the bust

Rows that show the stripe on the bust were established by hand; must: 95 % of them and fewer than 20 false rows, with
the laser-off picture. The same laser draws a real stripe on the turntable's rim (49 rows) and, some 10 DN bright,
across its black top; these are counted by themselves. Without the laser-off picture the turntable's bright edge is
taken for a stripe in rows that show none.

{table(["off subtracted", "found on the bust", "false rows", "rim", "faint"], bust)}"""


if __name__ == "__main__":
    write_section("real data", section(), sys.argv[1:])
