"""The same stripes and ToF readings under several rigs: how well the sensors agree then, and what the scan looks like.

A calibration is judged on what it was calibrated from, so these numbers say how far a rig is self-consistent; that it
is right they cannot say alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinline.arrays import FloatArray, IntArray
from twinline.calibration.joint_model import Scanner, TofPoints, tof_points
from twinline.calibration.observations import StripePoints, TofReadings, clean_stripes, stripe_points
from twinline.calibration.scanner import ScannerResult, StripeTable, bed_clouds, scanner_of_rig
from twinline.calibration.tof_start import follow_on, height_map
from twinline.geometry.rig import Rig

LEAST_CELL_MM = 1.5
_OBJECT_MM = 1.0
_ROUGHLY_OBJECT_MM = 3.0
"""A rig without tilts puts the bed's far corners some millimetres too high."""
_FEWEST = 20
_MOST_POINTS = 60_000
_BAND_MM = 0.6
_LANE_MM = 2.0
_MOST_IN_PROFILE = 240


@dataclass(frozen=True, eq=False)
class SamePoints:
    """What the sensors saw, in the units in which they saw it.

    Attributes
    ----------
    objects, beds
        Stripes of each laser on what stands on the bed, and on the bed.
    tof_objects, tof_bed
        The same of the ToF sensor; None without one.
    cell_mm
        Size of the cells in which heights are compared.
    """

    objects: tuple[StripePoints, ...]
    beds: tuple[StripePoints, ...]
    tof_objects: TofPoints | None
    tof_bed: TofPoints | None
    cell_mm: float


@dataclass(frozen=True, eq=False)
class PairDifference:
    """Heights by one sensor less heights by another at the same places.

    Attributes
    ----------
    objects_mm, bed_mm : (n,) and (m,) arrays
        Differences on objects and on the bed.
    places_mm, all_mm : (k, 2) and (k,) arrays
        Differences everywhere, and where in the bed frame.
    """

    pair: str
    objects_mm: FloatArray
    bed_mm: FloatArray
    places_mm: FloatArray
    all_mm: FloatArray


@dataclass(frozen=True, eq=False)
class ProfileRows:
    """Which points lie on one line along the travel: their rows per laser, on objects and bed, and of the ToF."""

    y_mm: float
    lasers: tuple[tuple[IntArray, IntArray], ...]
    tof: tuple[IntArray, IntArray] | None


def points_of_result(result: ScannerResult) -> SamePoints:
    """The points that a joint adjustment used."""
    tof_objects = tof_bed = None
    if result.tof is not None and result.observations is not None:
        tof_objects = result.observations.tof_objects
        heights = _heights(result.scanner, result.tof)
        tof_bed = result.tof.take(np.abs(heights) <= _OBJECT_MM)
    return SamePoints(
        tuple(s.objects for s in result.seen),
        tuple(s.bed for s in result.seen),
        tof_objects,
        tof_bed,
        max(result.cell_mm, LEAST_CELL_MM),
    )


def points_of_tables(rig: Rig, tables: Sequence[StripeTable], readings: TofReadings | None) -> SamePoints:
    """The points of a pass where no joint adjustment sorted them: what is higher than 3 mm by ``rig`` is an object."""
    scanner = scanner_of_rig(rig)
    along_u = rig.stripe_runs == "along-u"
    stripes = [
        stripe_points(t.centre_px, t.sd_px, t.cart_mm, clean_stripes(t.centre_px)[0], along_u=along_u) for t in tables
    ]
    heights = [cloud[:, 2] for cloud in bed_clouds(scanner, stripes)]
    tof_objects = tof_bed = None
    if readings is not None and scanner.tof is not None:
        tof = follow_on(readings)
        tof_heights = _heights(scanner, tof)
        tof_objects, tof_bed = (
            tof.take(tof_heights > _ROUGHLY_OBJECT_MM),
            tof.take(np.abs(tof_heights) <= _ROUGHLY_OBJECT_MM),
        )
    with np.errstate(invalid="ignore"):
        objects = tuple(_thinned(s.take(z > _ROUGHLY_OBJECT_MM)) for s, z in zip(stripes, heights, strict=True))
        beds = tuple(_thinned(s.take(z <= _ROUGHLY_OBJECT_MM)) for s, z in zip(stripes, heights, strict=True))
    return SamePoints(objects, beds, tof_objects, tof_bed, LEAST_CELL_MM)


def _thinned(stripes: StripePoints) -> StripePoints:
    return stripes.take(np.arange(0, len(stripes), max(1, len(stripes) // _MOST_POINTS)))


def _heights(scanner: Scanner, tof: TofPoints) -> FloatArray:
    return np.asarray((tof_points(scanner, tof) @ scanner.axes().T)[:, 2] + scanner.height_mm())


def _tof_cloud(scanner: Scanner, tof: TofPoints) -> FloatArray:
    return np.asarray(tof_points(scanner, tof) @ scanner.axes().T + np.array([0.0, 0.0, scanner.height_mm()]))


def compare_sensors(scanner: Scanner, points: SamePoints) -> tuple[PairDifference, ...]:
    """Differences of all pairs of sensors that saw the same places, on objects at least at 20 of them."""
    names = [f"laser {k + 1}" for k in range(len(points.objects))]
    objects, beds = bed_clouds(scanner, points.objects), bed_clouds(scanner, points.beds)
    if scanner.tof is not None and points.tof_objects is not None and points.tof_bed is not None:
        names.append("ToF")
        objects.append(_tof_cloud(scanner, points.tof_objects))
        beds.append(_tof_cloud(scanner, points.tof_bed))
    found = []
    for i in range(len(names)):
        for j in range(i + 1, len(names)):
            pair = _difference(f"{names[i]} against {names[j]}", objects, beds, (i, j), points.cell_mm)
            if len(pair.objects_mm) >= _FEWEST:
                found.append(pair)
    return tuple(found)


def _difference(
    name: str, objects: list[FloatArray], beds: list[FloatArray], which: tuple[int, int], cell_mm: float
) -> PairDifference:
    i, j = which
    on_objects, _ = _above(objects[i], np.empty((0, 3)), objects[j], cell_mm)
    on_bed, _ = _above(beds[i], np.empty((0, 3)), beds[j], cell_mm)
    everywhere, places = _above(objects[i], beds[i], np.concatenate([objects[j], beds[j]]), cell_mm)
    return PairDifference(name, on_objects, on_bed, places, everywhere)


def _above(first: FloatArray, ground: FloatArray, second: FloatArray, cell_mm: float) -> tuple[FloatArray, FloatArray]:
    """Height of the first cloud less that of the second at the second's places, and these."""
    first, ground, second = (c[np.isfinite(c).all(axis=1)] for c in (first, ground, second))
    if not len(second) or not len(first) + len(ground):
        return np.empty(0), np.empty((0, 2))
    difference = height_map([first], [ground], cell_mm).at(second[:, 0], second[:, 1]) - second[:, 2]
    known = np.isfinite(difference)
    return np.asarray(difference[known]), np.asarray(second[known, :2])


def profile_rows(scanner: Scanner, points: SamePoints) -> ProfileRows | None:
    """Points on the line along the travel under which the most of the objects is cut; None without objects."""
    objects, beds = bed_clouds(scanner, points.objects), bed_clouds(scanner, points.beds)
    raised = np.concatenate([c[np.isfinite(c).all(axis=1)] for c in objects])
    if not len(raised):
        return None
    lanes = np.floor(raised[:, 1] / _LANE_MM).astype(np.int64)
    area = np.bincount(lanes - lanes.min(), weights=np.maximum(raised[:, 2], 0.0))
    y = float((lanes.min() + int(np.argmax(area)) + 0.5) * _LANE_MM)

    def near(cloud: FloatArray) -> IntArray:
        rows = np.flatnonzero(np.abs(cloud[:, 1] - y) <= _BAND_MM)
        return rows[:: max(1, len(rows) // _MOST_IN_PROFILE)]

    tof = None
    if scanner.tof is not None and points.tof_objects is not None and points.tof_bed is not None:
        tof = near(_tof_cloud(scanner, points.tof_objects)), near(_tof_cloud(scanner, points.tof_bed))
    lasers = tuple((near(a), near(b)) for a, b in zip(objects, beds, strict=True))
    return ProfileRows(y, lasers, tof)


def profile(scanner: Scanner, points: SamePoints, rows: ProfileRows) -> dict[str, FloatArray]:
    """x along the travel and height of the chosen points under a rig, (n, 2) by sensor, in the order of x."""
    stripes = [
        StripePoints.join([points.objects[k].take(on_objects), points.beds[k].take(on_bed)])
        for k, (on_objects, on_bed) in enumerate(rows.lasers)
    ]
    found = {f"laser {k + 1}": cloud[:, [0, 2]] for k, cloud in enumerate(bed_clouds(scanner, stripes))}
    if (
        rows.tof is not None
        and scanner.tof is not None
        and points.tof_objects is not None
        and points.tof_bed is not None
    ):
        taken = points.tof_objects.take(rows.tof[0]), points.tof_bed.take(rows.tof[1])
        found["ToF"] = np.concatenate([_tof_cloud(scanner, part) for part in taken])[:, [0, 2]]
    ordered = {name: line[np.isfinite(line).all(axis=1)] for name, line in found.items()}
    return {name: line[np.argsort(line[:, 0], kind="stable")] for name, line in ordered.items()}
