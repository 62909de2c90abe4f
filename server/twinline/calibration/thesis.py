"""The thesis's whole calibration: sheets against ToF, laser 1 to laser 2, ToF to both.

Its steps are in `twinline.calibration.thesis_picks`, `thesis_fit` and `thesis_align`, each with the trace of its
Nelder-Mead search; `thesis_rig` makes rigs of their results.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinline.calibration.observations import StripePoints, TofReadings
from twinline.calibration.thesis_align import LaserShift, TofAlignment, align_lasers, align_tof
from twinline.calibration.thesis_fit import Lens, SheetFit, fit_sheet
from twinline.calibration.thesis_picks import PickedPoints, pick_points
from twinline.calibration.thesis_rig import apply_laser_shift, apply_sheets, apply_tof
from twinline.calibration.thesis_surface import laser_cloud, tof_cloud
from twinline.errors import CalibrationError
from twinline.geometry.rig import Rig


@dataclass(frozen=True, eq=False)
class ThesisCalibration:
    """What the thesis's calibration came to.

    Attributes
    ----------
    rig
        With all results applied.
    fits
        One per laser.
    shift
        Of laser 1 against laser 2; None with one laser.
    alignment
        Of the ToF cloud.
    notes
        Results that could not become part of the rig, with the reason.
    """

    rig: Rig
    fits: tuple[SheetFit, ...]
    shift: LaserShift | None
    alignment: TofAlignment
    notes: tuple[str, ...]


def calibrate_thesis(
    rig: Rig,
    stripes: Sequence[StripePoints],
    readings: TofReadings,
    *,
    picks: Sequence[PickedPoints] | None = None,
    per_level: int = 20,
    lens: Lens = "ignored",
    cell_mm: float = 1.0,
    with_yaw: bool = False,
) -> ThesisCalibration:
    """Calibrate as the thesis does, from a laser pass and a ToF raster over the same objects.

    Parameters
    ----------
    rig
        Nominal rig; its baselines and angles are where the search starts.
    stripes
        One per laser, over the whole pass.
    picks
        Points chosen by hand, one set per laser; found by `pick_points` where they are not given.
    per_level, lens, cell_mm, with_yaw
        See `pick_points`, `fit_sheet`, `align_lasers` and `align_tof`.

    Raises
    ------
    CalibrationError
        A step has too little to go by; it names the step and what to do.
    """
    if len(stripes) != len(rig.sheets):
        raise CalibrationError(
            f"There are stripes of {len(stripes)} lasers and the rig has {len(rig.sheets)}: record the pass with the "
            "lasers that capture.json names.",
            code="bad-stripes",
        )
    raster = tof_cloud(rig, readings)
    if picks is None:
        picks = [
            pick_points(rig, k, part, raster, per_level=per_level, cell_mm=cell_mm) for k, part in enumerate(stripes)
        ]
    fits = tuple(
        fit_sheet(rig.camera, sheet.side, points, start=sheet, lens=lens)
        for sheet, points in zip(rig.sheets, picks, strict=True)
    )
    result = apply_sheets(rig, fits)
    shift, notes = None, []
    if len(stripes) == 2:
        shift = align_lasers(laser_cloud(result, 0, stripes[0]), laser_cloud(result, 1, stripes[1]), cell_mm=cell_mm)
        try:
            result = apply_laser_shift(result, shift)
        except CalibrationError as refusal:
            # The sheets are still worth comparing; the reader learns what is missing.
            notes.append(f"The shift of laser 1 is not part of the rig. {refusal.detail}")
    merged = np.concatenate([laser_cloud(result, k, part) for k, part in enumerate(stripes)])
    alignment = align_tof(tof_cloud(result, readings), merged, cell_mm=cell_mm, with_yaw=with_yaw)
    return ThesisCalibration(apply_tof(result, alignment), fits, shift, alignment, tuple(notes))
