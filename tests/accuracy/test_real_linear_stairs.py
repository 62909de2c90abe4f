"""A printed staircase under a real laser: three treads whose heights their author measured with a caliper.

The rig is nominal: the author's own baseline and stand-off, and the focal length from his scale at the bed. The bed
seen in the reference pass is subtracted position by position. The command line does it all, from pictures to PLY.
"""

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.integration.ply_points import read_points

HEIGHT_MM, BASELINE_MM = 80.0, 37.3
FOCAL_PX = 10.6277 * HEIGHT_MM
CENTRE_PX = (320.0, 240.0)
BUDGET_MM = 0.30
"""The author's own evaluation, a red centroid against the reference, comes within 0.29 mm."""

VALID_SHARE = 0.95


@dataclass(frozen=True)
class Tread:
    """A tread, and where it is seen.

    In the raw pictures its stripe, displaced by 23, 53 or 88 px, is saturated in these frames between these image rows,
    both included, without a gap.
    """

    height_mm: float
    frames: tuple[int, int]
    rows: tuple[int, int]

    @property
    def columns(self) -> int:
        """Rows times frames that show it."""
        return (self.frames[1] - self.frames[0] + 1) * (self.rows[1] - self.rows[0] + 1)


TREADS = (
    Tread(4.69, (11, 24), (193, 358)),
    Tread(9.63, (28, 41), (187, 364)),
    Tread(14.55, (45, 59), (181, 371)),
)


@dataclass(frozen=True)
class Stairs:
    """The command's cloud, with the frame and the image row of each point."""

    z_mm: np.ndarray[tuple[int], np.dtype[np.float64]]
    frame: np.ndarray[tuple[int], np.dtype[np.int64]]
    row: np.ndarray[tuple[int], np.dtype[np.int64]]
    summary: dict[str, object]

    def heights(self, tread: Tread) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """Heights of all points in the rows and frames that show a tread."""
        seen = (self.frame >= tread.frames[0]) & (self.frame <= tread.frames[1])
        seen &= (self.row >= tread.rows[0]) & (self.row <= tread.rows[1])
        return self.z_mm[seen]


def write_capture(data: Path, folder: Path) -> Path:
    """The data set as a capture folder, its pictures linked."""
    for source, target in (("stairs", "laser"), ("reference", "reference")):
        (folder / target).mkdir(parents=True)
        lines = ["frame,time_s,cart_mm"]
        for place, picture in enumerate(sorted((data / source).glob("*.jpg"))):
            (folder / target / picture.name).symlink_to(picture)
            lines.append(f"{picture.name},{place},{place}")
        (folder / target / "frames.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    angle = float(np.degrees(np.arctan2(HEIGHT_MM, BASELINE_MM)))
    description = {
        "name": "printed stairs",
        "image_size": [640, 480],
        "stripe_runs": "along-v",
        "camera_matrix_guess": [[FOCAL_PX, 0, CENTRE_PX[0]], [0, FOCAL_PX, CENTRE_PX[1]], [0, 0, 1]],
        "camera_height_mm": HEIGHT_MM,
        "lasers": [{"baseline_mm": BASELINE_MM, "angle_deg": angle, "side": "-u"}],
    }
    (folder / "capture.json").write_text(json.dumps(description), encoding="utf-8")
    return folder


def scan(capture: Path, cloud: Path, *options: str) -> Stairs:
    """Run the command and read its PLY with a reader that is not the package's own."""
    command = [sys.executable, "-m", "twinline", "reconstruct", str(capture), "-o", str(cloud), "--json", *options]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", check=False)
    assert done.returncode == 0, done.stderr
    points = read_points(cloud)
    # Back to where a point was seen, by the nominal geometry: the sheet meets height z at x = -baseline z / height.
    row = CENTRE_PX[1] - points[:, 1] * FOCAL_PX / (HEIGHT_MM - points[:, 2])
    frame = points[:, 0] + BASELINE_MM * points[:, 2] / HEIGHT_MM
    assert max(np.abs(row - np.rint(row)).max(), np.abs(frame - np.rint(frame)).max()) < 1e-3
    return Stairs(points[:, 2], np.rint(frame).astype(int), np.rint(row).astype(int), json.loads(done.stdout))


@pytest.fixture(scope="module")
def stairs(shared_data: Callable[[str], Path], tmp_path_factory: pytest.TempPathFactory) -> Stairs:
    folder = tmp_path_factory.mktemp("stairs")
    return scan(write_capture(shared_data("linear_stairs"), folder / "capture"), folder / "stairs.ply")


@pytest.mark.parametrize("tread", TREADS, ids=lambda tread: f"{tread.height_mm} mm")
def test_each_tread_has_its_caliper_height(tread: Tread, stairs: Stairs) -> None:
    heights = stairs.heights(tread)
    assert float(np.median(heights)) == pytest.approx(tread.height_mm, abs=BUDGET_MM)
    near = heights[np.abs(heights - tread.height_mm) < 1.0]
    assert float(near.mean()) == pytest.approx(tread.height_mm, abs=BUDGET_MM)


@pytest.mark.parametrize("tread", TREADS, ids=lambda tread: f"{tread.height_mm} mm")
def test_nearly_every_row_of_a_tread_gives_a_point_on_it(tread: Tread, stairs: Stairs) -> None:
    on_it = np.abs(stairs.heights(tread) - tread.height_mm) < BUDGET_MM
    assert on_it.sum() / tread.columns >= VALID_SHARE


def test_the_bed_beside_the_stairs_is_flat_and_at_zero(stairs: Stairs) -> None:
    beside = stairs.z_mm[(stairs.row < 150) | (stairs.row > 410)]
    assert len(beside) > 0.9 * 65 * (150 + 480 - 411)
    assert abs(float(np.median(beside))) < 0.1
    assert np.mean(np.abs(beside) < BUDGET_MM) > 0.99


def test_nothing_lies_outside_the_part(stairs: Stairs) -> None:
    assert np.percentile(stairs.z_mm, 0.1) > -BUDGET_MM
    assert np.percentile(stairs.z_mm, 99.9) < TREADS[-1].height_mm + BUDGET_MM


def test_the_summary_says_that_the_rig_is_nominal_and_every_frame_is_used(stairs: Stairs) -> None:
    assert stairs.summary["frames"] == stairs.summary["frames_used"] == 65
    assert stairs.summary["points"] == len(stairs.z_mm)
    assert any("nominal" in str(warning) for warning in stairs.summary["warnings"])  # type: ignore[attr-defined]


def test_treads_are_seen_where_their_stripe_is_saturated(shared_data: Callable[[str], Path]) -> None:
    # The frames and rows above, checked against the raw pictures by a plain threshold.
    import cv2

    pictures = sorted((shared_data("linear_stairs") / "stairs").glob("*.jpg"))
    for tread, displaced_px in zip(TREADS, (306, 275, 239), strict=True):
        for frame in (tread.frames[0] - 1, *tread.frames, tread.frames[1] + 1):
            red = np.asarray(cv2.imread(str(pictures[frame])))[tread.rows[0] : tread.rows[1] + 1, :, 2]
            lit = float((red[:, displaced_px - 6 : displaced_px + 7].max(axis=1) > 200).mean())
            assert lit > 0.97 if tread.frames[0] <= frame <= tread.frames[1] else lit < 0.7
