"""What a rendered capture's owner would know, and the truth that only a simulator has, as files.

This is the one place of the simulator that touches ``twinline.geometry``, and only for the rig's file format: the true
rig is worked out here from the machine's own numbers.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from twinline.arrays import FloatArray, IntArray
from twinline.devices.simulator.machine import SimulatedRig
from twinline.devices.simulator.scenes import Scene
from twinline.devices.simulator.tof import FrontEnd, TofSensor, full_scale_front_end
from twinline.errors import OutputError, SettingsError
from twinline.geometry.rig import Rig
from twinline.geometry.rig_json import rig_from_json, rig_to_json


def true_rig(name: str, rig: SimulatedRig, front_end: FrontEnd | None = None) -> Rig:
    """The machine's true parameters in the project's terms.

    Parameters
    ----------
    front_end
        What the ToF readings come from; by default one whose ends are the ends of the sensor's range, as in folders.
    """
    rotation = rig.bed_from_camera
    lens = rig.lens
    k1, k2, k3 = lens.radial
    document = {
        "format": "twinline-rig",
        "version": 1,
        "name": name,
        "camera": {
            "matrix_px": [
                [lens.focal_px[0], 0.0, lens.centre_px[0]],
                [0.0, lens.focal_px[1], lens.centre_px[1]],
                [0.0, 0.0, 1.0],
            ],
            "size_px": list(rig.image_size),
            "distortion_k1k2p1p2k3": [k1, k2, *lens.tangential, k3],
        },
        "stripe_runs": rig.stripe_runs,
        # A sheet's normal is known on the bed's axes; the camera sees it turned by its own tilt.
        "sheets": [
            {
                "side": laser.side,
                "normal": (rotation.T @ laser.normal).tolist(),
                "offset_mm": float(laser.normal @ laser.source_mm),
            }
            for laser in rig.lasers
        ],
        "bed_from_camera": {"rotation": rotation.tolist(), "translation_mm": rig.eye_mm(0.0).tolist()},
        "travel_mm_per_mm": rig.travel.tolist(),
        "tof": _true_tof(rig, front_end),
        "sources": dict.fromkeys(("camera", "sheets", "bed_from_camera", "travel", "tof"), "given by the simulator"),
    }
    return rig_from_json(json.dumps(document))


def _true_tof(rig: SimulatedRig, front_end: FrontEnd | None) -> dict[str, Any] | None:
    if rig.tof is None:
        return None
    sensor = TofSensor()
    gain, offset_mm = (front_end or full_scale_front_end(sensor)).line_of(sensor)
    return {
        "position_mm": list(rig.tof.place_mm),
        "beam": rig.tof.beam.tolist(),
        "slide_mm_per_mm": rig.tof.slide.tolist(),
        "gain_mm_per_unit": gain,
        "offset_mm": offset_mm,
        "range_mm": list(sensor.range_mm),
        "lag_s": sensor.lag_s,
    }


def owner_knowledge(name: str, rig: SimulatedRig) -> dict[str, Any]:
    """Contents of ``capture.json``: nothing that a ruler and a data sheet could not tell."""
    width, height = rig.image_size
    focal = rig.known_focal_px
    return {
        "name": name,
        "image_size": [width, height],
        "stripe_runs": rig.stripe_runs,
        "camera_matrix_guess": [[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]],
        "camera_height_mm": rig.known_camera_height_mm,
        "lasers": [
            {"baseline_mm": laser.known_baseline_mm, "angle_deg": laser.known_angle_deg, "side": laser.side}
            for laser in rig.lasers
        ],
    }


def truth(scene: Scene, rig: SimulatedRig, *, seed: int) -> dict[str, Any]:
    """Contents of ``truth.json``: the scene as solids in the bed frame, and the machine without its errors left out."""
    return {
        "frame": "bed: x along the travel, y across, z up, z = 0 on the bed, origin under the camera at cart_mm 0",
        "seed": seed,
        "scene": {
            "name": scene.name,
            "mesh": "truth.ply",
            "things": [
                {"name": thing.name, "kind": thing.kind, "dimensions_mm": _plain(thing.dimensions_mm)}
                for thing in scene.things
            ],
        },
        "machine": {
            "image_size": list(rig.image_size),
            "focal_px": list(rig.lens.focal_px),
            "centre_px": list(rig.lens.centre_px),
            "radial_k1k2k3": list(rig.lens.radial),
            "tangential_p1p2": list(rig.lens.tangential),
            "camera_height_mm": rig.camera_height_mm,
            "camera_tilt_deg": list(rig.tilt_deg),
            "bed_from_camera_rotation": rig.bed_from_camera.tolist(),
            "travel_mm_per_commanded_mm": rig.travel.tolist(),
            "lasers": [
                {
                    "side": laser.side,
                    "source_from_camera_in_bed_axes_mm": laser.source_mm.tolist(),
                    "sheet_normal_in_bed_axes": laser.normal.tolist(),
                    "width_sd_mm": laser.width_mm,
                }
                for laser in rig.lasers
            ],
            "sensor": {
                "blur_sd_px": rig.sensor.blur_px,
                "read_noise_dn": rig.sensor.read_dn,
                "electrons_per_dn": rig.sensor.electrons_per_dn,
                "speckle_contrast": rig.sensor.speckle,
            },
        },
    }


def truth_mesh(scene: Scene) -> trimesh.Trimesh:
    """All things of a scene as one mesh in the bed frame, millimetres; empty for a bare bed."""
    vertices: list[FloatArray] = [np.empty((0, 3))]
    faces: list[IntArray] = [np.empty((0, 3), dtype=np.int64)]
    count = 0
    for thing in scene.things:
        vertices.append(np.asarray(thing.mesh.vertices))
        faces.append(np.asarray(thing.mesh.faces) + count)
        count += len(thing.mesh.vertices)
    return trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False)


def export_mesh(path: Path, mesh: trimesh.Trimesh) -> None:
    """Write a mesh given in millimetres as .ply, .stl, .obj or .glb (in metres, as that format demands).

    Raises
    ------
    SettingsError
        Another ending, or nothing to write.
    OutputError
        The file cannot be written.
    """
    ending = path.suffix.lower().lstrip(".")
    if ending not in ("ply", "stl", "obj", "glb"):
        raise SettingsError(
            f"{path} cannot hold the simulated scene; choose a name ending in .ply, .stl, .obj or .glb."
        )
    if not len(mesh.faces):
        raise SettingsError("The simulated bed is bare: there is no mesh to write; choose a scene with objects.")
    if ending == "glb":
        mesh = trimesh.Trimesh(mesh.vertices * 0.001, mesh.faces, process=False)
    content = mesh.export(file_type=ending)
    assert isinstance(content, str | bytes)
    try:
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}; choose another folder.") from error


def write_truth(folder: Path, scene: Scene, rig: SimulatedRig, *, name: str, seed: int) -> None:
    """Write ``rig.json``, ``truth.json`` and, unless the bed is bare, ``truth.ply``."""
    (folder / "rig.json").write_text(rig_to_json(true_rig(f"{name} (true)", rig)), encoding="utf-8")
    write_json(folder / "truth.json", truth(scene, rig, seed=seed))
    if scene.things:
        (folder / "truth.ply").write_bytes(trimesh.exchange.ply.export_ply(truth_mesh(scene), vertex_normal=False))


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file that people can read too."""
    path.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _plain(numbers: Mapping[str, float]) -> dict[str, float]:
    return {name: float(value) for name, value in numbers.items()}
