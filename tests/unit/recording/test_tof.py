from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from twinline.errors import CaptureError
from twinline.recording.capture_json import TofNominal
from twinline.recording.tof import read_tof

SENSOR = TofNominal((60.0, 140.0), (-118.0, 0.0, 139.0), (-4.0, 4.0), 4096)


def write(folder: Path, unit: str, *readings: str) -> Path:
    path = folder / "samples.csv"
    lines = [f"{i * 0.01:.2f},{i // 2},{-i},{reading}" for i, reading in enumerate(readings)]
    path.write_text("\n".join([f"time_s,cart_mm,slide_mm,{unit}", *lines]))
    return path


@pytest.mark.parametrize(
    ("unit", "readings"),
    [("adc", ["0", "4095", "2047.5"]), ("volts", ["-4", "4", "0"]), ("distance_mm", ["60", "140", "100"])],
)
def test_readings_become_distances_over_the_range(tmp_path: Path, unit: str, readings: list[str]) -> None:
    samples = read_tof(write(tmp_path, unit, *readings), SENSOR)
    np.testing.assert_allclose(samples.distance_mm, [60, 140, 100], atol=1e-9)
    assert samples.unit == unit
    np.testing.assert_array_equal(samples.reading, [float(r) for r in readings])


def test_positions_and_times_stay_as_commanded(tmp_path: Path) -> None:
    samples = read_tof(write(tmp_path, "adc", "1", "2", "3"), SENSOR)
    np.testing.assert_allclose(samples.time_s, [0, 0.01, 0.02])
    np.testing.assert_array_equal(samples.cart_mm, [0, 0, 1])
    np.testing.assert_array_equal(samples.slide_mm, [0, -1, -2])


def test_invalid_readings_are_nan_and_keep_their_row(tmp_path: Path) -> None:
    samples = read_tof(write(tmp_path, "distance_mm", "100", "", "NaN", "nan", "59.9", "140.1", "-1", "60"), SENSOR)
    np.testing.assert_array_equal(samples.distance_mm, [100, *[np.nan] * 6, 60])
    np.testing.assert_array_equal(np.isnan(samples.reading), np.isnan(samples.distance_mm))
    assert len(samples) == 8


def test_volts_that_fall_with_the_distance_are_understood(tmp_path: Path) -> None:
    falling = TofNominal((60.0, 140.0), (0.0, 0.0, 139.0), (5.0, 1.0), None)
    samples = read_tof(write(tmp_path, "volts", "5", "1", "4", "0.9"), falling)
    np.testing.assert_allclose(samples.distance_mm, [60, 140, 80, np.nan])


@pytest.mark.parametrize(("unit", "field"), [("volts", r"tof\.volts"), ("adc", r"tof\.adc_counts")])
def test_a_unit_that_the_description_lacks_is_an_error(tmp_path: Path, unit: str, field: str) -> None:
    with pytest.raises(CaptureError, match=field):
        read_tof(write(tmp_path, unit, "1"), TofNominal((60.0, 140.0), (0.0, 0.0, 139.0)))


@pytest.mark.parametrize("unit", ["millimetres", "adc,volts"])
def test_there_must_be_exactly_one_reading(tmp_path: Path, unit: str) -> None:
    with pytest.raises(CaptureError, match="exactly one of the columns adc, volts, distance_mm; it has"):
        read_tof(write(tmp_path, unit), SENSOR)


def test_a_pass_without_samples_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="holds no samples"):
        read_tof(write(tmp_path, "adc"), SENSOR)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("0,0,0,far", "line 2: adc must be a number, empty or NaN, not 'far'"),
        ("0,,0,5", "line 2: cart_mm is empty"),
        ("1,0,0,5\n0.5,0,0,5", "line 3: time_s runs backwards"),
    ],
)
def test_a_wrong_line_is_named(tmp_path: Path, line: str, words: str) -> None:
    path = tmp_path / "samples.csv"
    path.write_text(f"time_s,cart_mm,slide_mm,adc\n{line}\n")
    with pytest.raises(CaptureError, match=words):
        read_tof(path, SENSOR)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.floats(60, 140), min_size=1, max_size=20))
def test_any_distance_survives_the_way_through_volts(tmp_path: Path, distances: list[float]) -> None:
    volts = [f"{-4 + 8 * (d - 60) / 80:.17g}" for d in distances]
    samples = read_tof(write(tmp_path, "volts", *volts), SENSOR)
    np.testing.assert_allclose(samples.distance_mm, distances, atol=1e-9)
