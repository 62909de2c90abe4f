import copy
import dataclasses
import json
import math
from typing import Any

import numpy as np
import pytest

from twinline.errors import RigError
from twinline.geometry import rig_json
from twinline.geometry.noise import NoiseModel
from twinline.geometry.nominal import default_rig
from twinline.geometry.rig import Covariance, Drives, Rig
from twinline.geometry.rig_json import rig_from_json, rig_id, rig_to_json

HAND_WRITTEN = {
    "format": "twinline-rig",
    "version": 1,
    "name": "my scanner",
    "camera": {"matrix_px": [[1030, 0, 640], [0, 1030, 360], [0, 0, 1]], "size_px": [1280, 720]},
    "stripe_runs": "along-u",
    "sheets": [{"baseline_mm": 246, "angle_deg": 65, "side": "+v"}],
    "bed_from_camera": {"rotation": [[0, 1, 0], [1, 0, 0], [0, 0, -1]], "translation_mm": [0, 0, 430]},
    "travel_mm_per_mm": [1, 0, 0],
}


def full(rig: Rig) -> Rig:
    names = ("camera.fx", "sheet1.a", "bed.rx")
    mix = np.random.default_rng(2).normal(size=(3, 3)) * np.array([[0.3], [1e-7], [1e-5]])
    return dataclasses.replace(
        rig,
        tof=default_rig().tof,
        noise=NoiseModel(1.5, math.inf, 0.123456789012345),
        drives=Drives(9.95, 199.7),
        covariance=Covariance(names, mix @ mix.T),
        sources={"camera": "calibrated, 18 views"},
        evidence={"rms_px": 0.21, "views": [1, 2, {"deep": None}], "note": "läuft"},
    )


def changed(**fields: Any) -> str:
    return json.dumps(copy.deepcopy(HAND_WRITTEN) | fields)


def at(path: str, value: object, document: dict[str, Any] | None = None) -> str:
    """A document with one value put at a path such as camera.matrix_px.0.1."""
    document = copy.deepcopy(document or HAND_WRITTEN)
    place: Any = document
    *way, last = path.split(".")
    for key in way:
        place = place[int(key)] if isinstance(place, list) else place[key]
    if isinstance(place, list):
        place[int(last)] = value
    else:
        place[last] = value
    return json.dumps(document)


class TestRoundTrip:
    def test_every_number_comes_back_to_the_last_bit(self, crooked_rig: Rig) -> None:
        rig = full(crooked_rig)
        back = rig_from_json(rig_to_json(rig))
        assert back.camera.matrix.tobytes() == rig.camera.matrix.tobytes()
        assert back.camera.distortion.tobytes() == rig.camera.distortion.tobytes()
        assert back.camera.size == rig.camera.size
        for here, there in zip(back.sheets, rig.sheets, strict=True):
            assert here.normal.tobytes() == there.normal.tobytes()
            assert (here.offset_mm, here.side) == (there.offset_mm, there.side)
        assert back.bed_from_camera.rotation.tobytes() == rig.bed_from_camera.rotation.tobytes()
        assert back.bed_from_camera.translation_mm.tobytes() == rig.bed_from_camera.translation_mm.tobytes()
        assert back.travel.tobytes() == rig.travel.tobytes()
        assert back.covariance is not None
        assert rig.covariance is not None
        assert back.covariance.names == rig.covariance.names
        assert back.covariance.matrix.tobytes() == rig.covariance.matrix.tobytes()
        assert (back.noise, back.drives, back.name) == (rig.noise, rig.drives, rig.name)
        assert (back.sources, back.evidence, back.stripe_runs) == (rig.sources, rig.evidence, rig.stripe_runs)
        assert back.tof is not None
        assert rig.tof is not None
        for field in dataclasses.fields(rig.tof):
            np.testing.assert_array_equal(getattr(back.tof, field.name), getattr(rig.tof, field.name))

    def test_writing_what_was_read_gives_the_same_text(self, crooked_rig: Rig) -> None:
        text = rig_to_json(full(crooked_rig))
        assert rig_to_json(rig_from_json(text)) == text

    def test_the_default_machine_survives(self) -> None:
        text = rig_to_json(default_rig())
        assert rig_to_json(rig_from_json(text)) == text

    def test_the_readable_view_is_written_beside_the_plane(self) -> None:
        sheet = json.loads(rig_to_json(default_rig()))["sheets"][1]
        assert (sheet["baseline_mm"], sheet["angle_deg"], sheet["side"]) == (246.0, 60.0, "-v")

    def test_evidence_that_json_cannot_hold_is_refused(self) -> None:
        for evidence in ({"x": math.nan}, {"x": {1, 2}}):
            with pytest.raises(RigError, match="cannot be written"):
                rig_to_json(dataclasses.replace(default_rig(), evidence=evidence))


class TestReading:
    def test_a_rig_written_by_hand_needs_only_the_required_fields(self) -> None:
        rig = rig_from_json(json.dumps(HAND_WRITTEN))
        assert rig.sheets[0].baseline_mm == pytest.approx(246.0)
        assert np.degrees(rig.sheets[0].angle_rad) == pytest.approx(65.0)
        assert (rig.camera.distortion == 0).all()
        assert (rig.tof, rig.noise, rig.covariance) == (None, None, None)
        assert rig.drives == Drives()

    def test_the_example_in_the_documentation_is_one(self) -> None:
        documentation = rig_json.__doc__ or ""
        example = documentation[documentation.index('{"format"') :]
        assert rig_from_json(example).name == "my scanner"

    def test_null_stands_for_an_absent_optional_field(self) -> None:
        text = changed(tof=None, noise=None, drives=None, covariance=None, sources=None, evidence=None)
        assert rig_from_json(text).drives == Drives()

    @pytest.mark.parametrize("name", HAND_WRITTEN)
    def test_a_missing_field_is_named(self, name: str) -> None:
        document = {key: value for key, value in HAND_WRITTEN.items() if key != name}
        with pytest.raises(RigError, match=rf"lacks the field {name}\b"):
            rig_from_json(json.dumps(document))

    @pytest.mark.parametrize(
        ("path", "value", "shown"),
        [
            ("colour", "red", "colour"),
            ("camera.zoom", 3, "camera.zoom"),
            ("sheets.0.normals", [0, 1, 0], r"sheets\[0\].normals"),
            ("bed_from_camera.scale", 1, "bed_from_camera.scale"),
        ],
    )
    def test_an_unknown_field_is_named(self, path: str, value: object, shown: str) -> None:
        with pytest.raises(RigError, match=f"unknown field {shown}"):
            rig_from_json(at(path, value))

    @pytest.mark.parametrize(
        ("path", "value", "shown"),
        [
            ("name", 3, "name must be a text, not 3"),
            ("camera", [1], "camera must be an object"),
            ("camera.matrix_px", [[1, 0, 0]], "camera.matrix_px must be a list of 3 rows"),
            ("camera.matrix_px.1", [0, 1], r"camera.matrix_px\[1\] must be a list of 3 numbers"),
            ("camera.matrix_px.0.0", "1030", r"camera.matrix_px\[0\]\[0\] must be a number"),
            ("camera.matrix_px.0.0", True, r"camera.matrix_px\[0\]\[0\] must be a number"),
            ("camera.size_px", [1280.5, 720], "camera.size_px must be two whole numbers"),
            ("camera.distortion_k1k2p1p2k3", [0, 0, 0, 0], "camera.distortion_k1k2p1p2k3 must be a list of 5"),
            ("sheets", {}, "sheets must be a list"),
            ("sheets.0", 7, r"sheets\[0\] must be an object"),
            ("sheets.0.side", 1, r"sheets\[0\].side must be a text"),
            ("sheets.0.baseline_mm", None, r"lacks the field sheets\[0\].baseline_mm"),
            ("travel_mm_per_mm", [1, 0], "travel_mm_per_mm must be a list of 3 numbers"),
            ("travel_mm_per_mm.0", 10**400, r"travel_mm_per_mm\[0\] is too large"),
            ("sources", {"camera": 1}, "sources.camera must be a text"),
            ("evidence", [1], "evidence must be an object"),
            ("covariance", {"names": [1], "matrix": [[1]]}, r"covariance.names\[0\] must be a text"),
            ("covariance", {"names": "ab", "matrix": []}, "covariance.names must be a list"),
            ("drives", {"cart_steps_per_mm": 9.9}, "lacks the field drives.slide_steps_per_mm"),
            ("version", 1.0, "version must be a whole number"),
            ("version", 0, "version must be 1 or more"),
        ],
    )
    def test_a_field_of_the_wrong_type_is_named_with_what_it_should_be(
        self, path: str, value: object, shown: str
    ) -> None:
        with pytest.raises(RigError, match=shown):
            rig_from_json(at(path, value))

    @pytest.mark.parametrize(
        ("path", "value", "shown"),
        [
            ("camera.size_px", [0, 720], "camera is impossible: .*size"),
            ("camera.matrix_px.0.0", -5, "camera is impossible: .*focal"),
            ("sheets.0.side", "up", r"sheets\[0\] is impossible: .*'up'"),
            ("sheets.0.baseline_mm", -246, r"sheets\[0\] is impossible: .*positive"),
            ("bed_from_camera.rotation.2.2", 1, "bed_from_camera is impossible: .*determinant"),
            ("covariance", {"names": ["a"], "matrix": [[-1]]}, "covariance is impossible"),
            ("drives", {"cart_steps_per_mm": 0, "slide_steps_per_mm": 1}, "drives is impossible"),
            ("noise", {"read_dn": -1, "speckle": 0}, "noise is impossible"),
            ("stripe_runs", "along-x", "along-x"),
            ("sheets", [], "one or two lasers"),
        ],
    )
    def test_an_impossible_value_is_named(self, path: str, value: object, shown: str) -> None:
        with pytest.raises(RigError, match=shown):
            rig_from_json(at(path, value))

    def test_a_newer_version_says_so(self) -> None:
        with pytest.raises(RigError, match=r"version 2.*newer Twinline"):
            rig_from_json(changed(version=2, brand_new_field=1))

    def test_another_format_says_so(self) -> None:
        with pytest.raises(RigError, match="not a rig"):
            rig_from_json(changed(format="gltf"))

    @pytest.mark.parametrize(
        ("text", "cause"),
        [
            ("", "not valid JSON"),
            ("{", "not valid JSON"),
            ("[1]", "must be an object"),
            ('"x"', "must be an object"),
            ("null", "must be an object"),
            ('{"name": NaN}', "NaN is not a JSON number"),
            ('{"name": -Infinity}', "-Infinity is not a JSON number"),
            ('{"a": 1, "a": 2}', "'a' is given twice"),
            ("[" * 100000, "not valid JSON"),
        ],
        ids=["empty", "cut off", "list", "text", "null", "NaN", "infinity", "twice", "deep"],
    )
    def test_what_is_no_json_object_is_refused_with_the_cause(self, text: str, cause: str) -> None:
        with pytest.raises(RigError, match=cause):
            rig_from_json(text)


class TestSheetDescriptions:
    PLANE = json.loads(rig_to_json(default_rig()))

    def test_a_plane_alone_is_enough(self) -> None:
        document = copy.deepcopy(self.PLANE)
        for sheet in document["sheets"]:
            del sheet["baseline_mm"], sheet["angle_deg"]
        assert rig_id(rig_from_json(json.dumps(document))) == rig_id(default_rig())

    def test_a_rounded_view_beside_the_plane_is_accepted(self) -> None:
        assert rig_from_json(at("sheets.0.baseline_mm", 246.0004, self.PLANE)).sheets[0].baseline_mm == pytest.approx(
            246
        )

    @pytest.mark.parametrize(("name", "value"), [("baseline_mm", 247.0), ("angle_deg", 60.1)])
    def test_a_view_that_contradicts_the_plane_is_an_error(self, name: str, value: float) -> None:
        with pytest.raises(RigError, match=rf"sheets\[1\].{name}.*say"):
            rig_from_json(at(f"sheets.1.{name}", value, self.PLANE))

    @pytest.mark.parametrize(
        ("sheet", "missing"),
        [
            ({"side": "+v"}, "normal"),
            ({"side": "+v", "normal": [0, 1, 0]}, "offset_mm"),
            ({"side": "+v", "offset_mm": 200}, "normal"),
            ({"side": "+v", "baseline_mm": 200}, "angle_deg"),
        ],
    )
    def test_half_a_description_is_an_error(self, sheet: dict[str, object], missing: str) -> None:
        with pytest.raises(RigError, match=rf"lacks the field sheets\[0\].{missing}"):
            rig_from_json(changed(sheets=[sheet]))

    def test_a_side_that_contradicts_the_plane_is_an_error(self) -> None:
        with pytest.raises(RigError, match=r"sheets\[0\].side is -v.*other side"):
            rig_from_json(changed(sheets=[{"normal": [0, 0.9, 0.4], "offset_mm": 220, "side": "-v"}]))


class TestRigId:
    def test_it_is_short_and_stays_the_same_through_the_file(self, crooked_rig: Rig) -> None:
        rig = full(crooked_rig)
        assert rig_id(rig_from_json(rig_to_json(rig))) == rig_id(rig)
        assert len(rig_id(rig)) == 12
        assert int(rig_id(rig), 16) >= 0

    def test_the_smallest_change_of_a_number_changes_it_and_evidence_does_not(self) -> None:
        rig = default_rig()
        moved = dataclasses.replace(rig, travel=np.array([np.nextafter(1.0, 2.0), 0.0, 0.0]))
        assert rig_id(moved) != rig_id(rig)
        assert rig_id(dataclasses.replace(rig, evidence={"rms_px": 0.2})) == rig_id(rig)
