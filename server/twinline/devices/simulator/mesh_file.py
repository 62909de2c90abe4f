"""A mesh file as a thing to scan."""

from pathlib import Path
from typing import Any, cast

import numpy as np
import trimesh

from twinline.arrays import FloatArray
from twinline.errors import NotFoundError, SettingsError

MESH_ENDINGS = (".stl", ".ply", ".obj", ".glb", ".gltf", ".off")
_METRES = (".glb", ".gltf")
_MAX_TRIANGLES = 3_000_000
_MAX_SIZE_MM = 1500.0
_MAX_HEIGHT_MM = 250.0
_MIN_SIZE_MM = 0.5


def read_mesh(path: Path) -> tuple[trimesh.Trimesh, FloatArray | None]:
    """Read a mesh in millimetres (glTF: in metres, as that format demands).

    Returns
    -------
    mesh, colours
        Colours are (vertices, 3) shares of blue, green and red light that come back; None where the file has none.

    Raises
    ------
    NotFoundError
        There is no such file.
    SettingsError
        It is no mesh, has no triangles, or is too large or too small to lie under the scanner.
    """
    ending = path.suffix.lower()
    if ending not in MESH_ENDINGS:
        raise SettingsError(f"{path} is no mesh that can be scanned; give a file ending in {', '.join(MESH_ENDINGS)}.")
    if not path.is_file():
        raise NotFoundError(f"There is no mesh file {path}; check the path.")
    try:
        mesh = trimesh.load_mesh(path)
    # The readers of six formats fail in as many ways, and each means that this file cannot be read.
    except Exception as error:
        reason = str(error).split("\n", 1)[0][:120] or type(error).__name__
        raise SettingsError(
            f"{path} cannot be read as a {ending[1:].upper()} mesh ({reason}); export it again."
        ) from error
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise SettingsError(f"{path} has no triangles; give a file with a surface, in millimetres.")
    if ending in _METRES:
        mesh.apply_transform(np.diag([1000.0, 1000.0, 1000.0, 1.0]))
    _check(path, mesh)
    return mesh, _colours(mesh)


def _check(path: Path, mesh: trimesh.Trimesh) -> None:
    if len(mesh.faces) > _MAX_TRIANGLES:
        raise SettingsError(
            f"{path} has {len(mesh.faces)} triangles, more than {_MAX_TRIANGLES}; simplify the mesh first."
        )
    used = mesh.vertices[np.unique(mesh.faces)]
    if not np.isfinite(used).all():
        raise SettingsError(f"{path} has vertices that are not finite numbers; repair the mesh first.")
    x, y, z = (float(size) for size in np.ptp(used, axis=0))
    if max(x, y) > _MAX_SIZE_MM or z > _MAX_HEIGHT_MM or max(x, y, z) < _MIN_SIZE_MM:
        raise SettingsError(
            f"{path} is {x:.4g} x {y:.4g} x {z:.4g} mm; what lies under the scanner may be {_MIN_SIZE_MM:g} to "
            f"{_MAX_SIZE_MM:g} mm long and wide and up to {_MAX_HEIGHT_MM:g} mm high: scale it to millimetres."
        )


def _colours(mesh: trimesh.Trimesh) -> FloatArray | None:
    """Shares of light by the file's colours, which are taken as sRGB values of a well-lit picture."""
    visual = mesh.visual
    if visual is None or not visual.defined:
        return None
    plain: Any = visual
    if isinstance(plain, trimesh.visual.TextureVisuals):
        plain = cast(Any, visual).to_color()
    colours = np.asarray(plain.vertex_colors)
    if colours.shape[0] != len(mesh.vertices):
        return None
    linear = (colours[:, 2::-1].astype(np.float64) / 255.0) ** 2.2
    return np.asarray(np.clip(0.9 * linear, 0.02, 0.9))
