"""From a point cloud to a mesh, by way of its height map."""

import numpy as np
from scipy.spatial import cKDTree

from twinline.errors import InputError
from twinline.fusion.cloud import PointCloud
from twinline.fusion.height_map import height_map
from twinline.fusion.mesh import TriangleMesh
from twinline.fusion.mesh_surface import STEEPEST_DEG, small_gaps_filled, solid_mesh, surface_mesh


def mesh_of_cloud(
    cloud: PointCloud,
    cell_mm: float,
    *,
    solid: bool = False,
    floor_mm: float = 0.0,
    steepest_deg: float | None = STEEPEST_DEG,
    fill_cells: int = 4,
    narrow_cells: int = 1,
) -> TriangleMesh:
    """The surface that a cloud shows from above, coloured like its nearest points.

    Parameters
    ----------
    cell_mm
        Distance of the mesh's corners.
    solid
        Close it down to a base, for printing; steps in depth become walls then.
    floor_mm
        Height of that base.
    steepest_deg
        Of an open surface: a steeper triangle would bridge a step in depth and is left out; None keeps all.
    fill_cells
        Gaps of up to so many cells are filled from their border.
    narrow_cells
        Longer gaps are filled where they are no wider than twice this, as those between neighbouring frames.

    Raises
    ------
    InputError
        ``bad-mesh`` if the cloud is empty, or shows no three neighbouring cells.
    """
    finite = np.asarray(np.isfinite(cloud.points_mm).all(axis=1), dtype=bool)
    if not finite.any():
        raise InputError("The cloud has no points, so it makes no mesh; make the scan again.", code="bad-mesh")
    measured = cloud.select(finite)
    heights = height_map(measured, cell_mm)
    # The map's rows run along x, a picture's along y.
    z = small_gaps_filled(
        np.asarray(heights.height_mm, dtype=np.float64).T, fill_cells, narrow_cells, step_mm=2.0 * cell_mm
    )
    x0, y0 = (float(low) + cell_mm / 2 for low in heights.low_mm)
    if solid:
        mesh = solid_mesh(z, x0, y0, cell_mm, floor_mm=floor_mm)
    else:
        mesh = surface_mesh(z, x0, y0, cell_mm, steepest_deg=steepest_deg)
    nearest = np.asarray(cKDTree(measured.points_mm).query(mesh.vertices_mm)[1])
    return TriangleMesh(mesh.vertices_mm, mesh.faces, measured.colour[nearest])
