"""``twinline inspect`` as a user meets it."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from tests.integration.command_line import files_below, require_refusal, twinline
from tests.integration.ply_points import read_points
from tests.unit.fusion.inspection.surfaces import block_points, sphere_points, turned
from tests.unit.operations.exports.sample_clouds import PROVENANCE
from tests.unit.operations.exports.sample_meshes import exact_box
from twinline.arrays import FloatArray
from twinline.cli.inspect import InspectRequest, run_inspect
from twinline.errors import TwinlineError
from twinline.operations.exports.stl import write_stl

PLAIN = InspectRequest(Path(), None, (), (), "search", "auto", "", None, None, None, False, False)


def wedge_mesh() -> trimesh.Trimesh:
    corners = np.array([[0, 0, 0], [40, 0, 0], [0, 25, 0], [4, 5, 18], [30, 4, 7]], float)
    hull = trimesh.convex.convex_hull(corners)
    assert isinstance(hull, trimesh.Trimesh)
    return hull


def wedge_points() -> FloatArray:
    """A scan of the wedge from above, lying elsewhere, with 0.03 mm of noise."""
    mesh = wedge_mesh()
    points, face = trimesh.sample.sample_surface(mesh, 6000, seed=2)
    points = np.asarray(points)[mesh.face_normals[face][:, 2] > 0.05]
    points = points + np.random.default_rng(3).normal(0.0, 0.03, points.shape)
    return np.asarray(turned(points, (0.0, 0.0, 70.0)) + np.array([120.0, 30.0, 0.0]))


def save(path: Path, points_mm: FloatArray) -> Path:
    np.savetxt(path, points_mm, fmt="%.5f")
    return path


def test_a_ball_and_a_block_are_measured_with_their_uncertainty(tmp_path: Path) -> None:
    ball = sphere_points(1500, noise_mm=0.04) + np.array([100.0, 0.0, 12.7])
    scan = save(
        tmp_path / "scan.xyz", np.concatenate([block_points((25.4, 24.2, 19.35), angle_deg=8.0, noise_mm=0.05), ball])
    )
    done = twinline("inspect", scan, "-m", "sphere", "--region", "80,120,-20,20", "--json", "--indices")
    assert done.returncode == 0, done.stderr
    (finding,) = json.loads(done.stdout)["findings"]
    diameter = finding["quantities"]["diameter"]
    assert diameter["unit"] == "mm"
    assert abs(diameter["value"] - 25.4) < 3 * diameter["sigma"] < 0.1
    assert len(finding["used"]) == finding["points_used"] > 1200
    assert min(finding["used"]) >= len(np.loadtxt(scan)) - 1500
    spoken = twinline("inspect", scan, "-m", "prism", "--region=-40,40,-40,40")
    assert spoken.returncode == 0, spoken.stderr
    assert "height" in spoken.stdout
    assert "19.35 ±" in spoken.stdout


def test_a_scan_is_laid_on_its_mesh_in_inches_judged_and_coloured(tmp_path: Path) -> None:
    scan = save(tmp_path / "scan.xyz", wedge_points())
    mesh = wedge_mesh()
    mesh.apply_scale(1 / 25.4)
    mesh.export(tmp_path / "golden.stl")
    arguments = ("inspect", scan, tmp_path / "golden.stl", "--tolerance", "0.15", "-o", tmp_path / "dev.ply", "--json")
    done = twinline(*arguments)
    assert done.returncode == 0, done.stderr
    assert "golden.stl was taken to be in inches" in done.stderr
    found = json.loads(done.stdout)["comparison"]
    assert found["unit"] == "inch"
    assert found["rms_mm"] == pytest.approx(0.03, abs=0.003)
    assert found["alignment"]["held"] == []
    assert found["alignment"]["angle_deg"] == pytest.approx(70.0, abs=0.1)
    assert found["tolerance"]["verdict"] == "pass"
    assert found["percentiles_mm"]["50"] == pytest.approx(0.0, abs=0.005)
    points = read_points(tmp_path / "dev.ply")
    assert len(points) == found["compared"]
    assert twinline(*arguments[:3], "--tolerance", "0.02").stdout.count("fail") == 1


def test_two_clouds_are_compared(tmp_path: Path) -> None:
    first = save(tmp_path / "a.xyz", block_points((25.4, 24.2, 19.35), noise_mm=0.02))
    raised = block_points((25.4, 24.2, 19.35), noise_mm=0.02, seed=2)
    raised[raised[:, 2] > 10.0, 2] += 0.2
    second = save(tmp_path / "b.xyz", raised)
    done = twinline("inspect", second, first, "--align", "none", "--region=-10,10,-10,10", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["comparison"]["mean_mm"] == pytest.approx(0.2, abs=0.005)


def test_an_open_mesh_is_compared_and_said_to_be_open(tmp_path: Path) -> None:
    mesh = wedge_mesh()
    trimesh.Trimesh(mesh.vertices, mesh.faces[mesh.face_normals[:, 2] > 0.0]).export(tmp_path / "open.ply")
    done = twinline("inspect", save(tmp_path / "scan.xyz", wedge_points()), tmp_path / "open.ply")
    assert done.returncode == 0, done.stderr
    assert "open.ply is not watertight" in done.stderr


class TestBadInput:
    @pytest.fixture
    def scan(self, tmp_path: Path) -> Path:
        return save(tmp_path / "scan.xyz", wedge_points())

    def test_an_empty_cloud(self, tmp_path: Path) -> None:
        (tmp_path / "scan.xyz").write_bytes(b"")
        require_refusal(twinline("inspect", tmp_path / "scan.xyz"), "scan.xyz", "empty")

    def test_a_cloud_without_a_measurement(self, tmp_path: Path) -> None:
        scan = save(tmp_path / "scan.xyz", np.full((100, 3), np.nan))
        require_refusal(twinline("inspect", scan), "scan.xyz", "no point with a measurement")

    def test_some_points_without_a_measurement_are_said(self, tmp_path: Path, scan: Path) -> None:
        with scan.open("a") as stream:
            stream.write("nan nan nan\n" * 7)
        done = twinline("inspect", scan, "-m", "plane")
        assert done.returncode == 0
        assert "has 7 of" in done.stderr

    def test_a_mesh_with_its_tail_cut_off_leaves_nothing_behind(self, tmp_path: Path, scan: Path) -> None:
        write_stl(tmp_path / "golden.stl", exact_box(), PROVENANCE)
        (tmp_path / "golden.stl").write_bytes((tmp_path / "golden.stl").read_bytes()[:-70])
        (tmp_path / "dev.ply").write_bytes(b"earlier")
        before = files_below(tmp_path)
        done = twinline("inspect", scan, tmp_path / "golden.stl", "-o", tmp_path / "dev.ply")
        require_refusal(done, "golden.stl is cut off", "announces 12 triangles and holds 10")
        assert files_below(tmp_path) == before
        assert (tmp_path / "dev.ply").read_bytes() == b"earlier"

    def test_a_mesh_of_another_size(self, tmp_path: Path, scan: Path) -> None:
        mesh = wedge_mesh()
        mesh.apply_scale(6.0)
        mesh.export(tmp_path / "golden.stl")
        require_refusal(twinline("inspect", scan, tmp_path / "golden.stl"), "fits the scan in no unit", "--unit")

    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"measurements": ("hexagon",)}, "choose among plane, sphere"),
            ({"measurements": ("step",)}, "needs two regions"),
            ({"measurements": ("distance:3",)}, "distance:12,345"),
            ({"measurements": ("distance:3,999999",)}, "no point 999999"),
            ({"regions": ("1,2,3",)}, "--region 1,2,3: give 4 or 6 numbers"),
            ({"regions": ("9,2,3,4",)}, "is empty"),
            ({"regions": ("900,901,0,1",)}, "there are 0"),
            ({"output": Path("dev.ply")}, "give the reference"),
            ({"output": Path("dev.txt")}, ".ply or .glb"),
        ],
    )
    def test_options_that_mean_nothing(self, scan: Path, changes: dict[str, Any], words: str) -> None:
        with pytest.raises(TwinlineError, match=re.escape(words)):
            run_inspect(replace(PLAIN, scan=scan, **changes))

    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"align": "magic"}, "choose one of search, near, none"),
            ({"unit": "furlong"}, "choose auto or one of mm, inch, m"),
            ({"tolerance": "0.1,x"}, "give 1 or 2 numbers"),
            ({"tolerance": "0.1,-0.1"}, "is empty"),
            ({"bed_mm": 900.0}, "Only 0 points of the scan are left"),
        ],
    )
    def test_ways_to_compare_that_mean_nothing(
        self, tmp_path: Path, scan: Path, changes: dict[str, Any], words: str
    ) -> None:
        wedge_mesh().export(tmp_path / "golden.stl")
        with pytest.raises(TwinlineError, match=re.escape(words)):
            run_inspect(replace(PLAIN, scan=scan, reference=tmp_path / "golden.stl", **changes))
