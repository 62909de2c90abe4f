"""Dimensions of a block standing on the bed, from what is seen of it from above."""

from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from scipy.spatial import cKDTree

from twinline.arrays import FloatArray, IntArray
from twinline.errors import InputError
from twinline.fusion.inspection.plane import PlaneFit, fit_plane
from twinline.fusion.inspection.quantity import Quantity, measured_rows
from twinline.fusion.inspection.robust import robust_fit

_LEAST = 200
_ROWS_PER_BIN = 5
_LEAST_BINS = 4
# Outermost points of a bin whose distances tell how far beyond them the edge lies.
_RANK = 12


@dataclass(frozen=True, eq=False)
class PrismFit:
    """A rectangular block seen from above.

    Attributes
    ----------
    length, width
        Longer and shorter side of its top face.
    height
        Of the top face over the bed, at the middle of the face.
    angle_deg
        Of the longer side against x, from -90 to 90.
    corners_mm : (4, 3) array
        Of the top face, around it.
    top : PlaneFit
        Of the top face; its rows are those of the cloud given.
    used : (m,) int array
        Rows of the points that the top, the edges and the bed used.
    """

    length: Quantity
    width: Quantity
    height: Quantity
    angle_deg: float
    corners_mm: FloatArray
    top: PlaneFit
    used: IntArray


def fit_prism(points_mm: FloatArray, sigma_mm: FloatArray | None = None) -> PrismFit:
    """Measure a block that stands alone among the points, on the bed.

    The height is that of its top plane over the plane of the bed around it, or over z = 0 where no bed is among the
    points. The sides are the distances of four lines at right angles, fitted to where the top face ends: the outermost
    points do not reach the edge, so each place of the edge is put beyond them by the spacing that they show. A cloud
    from which points that straddle an edge were dropped shows a smaller face, and gives that face's sides.

    Parameters
    ----------
    points_mm : (n, 3) array
        In the bed frame; NaN means "no measurement".
    sigma_mm : (n,) array, optional
        Standard deviation of each point.

    Raises
    ------
    InputError
        ``too-few-points``, or ``undetermined`` if there is no block with a flat top.
    """
    rows = measured_rows(points_mm, least=_LEAST, what="A block")
    points = np.asarray(points_mm, dtype=np.float64)[rows]
    sigma = None if sigma_mm is None else np.asarray(sigma_mm)[rows]
    on_top, top = _top_face(points, sigma)
    height, on_bed = _height(points, sigma, top)
    flat = points[on_top][:, :2]
    state, covariance, at_edge = _rectangle(flat)
    sides = [
        (Quantity(state[1 + i] + state[3 + i], _sum_sigma(covariance, 1 + i, 3 + i)), float(state[0]) + i * np.pi / 2)
        for i in range(2)
    ]
    (length, angle), (width, _) = sorted(sides, key=lambda side: -side[0].value)
    used = np.unique(np.concatenate([on_top[top.used], on_top[at_edge], on_bed]))
    return PrismFit(
        length,
        width,
        height,
        float((np.degrees(angle) + 90.0) % 180.0 - 90.0),
        _corners(state, top),
        top,
        rows[used],
    )


def _top_face(points: FloatArray, sigma: FloatArray | None) -> tuple[IntArray, PlaneFit]:
    """Rows of the top face and its plane; the face is the highest height at which many points lie."""
    z = points[:, 2]
    low, high = min(float(z.min()), 0.0), float(z.max())
    counts, edges = np.histogram(z, bins=400, range=(low, high + 1e-9))
    bin_mm = float(edges[1] - edges[0])
    heaped = np.convolve(counts, np.ones(7), mode="same")
    upper = edges[:-1] > low + 0.25 * (high - low)
    if not upper.any() or heaped[upper].max() < 0.02 * len(z):
        raise _no_block()
    place = int(np.flatnonzero(upper)[np.argmax(heaped[upper])])
    middle = float(edges[place] + bin_mm / 2)
    near = np.flatnonzero(np.abs(z - middle) < max(6.0 * bin_mm, 0.15 * (high - low)))
    if len(near) < _LEAST // 2:
        raise _no_block()
    first = fit_plane(points[near], None if sigma is None else sigma[near])
    # Edge points are a mixture of two heights and belong to no face.
    limit = 4.0 * max(first.rms_mm, 1e-6)
    face = near[np.abs(first.deviation_mm) < limit]
    # A bare bed has no face that stands out of its own noise.
    if len(face) < _LEAST // 2 or abs(first.normal[2]) < 0.9 or middle - low < 10.0 * first.rms_mm:
        raise _no_block()
    return face, fit_plane(points[face], None if sigma is None else sigma[face])


def _height(points: FloatArray, sigma: FloatArray | None, top: PlaneFit) -> tuple[Quantity, IntArray]:
    z = points[:, 2]
    floor = float(np.percentile(z, 1.0))
    bed = np.flatnonzero(z < floor + 0.15 * (top.centre_mm[2] - floor))
    upper = top.distance(np.array([top.centre_mm[0], top.centre_mm[1], 0.0]))
    top_z, top_sigma = -upper.value / top.normal[2], top.distance(top.centre_mm).sigma
    if len(bed) < _LEAST // 2 or floor > 0.5 * top.centre_mm[2]:
        return Quantity(float(top_z), top_sigma), np.empty(0, dtype=np.int64)
    plane = fit_plane(points[bed], None if sigma is None else sigma[bed])
    above = plane.distance(top.centre_mm)
    return Quantity(above.value, float(np.hypot(above.sigma, top_sigma))), bed[plane.used]


def _rectangle(flat: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Angle and the four edges' distances from the origin, their covariance, and the rows at the edges.

    The state is angle, distance along +u, +v, -u, -v, where u is x turned by the angle.
    """
    spacing = float(np.median(np.asarray(cKDTree(flat).query(flat, k=2)[0])[:, 1]))
    box = cv2.minAreaRect(_core(flat, spacing).astype(np.float32))
    angle = float(np.radians(box[2]))
    middle = np.asarray(box[0], dtype=np.float64)
    state = np.array([angle, 0.0, 0.0, 0.0, 0.0])
    for _ in range(2):
        places, edge, rows, variance = _edge_places(flat - middle, float(state[0]), spacing)
        fit = robust_fit(
            _middle_state(places, edge, float(state[0])),
            partial(_linearise, places, edge),
            _move,
            places + 1e3 * edge[:, None],
            least_scale_mm=0.2 * spacing,
        )
        state = fit.state
    # Rows along an edge end at one distance from it, which no scatter along the edge shows.
    scatter = np.array([np.var(fit.residuals_mm[fit.used & (edge == k)]) for k in range(4)])
    covariance = fit.covariance + np.diag([0.0, *np.maximum(variance - scatter, 0.0)])
    return np.append(state, middle), covariance, rows


def _core(flat: FloatArray, spacing: float) -> FloatArray:
    """The points that have neighbours all around, so that no stray one stretches the box."""
    count = cKDTree(flat).query_ball_point(flat, 3.0 * spacing, return_length=True)
    return flat[count >= 0.4 * np.median(count)]


def _edge_places(flat: FloatArray, angle: float, spacing: float) -> tuple[FloatArray, IntArray, IntArray, FloatArray]:
    """Places on the four edges, to which edge each belongs, the rows of their points, and each edge's variance (4,).

    Along each edge the face is cut into bins. The edge lies beyond a bin's outermost point by what renewal theory
    calls the forward recurrence time: ``E[g²] / 2 E[g]`` on average, with variance ``E[g³] / 3 E[g]`` less its square,
    where g are the distances of successive points (D. Cox, "Renewal Theory", section 5.4). This holds for rows that run
    along the edge as for those across it, where the outermost points alone would be off by half a spacing.
    """
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    places: list[FloatArray] = []
    edges: list[IntArray] = []
    rows: list[IntArray] = []
    variance = np.zeros(4)
    for edge in range(4):
        outward = turn[edge % 2] * (1.0 if edge < 2 else -1.0)
        along = turn[(edge + 1) % 2]
        s, out = flat @ along, flat @ outward
        low, high = np.percentile(s, (3.0, 97.0))
        count = int((high - low) / (_ROWS_PER_BIN * spacing))
        if count < _LEAST_BINS:
            raise InputError(
                f"The block's edge is only {high - low:.1f} mm long at {spacing:.2f} mm between points; "
                "scan it more densely.",
                code="undetermined",
            )
        index = np.floor((s - low) / (high - low) * count).astype(np.int64)
        order = np.lexsort((-out, index))
        first = np.searchsorted(index[order], np.arange(count))
        last = np.searchsorted(index[order], np.arange(count), side="right")
        whole = last - first >= 2 * _RANK
        outermost = order[first[whole][:, None] + np.arange(_RANK)]
        gap = -np.diff(out[outermost], axis=1)
        beyond = float((gap**2).mean() / (2.0 * gap.mean()))
        variance[edge] = float((gap**3).mean() / (3.0 * gap.mean())) - beyond**2
        place = out[outermost[:, 0]] + beyond
        middle = low + (np.flatnonzero(whole) + 0.5) * (high - low) / count
        places.append(place[:, None] * outward + middle[:, None] * along)
        edges.append(np.full(len(place), edge))
        rows.append(outermost[:, 0])
    return np.concatenate(places), np.concatenate(edges), np.concatenate(rows), variance


def _middle_state(places: FloatArray, edge: IntArray, angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    outward = np.array([[c, s], [-s, c], [-c, -s], [s, -c]])
    return np.array([angle, *(float(np.median(places[edge == k] @ outward[k])) for k in range(4))])


def _linearise(places: FloatArray, edge: IntArray, state: FloatArray) -> tuple[FloatArray, FloatArray]:
    c, s = np.cos(state[0]), np.sin(state[0])
    outward = np.array([[c, s], [-s, c], [-c, -s], [s, -c]])[edge]
    turned = np.array([[-s, c], [-c, -s], [s, -c], [c, s]])[edge]
    members = np.eye(4)[edge]
    residuals = np.einsum("ij,ij->i", places, outward) - members @ state[1:5]
    return residuals, np.column_stack([np.einsum("ij,ij->i", places, turned), -members])


def _move(state: FloatArray, step: FloatArray) -> FloatArray:
    return state + step


def _corners(state: FloatArray, top: PlaneFit) -> FloatArray:
    c, s = np.cos(state[0]), np.sin(state[0])
    u, v = np.array([c, s]), np.array([-s, c])
    flat = (
        np.array(
            [
                a * u + b * v
                for a, b in ((state[1], state[2]), (-state[3], state[2]), (-state[3], -state[4]), (state[1], -state[4]))
            ]
        )
        + state[5:7]
    )
    z = top.centre_mm[2] - (flat - top.centre_mm[:2]) @ top.normal[:2] / top.normal[2]
    return np.column_stack([flat, z])


def _sum_sigma(covariance: FloatArray, i: int, j: int) -> float:
    return float(np.sqrt(covariance[i, i] + covariance[j, j] + 2.0 * covariance[i, j]))


def _no_block() -> InputError:
    return InputError(
        "There is no block with a flat top among the points; choose the region of one block and the bed around it.",
        code="undetermined",
    )
