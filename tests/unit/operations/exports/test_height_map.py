"""Height maps as Pillow, OpenCV and the standard library read them."""

import csv
import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from tests.unit.operations.exports.sample_clouds import PROVENANCE
from twinline.errors import OutputError
from twinline.operations.exports.height_map import (
    HeightMapArrays,
    write_height_csv,
    write_height_png,
    write_height_tiff,
)

WRITERS = [("a.png", write_height_png), ("a.tif", write_height_tiff)]
Writer = Callable[[Path, HeightMapArrays, object], None]


def sample(scale: float = 1.0) -> HeightMapArrays:
    z = np.random.default_rng(8).uniform(-1.0, 30.0, (31, 47)) * scale
    z[4:9, 10:12] = np.nan
    return HeightMapArrays(z, -12.5, 40.0, 0.25)


def description(path: Path) -> dict[str, float]:
    with Image.open(path) as picture:
        text = picture.info["Description"] if path.suffix == ".png" else picture.tag_v2[270]  # type: ignore[attr-defined]
    found = json.loads(text.rstrip("\0"))
    assert isinstance(found, dict)
    return found


@pytest.mark.parametrize(("name", "write"), WRITERS)
@pytest.mark.parametrize("scale", [1.0, 10.0])
def test_heights_come_back_through_the_scale(tmp_path: Path, name: str, write: Writer, scale: float) -> None:
    heights = sample(scale)
    write(tmp_path / name, heights, PROVENANCE)
    meaning = description(tmp_path / name)
    for values in (cv2.imread(str(tmp_path / name), cv2.IMREAD_UNCHANGED), np.asarray(Image.open(tmp_path / name))):
        assert values is not None
        assert values.shape == heights.z_mm.shape
        assert values.dtype == np.uint16
        found = np.where(values == 0, np.nan, meaning["z_of_1_mm"] + (values - 1.0) * meaning["step_mm"])[::-1]
        np.testing.assert_allclose(found, heights.z_mm, atol=meaning["step_mm"] * 0.501)
    assert meaning["step_mm"] == pytest.approx(max(0.001, 31.0 * scale / 65534), rel=0.02)


@pytest.mark.parametrize(("name", "write"), WRITERS)
def test_the_picture_says_where_its_pixels_lie_and_where_it_came_from(tmp_path: Path, name: str, write: Writer) -> None:
    write(tmp_path / name, sample(), PROVENANCE)
    meaning = description(tmp_path / name)
    assert meaning["x_of_first_column_mm"] == -12.5
    assert meaning["y_of_first_row_mm"] == 40.0 + 30 * 0.25
    assert meaning["pitch_mm"] == 0.25
    assert {"rig_id": "3f2a9c", "recording_id": "three objects"}.items() <= meaning.items()
    with Image.open(tmp_path / name) as picture:
        # 0.25 mm a pixel are 101.6 in an inch.
        assert float(picture.info["dpi"][0]) == pytest.approx(101.6, rel=1e-4)


@pytest.mark.parametrize(("name", "write"), WRITERS)
def test_a_map_without_a_measurement_is_refused(tmp_path: Path, name: str, write: Writer) -> None:
    with pytest.raises(OutputError, match="no measurement"):
        write(tmp_path / name, HeightMapArrays(np.full((3, 3), np.nan), 0.0, 0.0, 1.0), PROVENANCE)
    assert not list(tmp_path.iterdir())


def test_the_table_holds_every_cell(tmp_path: Path) -> None:
    heights = sample()
    write_height_csv(tmp_path / "a.csv", heights)
    with (tmp_path / "a.csv").open(newline="") as stream:
        rows = list(csv.reader(stream))
    found = np.array([[float(cell) if cell else np.nan for cell in row[1:]] for row in rows[1:]])
    np.testing.assert_allclose(found, heights.z_mm, atol=5.1e-5)
    assert [float(cell) for cell in rows[0][1:3]] == [-12.5, -12.25]
    assert [float(row[0]) for row in rows[1:3]] == [40.0, 40.25]
