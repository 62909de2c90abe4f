"""Calibration's smaller parts on real data: a sheet through a scanner's own points, rasters of a ToF sensor."""

import csv
import json
import shutil
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from twinline.calibration.observations import TofReadings, median_of_repeats
from twinline.calibration.sheets import sheet_from_points
from twinline.recording.capture import open_capture
from twinline.recording.tof import TofSamples

POINTS = 5975
PUBLISHED_NORMAL = (0.85110861, -0.00122944, 0.52498829)
PUBLISHED_OFFSET_MM = 159.526932
"""Least squares through all points, by the scanner's author."""

RASTERS = (
    "Apple 150mm No Backdrop",
    "Apple 150mm Plant Backdrop",
    "Apple 190mm, Backdrop 400mm",
    "Apple 30mm, Backdrop 400mm",
    "Apple 5mm, Backdrop 230mm",
)
INVALID = "36447"
INVALID_READINGS = {"Apple 150mm Plant Backdrop": 1, "Apple 5mm, Backdrop 230mm": 1}
READING_S = 0.05


def test_a_sheet_comes_out_of_its_points(shared_data: Callable[[str], Path]) -> None:
    content = (shared_data("ciclop_two_laser") / "laser-pc.ply").read_bytes()
    start = content.index(b"end_header\n") + len(b"end_header\n")
    rows = np.frombuffer(content[start:], dtype=[("p", "<f4", 3), ("colour", "u1", 3)], count=POINTS)
    points = rows["p"].astype(np.float64)
    sheet = sheet_from_points(points / points[:, 2:], 1.0 / points[:, 2], "+u")
    normal = np.array(PUBLISHED_NORMAL) / np.linalg.norm(PUBLISHED_NORMAL)
    assert np.degrees(np.arccos(min(float(sheet.normal @ normal), 1.0))) < 0.05
    assert sheet.offset_mm == pytest.approx(PUBLISHED_OFFSET_MM, abs=0.1)


class TestRaster:
    @pytest.mark.parametrize("name", RASTERS)
    def test_invalid_codes_are_no_readings_and_the_others_stay_as_they_are(
        self, name: str, shared_data: Callable[[str], Path], tmp_path: Path
    ) -> None:
        table = shared_data("tof_raster_apple") / f"{name}.csv"
        samples = imported(table, tmp_path)
        with table.open(encoding="utf-8") as stream:
            raw = np.array([float(row["lidar"]) for row in csv.DictReader(stream)])
        assert len(samples) == len(raw)
        invalid = ~np.isfinite(samples.reading)
        assert invalid.sum() == INVALID_READINGS.get(name, 0)
        assert (raw[invalid] == float(INVALID)).all()
        np.testing.assert_array_equal(samples.reading[~invalid], raw[~invalid])
        np.testing.assert_array_equal(samples.distance_mm[~invalid], raw[~invalid])

    @pytest.mark.parametrize("name", RASTERS)
    def test_each_place_gets_the_median_of_its_valid_readings(
        self, name: str, shared_data: Callable[[str], Path], tmp_path: Path
    ) -> None:
        table = shared_data("tof_raster_apple") / f"{name}.csv"
        samples = imported(table, tmp_path)
        places = median_of_repeats(TofReadings(samples.time_s, samples.cart_mm, samples.slide_mm, samples.reading))
        expected = medians(table)
        assert len(places) == len(expected)
        found = {(x, y): r for x, y, r in zip(places.cart_mm, places.slide_mm, places.reading, strict=True)}
        assert found == expected
        assert (np.diff(places.time_s) > 0).all()

    def test_a_wrong_first_reading_of_a_file_does_not_reach_its_place(
        self, shared_data: Callable[[str], Path], tmp_path: Path
    ) -> None:
        samples = imported(shared_data("tof_raster_apple") / "Apple 150mm No Backdrop.csv", tmp_path)
        readings = TofReadings(samples.time_s, samples.cart_mm, samples.slide_mm, samples.reading)
        assert samples.reading[0] == 388.0
        assert median_of_repeats(readings).reading[0] == 946.0


def imported(table: Path, folder: Path) -> TofSamples:
    """The raster as a capture's ToF pass: x is the cart, y the slide."""
    capture = folder / "capture"
    (capture / "tof").mkdir(parents=True)
    with table.open(encoding="utf-8") as stream, (capture / "tof" / "samples.csv").open("w", encoding="utf-8") as out:
        out.write("time_s,cart_mm,slide_mm,distance_mm\n")
        for number, row in enumerate(csv.DictReader(stream)):
            out.write(f"{number * READING_S:.2f},{row['x']},{row['y']},{row['lidar']}\n")
    description = {
        "name": "apple",
        "image_size": [1280, 720],
        "stripe_runs": "along-u",
        "camera_matrix_guess": [[1030, 0, 640], [0, 1030, 360], [0, 0, 1]],
        "camera_height_mm": 430.0,
        "lasers": [{"baseline_mm": 246.0, "angle_deg": 60.0, "side": "+v"}],
        "tof": {"range_mm": [10, 1200], "mount_mm": [0.0, 0.0, 400.0]},
    }
    (capture / "capture.json").write_text(json.dumps(description), encoding="utf-8")
    samples = open_capture(capture).tof()
    shutil.rmtree(capture)
    assert samples is not None
    return samples


def medians(table: Path) -> dict[tuple[float, float], float]:
    """Median of the valid readings at each place, straight from the table."""
    at: dict[tuple[float, float], list[float]] = defaultdict(list)
    with table.open(encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            if row["lidar"] != INVALID:
                at[float(row["x"]), float(row["y"])].append(float(row["lidar"]))
    return {place: float(np.median(values)) for place, values in at.items()}
