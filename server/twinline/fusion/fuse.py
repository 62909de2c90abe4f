"""One cloud from two lasers and a ToF sensor that live in one calibrated frame; nothing is registered.

Every point of one laser is laid over the surface that the other laser saw around it. Where they agree within four
standard deviations of their difference, their heights are combined by inverse variance; where they do not, one of them
is a ghost of a reflection or gloss, or both are, and what is left out is counted by reason. The ToF sensor decides
where it can, fills what the lasers cannot reach, and is left aside where they can.

Points keep their places over the bed: nothing is resampled, so that walls keep theirs.

Stripe centres err by more than their pixels' noise tells, because a surface's texture moves them. It moves both lasers'
heights in opposite directions, so that their difference shows how much, and their mean is nearly free of it.
"""

from collections import Counter
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from scipy.spatial import cKDTree

from twinline.arrays import BoolArray, ByteArray, FloatArray, IntArray
from twinline.fusion.cloud import PointCloud, Source
from twinline.fusion.neighbours import LocalSurface, PointGrid

GATE_SD = 4.0
TOF_LEAST_MM = 0.05
"""Where lasers measure too, no ToF point counts as better than this: its spot is wide and its raster coarse."""

_LEANING = 0.4
_STEEPEST = 2.2
_STEADY = 16.0
_TOF_STEEPEST = 0.5
_CLEARLY = 2.0
_LEAST_COUNT = 6
_NOT_OPPOSITE = 0.1
_BLOCK = 1 << 17
_FEWEST_AGREEING = 200
_MOST_DOUBT = 5.0
_GLOSSY_DN = 250.0
_TOF_APART_MM = 0.5
_LASERS_APART_MM = 0.3


class Reason(IntEnum):
    """What became of a point."""

    KEPT = 0
    INTERREFLECTION = 1
    """The other laser, or the ToF sensor, sees a steady surface elsewhere, and this point is the worse measured one."""
    GLOSS = 2
    """The same, where this point's stripe is saturated."""
    CONTRADICTION = 3
    """The lasers see steady surfaces at different heights, and nothing tells which is right: both are left out."""
    REACHED_BY_LASERS = 4
    """A ToF point where lasers measured."""
    STRAY = 5
    """A ToF point away from the surface that its neighbours form."""


REASON_NAMES = {
    Reason.INTERREFLECTION: "interreflection",
    Reason.GLOSS: "gloss",
    Reason.CONTRADICTION: "lasers contradict each other",
    Reason.REACHED_BY_LASERS: "tof where lasers see",
    Reason.STRAY: "tof stray",
}


@dataclass(frozen=True)
class FusionSettings:
    """Measures of the fusion.

    Attributes
    ----------
    reach_mm : (float, float)
        Distance of a laser's points from each other on the bed, along the travel and across it.
    tof_reach_mm : (float, float)
        The same of the ToF raster: distance of its lines, and how far it is averaged along them.
    """

    reach_mm: tuple[float, float]
    tof_reach_mm: tuple[float, float] = (1.5, 0.6)


@dataclass(frozen=True)
class Agreement:
    """How two lasers agree where both saw the same place.

    Attributes
    ----------
    places
        Number of comparisons.
    trusted
        Whether the difference is such as the deviations allow, so that the lasers may be fused.
    offset_mm, scatter_mm
        Median of laser 1 less laser 2, and the robust standard deviation of the difference.
    systematic_mm
        What each laser errs by beyond its reported deviation, as a standard deviation: the surface's texture, mostly.
        It is added to every deviation.
    """

    places: int = 0
    trusted: bool = True
    offset_mm: float = float("nan")
    scatter_mm: float = float("nan")
    systematic_mm: float = 0.0


@dataclass(frozen=True, eq=False)
class Fused:
    """The fused cloud and its account.

    Attributes
    ----------
    rejected_mm : (k, 3) array
        Laser points that were left out, with ``rejected_reason`` (k,) of `Reason`.
    counts
        How many points were left out, by reason.
    warnings
        What keeps the sensors from being fused, a sentence each.
    """

    cloud: PointCloud
    agreement: Agreement
    rejected_mm: FloatArray
    rejected_reason: ByteArray
    counts: dict[str, int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


class Fusion:
    """Takes in points as they come and fuses what it has, whenever it is asked.

    The result depends on the points and their order alone, so a live view that feeds frame by frame ends in the very
    cloud of an offline run.
    """

    def __init__(self, settings: FusionSettings) -> None:
        self._settings = settings
        self._lasers: list[PointCloud] = []
        self._tof: list[PointCloud] = []

    def add(self, cloud: PointCloud) -> None:
        """Points of the lasers, those of one frame or of many."""
        if len(cloud):
            self._lasers.append(cloud)

    def add_tof(self, cloud: PointCloud) -> None:
        """Points of the ToF sensor."""
        if len(cloud):
            self._tof.append(cloud)

    def result(self) -> Fused:
        """Fuse everything so far."""
        self._lasers = [PointCloud.concatenate(self._lasers)]
        self._tof = [PointCloud.concatenate(self._tof)]
        return fuse(self._lasers[0], self._tof[0], self._settings)


def fuse(lasers: PointCloud, tof: PointCloud, settings: FusionSettings) -> Fused:
    """Fuse points of the lasers (sources 1 and 2) with points of a ToF sensor, all in one bed frame.

    Sensors that contradict each other all over are not fused, for then the calibration is wrong and not the points:
    all laser points are kept as they are, and a ToF sensor that lies off the lasers is left out.
    """
    lasers = lasers.select(_usable(lasers))
    tof = tof.select(_usable(tof))
    both = _Lasers(lasers, settings)
    agreement = both.agreement()
    warnings = [] if agreement.trusted else [_lasers_apart(agreement)]
    tof, strays = _steady_tof(tof, settings)
    told = _tof_surface(tof, lasers, settings)
    apart = _tof_apart(told, lasers)
    if apart is not None:
        warnings.append(apart)
        tof = PointCloud.empty()
        told = _tof_surface(tof, lasers, settings)
    cloud, reason = both.fused(agreement, told) if agreement.trusted else (lasers, np.zeros(len(lasers), np.uint8))
    kept = cloud.select(reason == Reason.KEPT)
    left = _unreached(tof, kept, settings)
    counts = Counter({REASON_NAMES[Reason(r)]: int((reason == r).sum()) for r in np.unique(reason) if r})
    counts[REASON_NAMES[Reason.REACHED_BY_LASERS]] = len(tof) - int(left.sum())
    counts[REASON_NAMES[Reason.STRAY]] = strays
    filling = tof.select(left)
    return Fused(
        PointCloud.concatenate([kept, _coloured_like(filling, kept)]) if len(filling) else kept,
        agreement,
        np.asarray(lasers.points_mm[reason != Reason.KEPT]),
        reason[reason != Reason.KEPT],
        {name: number for name, number in counts.items() if number},
        tuple(warnings),
    )


def _lasers_apart(agreement: Agreement) -> str:
    return (
        f"Laser 1 and laser 2 lie {abs(agreement.offset_mm):.2f} mm apart with a scatter of "
        f"{agreement.scatter_mm:.2f} mm, many times their deviations, and were not fused: calibrate the scanner."
    )


def _tof_surface(tof: PointCloud, lasers: PointCloud, settings: FusionSettings) -> LocalSurface:
    """What the ToF sensor says at the lasers' points."""
    grid = PointGrid(tof.points_mm, tof.sigma_mm, max(settings.tof_reach_mm))
    return grid.surface(lasers.points_mm, settings.tof_reach_mm)


def _tof_apart(told: LocalSurface, lasers: PointCloud) -> str | None:
    """Why the ToF sensor cannot be fused with the lasers; None where it can."""
    with np.errstate(invalid="ignore"):
        off = (told.height_mm - lasers.points_mm[:, 2])[(told.lean < _LEANING) & (told.steepness < _TOF_STEEPEST)]
    off = off[np.isfinite(off)]
    if len(off) < _FEWEST_AGREEING:
        return None
    middle = float(np.median(off))
    if abs(middle) <= _TOF_APART_MM:
        return None
    return (
        f"The ToF sensor lies {middle:+.2f} mm from the lasers and was left out: calibrate its mount with a scan of "
        "objects that both see."
    )


class _Lasers:
    """The two lasers' points, each seen against the other laser's surface and against its own."""

    def __init__(self, cloud: PointCloud, settings: FusionSettings) -> None:
        self._cloud = cloud
        z = cloud.points_mm[:, 2].astype(np.float64)
        self._variance = cloud.sigma_mm.astype(np.float64) ** 2
        self._settings = settings
        self._members = [np.flatnonzero(cloud.source == source) for source in (Source.LASER_1, Source.LASER_2)]
        self._other = self._surface(np.arange(len(cloud)), other=True)
        self._difference = self._other.height_mm - z
        self._sd = np.sqrt(self._variance + self._other.variance_mm2)

    def _surface(self, wanted: IntArray, *, other: bool) -> LocalSurface:
        """The other laser's surface, or each point's own laser's, around some of the points."""
        names = list(LocalSurface.__dataclass_fields__)
        # Half of the digits are enough for a comparison, and a long pass has many points.
        values = np.full((len(names), len(wanted)), np.nan, np.float32)
        for k, rows in enumerate(self._members):
            seen = self._members[1 - k] if other else rows
            mine = np.flatnonzero(self._cloud.source[wanted] == Source.LASER_1 + k)
            if not len(mine) or not len(seen):
                continue
            grid = PointGrid(self._cloud.points_mm[seen], self._cloud.sigma_mm[seen], max(self._settings.reach_mm))
            for block in np.array_split(mine, len(mine) // _BLOCK + 1):
                found = grid.surface(self._cloud.points_mm[wanted[block]], self._settings.reach_mm)
                for row, name in enumerate(names):
                    values[row, block] = getattr(found, name)
        return LocalSurface(*values)

    def _comparable(self) -> BoolArray:
        other = self._other
        with np.errstate(invalid="ignore"):
            return np.asarray(np.isfinite(self._difference) & (other.lean < _LEANING) & (other.steepness < _STEEPEST))

    def agreement(self) -> Agreement:
        """How the lasers agree, where both see a surface."""
        rows = self._comparable()
        if rows.sum() < _FEWEST_AGREEING:
            return Agreement(int(rows.sum()), trusted=True)
        # Laser 1 less laser 2, from either side.
        sign = np.where(self._cloud.source[rows] == Source.LASER_1, -1.0, 1.0)
        difference = sign * self._difference[rows]
        offset = float(np.median(difference))
        scatter = 1.4826 * float(np.median(np.abs(difference - offset)))
        ratio = 1.4826 * float(np.median(np.abs(difference / self._sd[rows])))
        apart = 1.4826 * float(np.median(np.abs(difference)))
        # Fine deviations may be many times too small; what may not be is that the lasers see two different surfaces.
        trusted = ratio <= _MOST_DOUBT or apart <= _LASERS_APART_MM
        excess = max(apart**2 - float(np.median(self._sd[rows] ** 2)), 0.0)
        return Agreement(int(rows.sum()), trusted, offset, scatter, float(np.sqrt(0.5 * excess)))

    def fused(self, agreement: Agreement, truth: LocalSurface) -> tuple[PointCloud, ByteArray]:
        """All points, moved to the common height where the lasers agree, and what is to become of each."""
        cloud, other = self._cloud, self._other
        excess = agreement.systematic_mm**2
        with np.errstate(invalid="ignore"):
            close = np.abs(self._difference) <= GATE_SD * np.sqrt(self._sd**2 + 2.0 * excess)
        near = self._comparable()
        agree = near & close
        points, source = cloud.points_mm.copy(), cloud.source.copy()
        sigma = np.sqrt(self._variance + excess).astype(np.float32)
        one, two = self._variance[agree], other.variance_mm2[agree]
        weight = (one + excess) / (one + two + 2.0 * excess)
        points[agree, 2] += (weight * self._difference[agree]).astype(np.float32)
        # What is systematic has opposite signs in the two lasers, or nearly so.
        left = ((1.0 - 2.0 * weight) ** 2 + _NOT_OPPOSITE) * excess
        sigma[agree] = np.sqrt((1.0 - weight) ** 2 * one + weight**2 * two + left).astype(np.float32)
        source[agree] = Source.BOTH_LASERS
        _weigh_in(points, sigma, truth)
        return PointCloud(points, sigma, cloud.intensity, cloud.colour, source), self._judged(
            near & ~close, excess, truth
        )

    def _judged(self, apart: BoolArray, excess: float, truth: LocalSurface) -> ByteArray:
        """What becomes of points that lie off the other laser's surface."""
        cloud, other = self._cloud, self._other
        reason = np.zeros(len(cloud), np.uint8)
        own_mm = np.full(len(cloud), np.nan)
        own_mm[apart] = self._surface(np.flatnonzero(apart), other=False).height_mm
        with np.errstate(invalid="ignore"):
            steady = (
                apart
                & (other.misfit * self._variance < _STEADY * (self._variance + excess))
                & (other.count >= _LEAST_COUNT)
            )
            # One of the two may still be a lone point beside its own laser's surface.
            alone = ~(np.abs(own_mm - cloud.points_mm[:, 2]) <= GATE_SD * np.sqrt(self._variance + excess))
            worse = self._variance > _CLEARLY**2 * other.variance_mm2 * np.maximum(other.count, 1.0) / 4.0
            better = self._variance * _CLEARLY**2 * 4.0 < other.variance_mm2 * np.maximum(other.count, 1.0)
            here = np.abs(truth.height_mm - cloud.points_mm[:, 2])
            there = np.abs(truth.height_mm - other.height_mm)
            told = steady & np.isfinite(here) & (truth.lean < _LEANING)
        lost = steady & (alone | worse)
        both = steady & ~lost & ~better
        lost = np.where(told, here > there, lost)
        both &= ~told
        reason[both] = Reason.CONTRADICTION
        reason[lost] = np.where(cloud.intensity[lost] >= _GLOSSY_DN, Reason.GLOSS, Reason.INTERREFLECTION)
        return reason


def _weigh_in(points: FloatArray, sigma: FloatArray, tof: LocalSurface) -> None:
    """Combine heights with the ToF sensor's where they agree, in place."""
    variance = tof.variance_mm2 * np.maximum(tof.misfit, 1.0) + TOF_LEAST_MM**2
    difference = tof.height_mm - points[:, 2]
    with np.errstate(invalid="ignore"):
        rows = np.flatnonzero(
            (np.abs(difference) <= GATE_SD * np.sqrt(sigma**2 + variance))
            & (tof.lean < _LEANING)
            & (tof.misfit < _STEADY)
            & (tof.steepness < _TOF_STEEPEST)
        )
    own = sigma[rows].astype(np.float64) ** 2
    weight = own / (own + variance[rows])
    points[rows, 2] += (weight * difference[rows]).astype(np.float32)
    sigma[rows] = np.sqrt(weight * variance[rows]).astype(np.float32)


def _usable(cloud: PointCloud) -> BoolArray:
    return np.asarray(np.isfinite(cloud.points_mm).all(axis=1) & np.isfinite(cloud.sigma_mm) & (cloud.sigma_mm > 0))


def _steady_tof(tof: PointCloud, settings: FusionSettings) -> tuple[PointCloud, int]:
    """ToF points that lie on the surface of their own neighbourhood, and the number of those that do not."""
    if not len(tof):
        return tof, 0
    around = PointGrid(tof.points_mm, tof.sigma_mm, max(settings.tof_reach_mm)).surface(
        tof.points_mm, settings.tof_reach_mm
    )
    with np.errstate(invalid="ignore"):
        off = np.abs(around.height_mm - tof.points_mm[:, 2])
        stray = off > GATE_SD * np.hypot(tof.sigma_mm, np.sqrt(around.variance_mm2)) + 0.5 * around.steepness
    return tof.select(~stray), int(stray.sum())


def _unreached(tof: PointCloud, kept: PointCloud, settings: FusionSettings) -> BoolArray:
    """ToF points with no laser point around, (n,)."""
    reach = 0.5 * float(np.hypot(*settings.reach_mm))
    grid = PointGrid(kept.points_mm, kept.sigma_mm, reach)
    return np.asarray(~np.isfinite(grid.nearest(tof.points_mm, reach)[0]))


def _coloured_like(points: PointCloud, painted: PointCloud) -> PointCloud:
    """The points with the colours of the nearest ones that have any."""
    if not len(painted):
        return points
    _, nearest = cKDTree(painted.points_mm).query(points.points_mm)
    return PointCloud(points.points_mm, points.sigma_mm, points.intensity, painted.colour[nearest], points.source)
