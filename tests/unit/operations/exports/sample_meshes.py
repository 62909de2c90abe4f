"""Meshes of known shape, with colours."""

import numpy as np

from twinline.fusion.mesh import TriangleMesh
from twinline.fusion.mesh_surface import solid_mesh, surface_mesh


def hill(*, closed: bool = False, colour: bool = True) -> TriangleMesh:
    """A noisy hill of 60 x 40 cells with a gap, some 12 mm high."""
    y, x = np.mgrid[:40, :60] * 0.5
    z = 12.0 - 0.05 * (x - 15.0) ** 2 - 0.04 * (y - 10.0) ** 2
    z += np.random.default_rng(4).normal(0.0, 0.01, z.shape)
    z[10:14, 20:26] = np.nan
    colours = np.random.default_rng(5).integers(0, 256, (*z.shape, 3)).astype(np.uint8) if colour else None
    if closed:
        return solid_mesh(z, -5.0, 30.0, 0.5, colour=colours, floor_mm=-10.0)
    return surface_mesh(z, -5.0, 30.0, 0.5, colour=colours)


def exact_box() -> TriangleMesh:
    """A block of 40 x 30 x 20 mm with a corner in the origin."""
    corners = np.array([[x, y, z] for x in (0.0, 40.0) for y in (0.0, 30.0) for z in (0.0, 20.0)])
    faces = np.array(
        [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
         [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    )  # fmt: skip
    return TriangleMesh(corners, faces)
