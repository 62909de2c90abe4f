"""The measurements that can be taken of a cloud, by name."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from twinline.arrays import BoolArray, FloatArray, IntArray
from twinline.errors import InputError
from twinline.fusion.inspection.areas import volume_over_base
from twinline.fusion.inspection.cylinder import fit_cylinder
from twinline.fusion.inspection.lengths import point_distance, step_height
from twinline.fusion.inspection.plane import fit_plane
from twinline.fusion.inspection.prism import fit_prism
from twinline.fusion.inspection.quantity import Quantity
from twinline.fusion.inspection.sphere import fit_sphere
from twinline.fusion.mesh_surface import small_gaps_filled

_LEAST_FOR_VOLUME = 100
_LEAST_CELL_MM = 0.2
_LEAST_HEIGHT_MM = 0.2
# Of clouds that do not tell theirs: what a calibrated machine reaches at the bed.
_USUAL_SIGMA_MM = 0.06


@dataclass(frozen=True, eq=False)
class Finding:
    """One measurement of a report.

    Attributes
    ----------
    name
        What was measured.
    quantities
        Results by name.
    details
        Further numbers, ready for JSON.
    used : (m,) int array
        Rows of the points of A that it used.
    """

    name: str
    quantities: dict[str, Quantity]
    details: dict[str, Any]
    used: IntArray


def measure(name: str, points_mm: FloatArray, sigma_mm: FloatArray | None, regions: list[BoolArray]) -> Finding:
    """Take one measurement of points.

    Parameters
    ----------
    name
        One of `MEASUREMENTS`, or ``distance:I,J`` between two rows.
    regions
        Points of the regions given, one or two; none means all points.

    Raises
    ------
    InputError
        If there is no such measurement, or the points do not allow it.
    """
    kind, _, rest = name.partition(":")
    if kind == "distance":
        return _distance(rest, points_mm, sigma_mm)
    if kind not in MEASUREMENTS:
        raise InputError(f"There is no measurement {name!r}; choose among {', '.join(MEASUREMENTS)} and distance:I,J.")
    regions = regions or [np.ones(len(points_mm), dtype=bool)]
    return MEASUREMENTS[kind](points_mm, sigma_mm, [np.flatnonzero(region) for region in regions])


def _part(values: FloatArray | None, rows: IntArray) -> FloatArray | None:
    return None if values is None else values[rows]


def _distance(rest: str, points_mm: FloatArray, sigma_mm: FloatArray | None) -> Finding:
    try:
        first, second = (int(word) for word in rest.split(","))
    except ValueError:
        raise InputError(f"distance:{rest} needs two rows, such as distance:12,345.") from None
    found = point_distance(points_mm, first, second, sigma_mm)
    return Finding("distance", {"distance": found.length}, {"rows": [first, second]}, found.used)


def _plane(points: FloatArray, sigma: FloatArray | None, rows: list[IntArray]) -> Finding:
    fit = fit_plane(points[rows[0]], _part(sigma, rows[0]))
    details = {"normal": fit.normal.tolist(), "centre_mm": fit.centre_mm.tolist(), "rms_mm": fit.rms_mm}
    return Finding("plane", {"flatness": fit.flatness, "tilt": fit.tilt}, details, rows[0][fit.used])


def _sphere(points: FloatArray, sigma: FloatArray | None, rows: list[IntArray]) -> Finding:
    fits = [fit_sphere(points[part], _part(sigma, part)) for part in rows[:2]]
    quantities = {"diameter": fits[0].diameter, "form": fits[0].form}
    details: dict[str, Any] = {"centre_mm": fits[0].centre_mm.tolist(), "rms_mm": fits[0].rms_mm}
    if len(fits) == 2:
        quantities |= {
            "second_diameter": fits[1].diameter,
            "second_form": fits[1].form,
            "spacing": fits[0].centre_distance(fits[1]),
        }
        details |= {"second_centre_mm": fits[1].centre_mm.tolist(), "second_rms_mm": fits[1].rms_mm}
    used = np.concatenate([part[fit.used] for part, fit in zip(rows, fits, strict=False)])
    return Finding("sphere", quantities, details, used)


def _cylinder(points: FloatArray, sigma: FloatArray | None, rows: list[IntArray]) -> Finding:
    fit = fit_cylinder(points[rows[0]], _part(sigma, rows[0]))
    details = {"axis": fit.axis.tolist(), "point_mm": fit.point_mm.tolist(), "rms_mm": fit.rms_mm}
    return Finding("cylinder", {"diameter": fit.diameter, "form": fit.form}, details, rows[0][fit.used])


def _prism(points: FloatArray, sigma: FloatArray | None, rows: list[IntArray]) -> Finding:
    fit = fit_prism(points[rows[0]], _part(sigma, rows[0]))
    quantities = {"length": fit.length, "width": fit.width, "height": fit.height, "top_flatness": fit.top.flatness}
    details = {"angle_deg": fit.angle_deg, "corners_mm": fit.corners_mm.tolist()}
    return Finding("prism", quantities, details, rows[0][fit.used])


def _step(points: FloatArray, sigma: FloatArray | None, rows: list[IntArray]) -> Finding:
    if len(rows) != 2:
        raise InputError(f"A step needs two regions and there are {len(rows)}; give --region twice, the lower first.")
    lower, upper = rows
    fit = step_height(points[lower], points[upper], _part(sigma, lower), _part(sigma, upper))
    details = {"normal": fit.normal.tolist(), "parallel_deg": fit.parallel_deg, "rms_mm": fit.rms_mm}
    used = np.concatenate([lower[fit.used_lower], upper[fit.used_upper]])
    return Finding("step", {"height": fit.height}, details, used)


def _volume(points: FloatArray, sigma: FloatArray | None, rows: list[IntArray]) -> Finding:
    seen = rows[0][np.isfinite(points[rows[0]]).all(axis=1)]
    if len(seen) < _LEAST_FOR_VOLUME:
        raise InputError(
            f"A volume needs at least {_LEAST_FOR_VOLUME} points and there are {len(seen)}; choose a larger region.",
            code="too-few-points",
        )
    part, noise = points[seen], _part(sigma, seen)
    spacing = float(np.median(np.asarray(cKDTree(part[:, :2]).query(part[:, :2], k=2)[0])[:, 1]))
    cell_mm = max(1.5 * spacing, _LEAST_CELL_MM)
    low = part[:, :2].min(axis=0)
    column, row = np.floor((part[:, :2] - low) / cell_mm).astype(np.int64).T
    shape = (int(row.max()) + 1, int(column.max()) + 1)
    place = row * shape[1] + column
    counts = np.bincount(place, minlength=shape[0] * shape[1])
    with np.errstate(invalid="ignore"):
        # A cell at an edge counts with the share of its points that stand on the object; its highest point would widen
        # the object by a part of a cell all around.
        height = (np.bincount(place, weights=part[:, 2], minlength=len(counts)) / counts).reshape(shape)
        share = (np.bincount(place, weights=part[:, 2] > _LEAST_HEIGHT_MM, minlength=len(counts)) / counts).reshape(
            shape
        )
    z = small_gaps_filled(height, 4, 1)
    sigma_mm = _USUAL_SIGMA_MM if noise is None else float(np.median(noise))
    found = volume_over_base(z, cell_mm, least_mm=_LEAST_HEIGHT_MM, sigma_mm=sigma_mm)
    covered = float(np.nansum(small_gaps_filled(share, 4, 1))) * cell_mm**2
    details = {
        "cell_mm": cell_mm,
        "highest_mm": found.highest_mm,
        "unmeasured_mm2": found.unmeasured_mm2,
        "base_mm": 0.0,
    }
    used = seen[np.isin(place, found.used) & (part[:, 2] > _LEAST_HEIGHT_MM)]
    return Finding(
        "volume", {"volume": found.volume, "area": Quantity(covered, found.area.sigma, "mm2")}, details, used
    )


Measurement = Callable[[FloatArray, FloatArray | None, list[IntArray]], Finding]

MEASUREMENTS: dict[str, Measurement] = {
    "plane": _plane,
    "sphere": _sphere,
    "cylinder": _cylinder,
    "prism": _prism,
    "step": _step,
    "volume": _volume,
}
