import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.recording.sample_captures import description
from twinline.errors import CaptureError
from twinline.recording.capture_json import CaptureInfo, parse_capture_json, read_capture_json

PATH = Path("folder/capture.json")
FORMATS_EXAMPLE = """
{"name": "three objects",
 "image_size": [1280, 720],
 "stripe_runs": "along-u",
 "camera_matrix_guess": [[1030, 0, 640], [0, 1030, 360], [0, 0, 1]],
 "board": {"kind": "chessboard", "columns": 9, "rows": 6, "square_mm": 12.0, "thickness_mm": 0.0},
 "camera_height_mm": 430.0,
 "lasers": [{"baseline_mm": 246.0, "angle_deg": 60.0, "side": "+v"}, {"baseline_mm": 246.0, "angle_deg": 60.0, "side": "-v"}],
 "tof": {"range_mm": [60, 140], "volts": [-4, 4], "adc_counts": 4096, "mount_mm": [-118.0, 0.0, 139.0]}}
"""  # noqa: E501

ANY_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


def parse(document: object) -> CaptureInfo:
    return parse_capture_json(json.dumps(document).encode(), PATH)


def changed(field: str, value: object) -> dict[str, Any]:
    """The description with one field, given by its path in Python's syntax, set."""
    document = description()
    exec(f"document{field} = value", {"document": document, "value": value})
    return document


def test_the_example_of_the_format_is_understood() -> None:
    info = parse_capture_json(FORMATS_EXAMPLE.encode(), PATH)
    assert (info.name, info.image_size, info.stripe_runs) == ("three objects", (1280, 720), "along-u")
    np.testing.assert_array_equal(info.camera_matrix_guess, [[1030, 0, 640], [0, 1030, 360], [0, 0, 1]])
    assert info.board is not None
    assert (info.board.kind, info.board.columns, info.board.rows, info.board.square_mm) == ("chessboard", 9, 6, 12.0)
    assert info.camera_height_mm == 430.0
    assert [(laser.baseline_mm, laser.angle_deg, laser.side) for laser in info.lasers] == [
        (246.0, 60.0, "+v"),
        (246.0, 60.0, "-v"),
    ]
    assert info.tof is not None
    assert (info.tof.range_mm, info.tof.volts, info.tof.adc_counts) == ((60.0, 140.0), (-4.0, 4.0), 4096)
    assert info.tof.mount_mm == (-118.0, 0.0, 139.0)


def test_board_and_tof_may_be_absent() -> None:
    document = description()
    del document["board"], document["tof"]
    assert (parse(document).board, parse(document).tof) == (None, None)


def test_one_laser_across_turned_images_is_ordinary() -> None:
    info = parse(
        description() | {"stripe_runs": "along-v", "lasers": [{"baseline_mm": 37.3, "angle_deg": 65, "side": "-u"}]}
    )
    assert [laser.side for laser in info.lasers] == ["-u"]


@pytest.mark.parametrize(
    "field", ["name", "image_size", "stripe_runs", "camera_matrix_guess", "camera_height_mm", "lasers"]
)
def test_a_missing_field_is_named(field: str) -> None:
    document = description()
    del document[field]
    with pytest.raises(CaptureError, match=f"capture.json: the field {field} is missing"):
        parse(document)


@pytest.mark.parametrize(
    ("field", "value", "named"),
    [
        ("['name']", "", "name"),
        ("['name']", 5, "name"),
        ("['name']", "two\nlines", "name"),
        ("['image_size']", [1280], "image_size"),
        ("['image_size']", [1280, 0], "image_size"),
        ("['image_size']", [1280, 720.0], "image_size"),
        ("['image_size']", [True, 720], "image_size"),
        ("['image_size']", [10**9, 720], "image_size"),
        ("['stripe_runs']", "u", "stripe_runs"),
        ("['stripe_runs']", [], "stripe_runs"),
        ("['camera_matrix_guess']", [[1, 2, 3]], "camera_matrix_guess"),
        ("['camera_matrix_guess'][0][0]", -1030, "camera_matrix_guess"),
        ("['camera_matrix_guess'][0][1]", 3, "camera_matrix_guess"),
        ("['camera_matrix_guess'][2][2]", 2, "camera_matrix_guess"),
        ("['camera_height_mm']", "430", "camera_height_mm"),
        ("['camera_height_mm']", 0, "camera_height_mm"),
        ("['camera_height_mm']", 10**400, "camera_height_mm"),
        ("['lasers']", [], "lasers"),
        ("['lasers']", {}, "lasers"),
        ("['lasers'][1]", 7, r"lasers\[1\]"),
        ("['lasers'][0]['baseline_mm']", -246, r"lasers\[0\]\.baseline_mm"),
        ("['lasers'][1]['angle_deg']", 180, r"lasers\[1\]\.angle_deg"),
        ("['lasers'][1]['side']", "left", r"lasers\[1\]\.side"),
        ("['lasers'][1]['side']", "-u", r"lasers\[1\]\.side"),
        ("['lasers'][1]['side']", "+v", r"lasers\[1\]\.side"),
        ("['lasers'][1]['colour']", "red", r"lasers\[1\]\.colour is unknown"),
        ("['camera']", {}, "camera is unknown"),
        ("['board']", "chessboard", "board"),
        ("['board']['kind']", "dots", r"board\.kind"),
        ("['board']['kind']", "charuco", r"board\.dictionary is missing"),
        ("['board']['columns']", 1, r"board\.columns"),
        ("['board']['square_mm']", 0, r"board\.square_mm"),
        ("['board']['thickness_mm']", -1, r"board\.thickness_mm"),
        ("['tof']['range_mm']", [140, 60], r"tof\.range_mm"),
        ("['tof']['volts']", [4, 4], r"tof\.volts"),
        ("['tof']['adc_counts']", 1, r"tof\.adc_counts"),
        ("['tof']['mount_mm']", [1, 2], r"tof\.mount_mm"),
    ],
)
def test_a_wrong_value_is_an_error_that_names_file_and_field(field: str, value: object, named: str) -> None:
    with pytest.raises(CaptureError, match=rf"^folder/capture\.json: .*{named}"):
        parse(changed(field, value))


def test_a_charuco_board_has_a_dictionary_and_a_marker() -> None:
    board = description()["board"] | {"kind": "charuco", "dictionary": "DICT_4X4_50", "marker_mm": 9.0}
    info = parse(description() | {"board": board})
    assert info.board is not None
    assert (info.board.dictionary, info.board.marker_mm) == ("DICT_4X4_50", 9.0)
    with pytest.raises(CaptureError, match=r"board\.marker_mm must be .*12"):
        parse(description() | {"board": board | {"marker_mm": 12.0}})


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"", "not JSON"),
        (b"{\n'name': 1}", "line 2, column 1"),
        (b"\xff\xfe{}", "UTF-8"),
        (b"[]", "must be an object"),
        (b'{"name": "a", "name": "b"}', "'name' is given twice"),
        (b'{"camera_height_mm": NaN}', "NaN"),
        (b"[" * 100_000, "not usable JSON"),
        (b'{"camera_height_mm": ' + b"9" * 5000 + b"}", "not usable JSON"),
    ],
)
def test_what_is_not_json_is_an_error(text: bytes, words: str) -> None:
    with pytest.raises(CaptureError, match=words):
        parse_capture_json(text, PATH)


def test_a_file_of_any_size_is_not_read_whole(tmp_path: Path) -> None:
    path = tmp_path / "capture.json"
    path.write_bytes(b" " * 2_000_000)
    with pytest.raises(CaptureError, match="larger than"):
        read_capture_json(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match=r"capture\.json is missing"):
        read_capture_json(tmp_path / "capture.json")


@given(ANY_JSON)
def test_any_json_gives_a_capture_error(document: object) -> None:
    text = json.dumps(document).encode()
    with pytest.raises(CaptureError) as raised:
        parse_capture_json(text, PATH)
    raised.value.detail.encode()


@given(
    st.sampled_from([*description(), "other"]),
    ANY_JSON,
    st.sampled_from(["", "[0]", "['side']", "['kind']", "['volts']"]),
)
def test_any_value_in_any_field_gives_a_capture_error_or_a_description(field: str, value: object, deeper: str) -> None:
    document = description()
    try:
        exec(f"document[{field!r}]{deeper} = value", {"document": document, "value": value})
    except (TypeError, KeyError, IndexError):
        document[field] = value
    try:
        assert parse_capture_json(json.dumps(document).encode(), PATH).image_size
    except CaptureError as error:
        error.detail.encode()


@given(st.binary(max_size=60))
def test_any_bytes_give_a_capture_error(data: bytes) -> None:
    with pytest.raises(CaptureError):
        parse_capture_json(data, PATH)
