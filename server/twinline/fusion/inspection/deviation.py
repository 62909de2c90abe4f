"""Deviations of a scan from a reference: percentiles, and a verdict that knows its uncertainty."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from twinline.arrays import BoolArray, ByteArray, FloatArray
from twinline.errors import InputError
from twinline.fusion.inspection.nearest import MeshSurface
from twinline.fusion.inspection.quantity import measured_rows
from twinline.fusion.inspection.rigid import RigidMotion

Verdict = Literal["pass", "fail", "undecided"]

PERCENTILES = (0.15, 2.5, 16.0, 50.0, 84.0, 97.5, 99.85)
_LEAST = 50
_NEIGHBOURS = 12


@dataclass(frozen=True, eq=False)
class Deviation:
    """How far points lie off a reference.

    Attributes
    ----------
    signed_mm : (n,) array
        Of each point given, positive outside; NaN where it has no measurement or the reference shows nothing there.
    normals : (n, 3) array
        Of the reference at the nearest point.
    sigma_mm
        Standard uncertainty of a single deviation: of the alignment, and of the noise where it is known.
    compared : (n,) bool array
        Points with a deviation.
    """

    signed_mm: FloatArray
    normals: FloatArray
    sigma_mm: float
    compared: BoolArray

    @property
    def values_mm(self) -> FloatArray:
        """The deviations that there are."""
        return self.signed_mm[self.compared]

    def percentiles_mm(self) -> dict[float, float]:
        """Deviation at each of `PERCENTILES`."""
        return dict(zip(PERCENTILES, np.percentile(self.values_mm, PERCENTILES).tolist(), strict=True))

    @property
    def mean_mm(self) -> float:
        """Mean of the deviations."""
        return float(self.values_mm.mean())

    @property
    def rms_mm(self) -> float:
        """Root of their mean square."""
        return float(np.sqrt(np.mean(self.values_mm**2)))

    @property
    def p95_mm(self) -> float:
        """95 % of the deviations are no larger, whatever their sign."""
        return float(np.percentile(np.abs(self.values_mm), 95.0))


@dataclass(frozen=True)
class ToleranceCheck:
    """Whether a surface lies within its tolerance.

    Attributes
    ----------
    low_mm, high_mm
        The tolerance.
    verdict
        ``pass`` if the range of 99.7 % of the deviations, widened by twice its uncertainty, lies within; ``fail`` if it
        lies outside even when narrowed by as much; else ``undecided`` (the rule of ISO 14253-1).
    inside
        Share of the deviations within the tolerance.
    worst_low_mm, worst_high_mm
        Ends of the range of 99.7 % of the deviations.
    uncertainty_mm
        Twice the standard uncertainty.
    """

    low_mm: float
    high_mm: float
    verdict: Verdict
    inside: float
    worst_low_mm: float
    worst_high_mm: float
    uncertainty_mm: float


def deviation_from_mesh(
    points_mm: FloatArray,
    surface: MeshSurface,
    *,
    motion: RigidMotion | None = None,
    alignment_sigma_mm: float = 0.0,
    sigma_mm: FloatArray | None = None,
    reach_mm: float = np.inf,
) -> Deviation:
    """Signed distance of each point from a mesh.

    Parameters
    ----------
    points_mm : (n, 3) array
        NaN means "no measurement".
    surface
        The reference.
    motion
        Lays the points on it; by default none.
    alignment_sigma_mm
        Standard uncertainty of that motion at a point.
    sigma_mm : (n,) array, optional
        Standard deviation of each point.
    reach_mm
        Points further away than this belong to something else and are not compared.

    Raises
    ------
    InputError
        ``too-few-points`` if fewer than 50 points can be compared.
    """
    rows = measured_rows(points_mm, least=_LEAST, what="A comparison")
    found = surface.nearest((motion or RigidMotion.none()).apply(points_mm[rows]))
    kept = (np.abs(found.signed_mm) <= reach_mm) & ~found.on_border
    signed = np.full(len(points_mm), np.nan)
    normals = np.full((len(points_mm), 3), np.nan)
    signed[rows[kept]] = found.signed_mm[kept]
    normals[rows[kept]] = found.normals[kept]
    return _deviation(signed, normals, alignment_sigma_mm, sigma_mm, reach_mm)


def deviation_from_cloud(
    points_mm: FloatArray,
    reference_mm: FloatArray,
    *,
    motion: RigidMotion | None = None,
    alignment_sigma_mm: float = 0.0,
    sigma_mm: FloatArray | None = None,
    reach_mm: float | None = None,
) -> Deviation:
    """Signed distance of each point from the plane through the nearest points of another cloud.

    Positive lies on the side of larger z. Points beyond the other cloud's border, or in its holes, are not compared:
    the nearest points' middle must lie within three of its spacings along the surface.

    Parameters
    ----------
    points_mm, reference_mm : (n, 3) and (m, 3) arrays
        NaN means "no measurement".
    motion, alignment_sigma_mm, sigma_mm
        As for `deviation_from_mesh`.
    reach_mm
        Points further away than this are not compared; by default ten spacings of the reference.

    Raises
    ------
    InputError
        ``too-few-points`` if fewer than 50 points can be compared.
    """
    rows = measured_rows(points_mm, least=_LEAST, what="A comparison")
    reference = np.asarray(reference_mm, dtype=np.float64)
    reference = reference[measured_rows(reference, least=_LEAST, what="A reference")]
    moved = (motion or RigidMotion.none()).apply(points_mm[rows])
    tree = cKDTree(reference)
    some = reference[:: max(len(reference) // 5000, 1)]
    spacing = float(np.median(np.asarray(tree.query(some, k=5)[0])[:, -1]))
    reach = 10.0 * spacing if reach_mm is None else reach_mm
    near = reference[np.asarray(tree.query(moved, k=_NEIGHBOURS)[1])]
    middle = near.mean(axis=1)
    from_middle = near - middle[:, None]
    direction = np.linalg.eigh(np.einsum("nki,nkj->nij", from_middle, from_middle))[1][:, :, 0]
    direction = direction * np.where(direction[:, 2:] < 0.0, -1.0, 1.0)
    away = moved - middle
    distance = np.einsum("ij,ij->i", away, direction)
    beside = np.linalg.norm(away - distance[:, None] * direction, axis=1)
    kept = (np.abs(distance) <= reach) & (beside <= 3.0 * spacing)
    signed = np.full(len(points_mm), np.nan)
    normals = np.full((len(points_mm), 3), np.nan)
    signed[rows[kept]] = distance[kept]
    normals[rows[kept]] = direction[kept]
    return _deviation(signed, normals, alignment_sigma_mm, sigma_mm, reach)


def check_tolerance(deviation: Deviation, low_mm: float, high_mm: float) -> ToleranceCheck:
    """Compare deviations with a tolerance.

    Raises
    ------
    InputError
        If the lower limit is not below the upper one.
    """
    if not low_mm < high_mm:
        raise InputError(f"The tolerance from {low_mm:g} to {high_mm:g} mm is empty; give the lower limit first.")
    values = deviation.values_mm
    worst_low, worst_high = (float(v) for v in np.percentile(values, (0.15, 99.85)))
    # The alignment's part is shared by all points; a single point's noise makes the range wider, never narrower.
    margin = 2.0 * deviation.sigma_mm
    verdict: Verdict = "undecided"
    if worst_low - margin >= low_mm and worst_high + margin <= high_mm:
        verdict = "pass"
    elif worst_low + margin < low_mm or worst_high - margin > high_mm:
        verdict = "fail"
    inside = float(((values >= low_mm) & (values <= high_mm)).mean())
    return ToleranceCheck(low_mm, high_mm, verdict, inside, worst_low, worst_high, margin)


def deviation_colours(signed_mm: FloatArray, limit_mm: float) -> ByteArray:
    """Colours of deviations: blue inside, white on the surface, red outside, grey without a deviation.

    Parameters
    ----------
    signed_mm : (n,) array
    limit_mm
        Deviation of full colour.
    """
    share = np.clip(np.nan_to_num(signed_mm) / limit_mm, -1.0, 1.0)[:, None]
    white, red, blue = np.array([245.0, 245, 245]), np.array([190.0, 20, 30]), np.array([20.0, 60, 190])
    mixed = np.where(share >= 0.0, white + share * (red - white), white - share * (blue - white))
    mixed[np.isnan(signed_mm)] = 128.0
    return np.asarray(np.round(mixed), dtype=np.uint8)


def _deviation(
    signed: FloatArray, normals: FloatArray, alignment_mm: float, sigma_mm: FloatArray | None, reach_mm: float
) -> Deviation:
    compared = ~np.isnan(signed)
    count = int(compared.sum())
    if count < _LEAST:
        raise InputError(
            f"Only {count} of {len(signed)} points lie within {reach_mm:.3g} mm of the reference, too few to compare; "
            "check that both show the same object in the same place, or let them be aligned.",
            code="too-few-points",
        )
    noise = 0.0 if sigma_mm is None else float(np.median(np.asarray(sigma_mm)[compared]))
    return Deviation(signed, normals, float(np.hypot(noise, alignment_mm)), compared)
