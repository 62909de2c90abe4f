"""Calibrating a whole scanner: from what was seen to an adjusted scanner, in the order in which things become known."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twinline.arrays import BoolArray, FloatArray
from twinline.calibration.bed_line import bed_groups, find_bed_line
from twinline.calibration.first_sheets import first_sheets
from twinline.calibration.intrinsics import IntrinsicsResult
from twinline.calibration.joint import JointResult, adjust
from twinline.calibration.joint_model import Scanner, TofPoints, TofState, laser_samples, tof_points
from twinline.calibration.joint_priors import (
    camera_prior,
    free_parameters,
    motion_prior,
    sheet_priors,
    tof_place_prior,
    tof_priors,
)
from twinline.calibration.joint_types import KnownPoints, Observations, Prior
from twinline.calibration.observations import StripePoints, TofReadings, clean_stripes, stripe_points
from twinline.calibration.tof_start import (
    FIRST_CUT_MM,
    LAST_CUT_MM,
    HeightMap,
    follow_on,
    height_map,
    start_tof,
    tof_bed_groups,
)
from twinline.calibration.travel import TravelResult
from twinline.errors import CalibrationError
from twinline.geometry.rig import Rig

PARTS = ("camera", "travel", "sheets", "tof")

_TOF_ON_BED_MM = 0.6
_TOF_OBJECT_MM = 1.0
_LEAST_CELL_MM = 1.0
_FEWEST_BED_POINTS = 500
_MOST_OBJECT_POINTS = 60_000
_MAP_EVERY = 2


@dataclass(frozen=True, eq=False)
class StripeTable:
    """Stripes of one laser over a pass: centre and standard deviation, (frames, lanes) in pixels, and the cart."""

    centre_px: FloatArray
    sd_px: FloatArray
    cart_mm: FloatArray


@dataclass(frozen=True, eq=False)
class ScannerData:
    """Everything that a calibration of a scanner may use; what there is not is None or empty.

    Attributes
    ----------
    base
        The scanner as it is known: nominal, or an earlier calibration.
    parts
        Which of `PARTS` to calibrate; the others stay as in ``base``.
    saturated_share
        For each laser the share of its stripes whose light is cut off at the top of the scale.
    """

    base: Rig
    parts: frozenset[str]
    camera: IntrinsicsResult | None = None
    travel: TravelResult | None = None
    stripes: tuple[StripeTable, ...] = ()
    tof: TofReadings | None = None
    known: tuple[KnownPoints, ...] = ()
    saturated_share: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class LaserSeen:
    """One laser's stripes sorted into bed and objects.

    Attributes
    ----------
    on_bed : (frames, lanes) bool array
    stray_share
        Share of the stripes that contradict their surroundings.
    """

    groups: StripePoints
    bed: StripePoints
    objects: StripePoints
    on_bed: BoolArray
    stray_share: float


@dataclass(frozen=True, eq=False)
class ScannerResult:
    """A calibrated scanner and how it came about.

    Attributes
    ----------
    start
        The scanner before any stripe was used.
    nominal
        The base scanner, its ToF mount expressed under the bed pose that was measured since.
    joint, held_out
        The adjustment to all observations, and one that left out a fifth of them; None where there were no stripes.
    """

    scanner: Scanner
    start: Scanner
    covariance: FloatArray
    free: BoolArray
    priors: tuple[Prior, ...]
    nominal: Scanner
    joint: JointResult | None
    held_out: JointResult | None
    observations: Observations | None
    seen: tuple[LaserSeen, ...]
    tof: TofPoints | None
    cell_mm: float
    notes: tuple[str, ...]


def scanner_of_rig(rig: Rig) -> Scanner:
    """A rig in the camera's frame at cart position 0."""
    pose, camera = rig.bed_from_camera, rig.camera
    rotation = pose.rotation
    tof = None
    if rig.tof is not None:
        mount = rig.tof
        down = -rotation[2]
        across = rotation[0] - down * (down @ rotation[0])
        across = across / np.linalg.norm(across)
        axes = np.stack([across, np.cross(down, across), down])
        beam = rotation.T @ mount.beam
        ahead = float(beam @ down)
        tof = TofState(
            rotation.T @ (mount.position_mm - pose.translation_mm),
            rotation.T @ mount.slide,
            axes,
            axes[:2] @ beam / ahead,
            mount.gain_mm_per_unit,
            mount.offset_mm,
            mount.lag_s,
        )
    return Scanner(
        np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion]),
        camera.size,
        rig.stripe_runs,
        tuple(sheet.side for sheet in rig.sheets),
        rotation.T @ rig.travel,
        -rotation[2] / float(pose.translation_mm[2]),
        np.array([sheet.inverse_depth for sheet in rig.sheets]),
        tof,
    )


def calibrate_scanner(data: ScannerData) -> ScannerResult:
    """Calibrate the parts of a scanner for which there are observations.

    Raises
    ------
    CalibrationError
        The observations determine nothing, or contradict each other; says what to do.
    """
    nominal = scanner_of_rig(data.base)
    start = _with_instruments(nominal, data)
    notes: list[str] = []
    priors = [
        camera_prior(start, data.camera, data.base.covariance),
        motion_prior(start, data.travel),
        *sheet_priors(start, nominal.sheets),
    ]
    wants_surface = bool({"sheets", "tof"} & data.parts) and (bool(data.stripes) or bool(data.known))
    if not wants_surface:
        return _without_surface(start, nominal, data, priors, notes)
    seen = tuple(_sort(table, start, k) for k, table in enumerate(data.stripes))
    if data.stripes and not any(len(s.bed) or len(s.objects) for s in seen):
        raise CalibrationError(
            "No stripe of the laser pass goes on smoothly from frame to frame and column to column: check exposure and "
            "focus, and that frames.csv holds the positions in order.",
            code="no-stripe",
        )
    scanner = start
    if "sheets" in data.parts:
        baselines = [abs(sheet.baseline_mm) for sheet in data.base.sheets]
        scanner = replace(start, sheets=first_sheets(start, baselines, [s.groups for s in seen], data.known, notes))
    tof = follow_on(data.tof) if data.tof is not None and scanner.tof is not None else None
    if tof is not None and not len(tof):
        notes.append("The ToF readings hold no two valid ones in a row; they were not used.")
        tof = None
    mount = None
    if tof is None:
        scanner, start = replace(scanner, tof=None), replace(start, tof=None)
    else:
        placed = _expressed(nominal, start)
        priors += tof_priors(scanner, placed)
        mount = placed.tof
        scanner = replace(scanner, tof=mount)
    cell_mm = _cell_mm(scanner, data.stripes)
    done = _adjusted(scanner, data, seen, tof, tuple(priors), cell_mm)
    return ScannerResult(
        done.joint.scanner, start, done.joint.covariance, done.free, done.priors, replace(nominal, tof=mount),
        done.joint, done.held_out, done.observations, seen, tof, cell_mm, tuple(notes),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Adjusted:
    """The adjustment to all observations and the one that leaves some out, with what went into them."""

    joint: JointResult
    held_out: JointResult
    observations: Observations
    free: BoolArray
    priors: tuple[Prior, ...]


def _adjusted(
    scanner: Scanner,
    data: ScannerData,
    seen: Sequence[LaserSeen],
    tof: TofPoints | None,
    priors: tuple[Prior, ...],
    cell_mm: float,
) -> _Adjusted:
    """Observe and adjust, the ToF sensor's place being searched for before each."""
    scanner, observations, found = _observe(scanner, data, seen, tof, cut_mm=FIRST_CUT_MM, cell_mm=cell_mm)
    free = free_parameters(scanner, data.parts)
    joint = adjust(scanner, observations, (*priors, *found), cell_mm=cell_mm, free=free)
    if tof is not None:
        # With the sheets right, the height map is; then the sensor's place on it can be found anew.
        scanner, observations, found = _observe(joint.scanner, data, seen, tof, cut_mm=LAST_CUT_MM, cell_mm=cell_mm)
        free = free_parameters(scanner, data.parts)
        joint = adjust(
            scanner, observations, (*priors, *found), cell_mm=cell_mm, free=free, systematic_mm=joint.systematic_mm
        )
    held_out = adjust(
        joint.scanner, observations, (*priors, *found), cell_mm=cell_mm, free=free, systematic_mm=joint.systematic_mm,
        hold_out=True,
    )  # fmt: skip
    return _Adjusted(joint, held_out, observations, free, (*priors, *found))


def _without_surface(
    start: Scanner, nominal: Scanner, data: ScannerData, priors: list[Prior], notes: list[str]
) -> ScannerResult:
    """Camera and travel alone: nothing is left to adjust, their priors are the result."""
    scanner = replace(start, tof=None)
    theta = scanner.vector()
    information = np.zeros((len(theta), len(theta)))
    for prior in priors:
        design = prior.rows(theta)[1]
        information += design.T @ design
    scale = np.sqrt(np.diagonal(information))
    covariance = np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)
    free = free_parameters(scanner, data.parts)
    return ScannerResult(
        scanner, start, (covariance + covariance.T) / 2, free, tuple(priors), nominal, None, None, None, (), None, 0.0,
        tuple(notes),
    )  # fmt: skip


def _with_instruments(nominal: Scanner, data: ScannerData) -> Scanner:
    """The base scanner with the camera and the travel that their own calibrations gave."""
    scanner = nominal
    if data.camera is not None:
        c = data.camera.camera
        scanner = replace(scanner, camera=np.array([c.fx, c.fy, c.cx, c.cy, *c.distortion]))
    if data.travel is not None:
        scanner = replace(scanner, travel=data.travel.travel, bed=data.travel.bed)
    return scanner


def _expressed(nominal: Scanner, scanner: Scanner) -> Scanner:
    """The nominal ToF mount, which is given against the bed, under the bed pose that has been measured since."""
    assert nominal.tof is not None
    old, new = nominal.axes(), scanner.axes()
    turn = new.T @ old
    tof = nominal.tof
    position = old @ tof.position + np.array([0.0, 0.0, nominal.height_mm()])
    position = new.T @ (position - np.array([0.0, 0.0, scanner.height_mm()]))
    return replace(
        scanner,
        tof=replace(tof, position=position, slide=turn @ tof.slide, beam_axes=tof.beam_axes @ turn.T),
    )


def _sort(table: StripeTable, scanner: Scanner, laser: int) -> LaserSeen:
    """Clean one laser's stripes and tell bed from objects."""
    clean, stray = clean_stripes(table.centre_px)
    along_u = scanner.stripe_runs == "along-u"
    line = find_bed_line(np.where(clean, table.centre_px, np.nan), table.cart_mm, scanner.sides[laser])
    on_bed = line.on_bed & clean if line is not None else np.zeros(clean.shape, bool)
    if on_bed.sum() < _FEWEST_BED_POINTS:
        on_bed = np.zeros(clean.shape, bool)
    bed = stripe_points(table.centre_px, table.sd_px, table.cart_mm, on_bed, along_u=along_u)
    objects = stripe_points(table.centre_px, table.sd_px, table.cart_mm, clean & ~on_bed, along_u=along_u)
    every = max(1, len(objects) // _MOST_OBJECT_POINTS)
    lanes = bed.pixels[:, 0 if along_u else 1]
    return LaserSeen(
        bed_groups(bed, lanes, table.centre_px.shape[1]),
        bed.take(lanes.astype(np.int64) % _MAP_EVERY == 0),
        objects.take(np.arange(0, len(objects), every)),
        on_bed,
        stray,
    )


def _cell_mm(scanner: Scanner, stripes: Sequence[StripeTable]) -> float:
    """A little more than the distance between neighbouring points, in either direction."""
    if not stripes:
        return _LEAST_CELL_MM
    steps = np.diff(np.unique(stripes[0].cart_mm))
    pitch = float(np.median(steps)) * float(np.linalg.norm(scanner.travel)) if len(steps) else 1.0
    lane = scanner.height_mm() / float(scanner.camera[0])
    return max(_LEAST_CELL_MM, 1.3 * pitch, 2.5 * lane)


def bed_clouds(scanner: Scanner, stripes: Sequence[StripePoints]) -> list[FloatArray]:
    """Points of each laser in the bed frame."""
    axes, up = scanner.axes(), np.array([0.0, 0.0, scanner.height_mm()])
    camera = scanner.as_camera()
    return [laser_samples(scanner, k, s, camera).points @ axes.T + up for k, s in enumerate(stripes)]


def surface_of(scanner: Scanner, seen: Sequence[LaserSeen], cell_mm: float) -> HeightMap:
    """Height map by the lasers, in cells that none of their points' spacing leaves empty."""
    objects, beds = (bed_clouds(scanner, part) for part in ([s.objects for s in seen], [s.bed for s in seen]))
    return height_map(objects, beds, cell_mm)


def _observe(
    scanner: Scanner,
    data: ScannerData,
    seen: Sequence[LaserSeen],
    tof: TofPoints | None,
    *,
    cut_mm: float,
    cell_mm: float,
) -> tuple[Scanner, Observations, list[Prior]]:
    """Observations to adjust to; the ToF sensor is laid over the lasers' height map first."""
    tof_bed = tof_objects = None
    found: list[Prior] = []
    if tof is not None:
        if seen and "tof" in data.parts:
            scanner, cost = start_tof(scanner, tof, surface_of(scanner, seen, cell_mm), cut_mm=cut_mm)
            if np.isfinite(cost):
                found = [tof_place_prior(scanner, _usual_distance(scanner, tof))]
        points = tof_points(scanner, tof) @ scanner.axes().T + np.array([0.0, 0.0, scanner.height_mm()])
        tof_bed = tof_bed_groups(tof, points, np.flatnonzero(np.abs(points[:, 2]) < _TOF_ON_BED_MM))
        tof_objects = tof.take(np.flatnonzero(points[:, 2] > _TOF_OBJECT_MM))
    observations = Observations(
        tuple(s.groups for s in seen), tuple(s.objects for s in seen), tof_bed, tof_objects, data.known
    )
    return scanner, observations, found


def _usual_distance(scanner: Scanner, tof: TofPoints) -> float:
    assert scanner.tof is not None
    return float(np.median(scanner.tof.offset + scanner.tof.gain * tof.reading))
