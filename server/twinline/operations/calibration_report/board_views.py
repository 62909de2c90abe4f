"""The pictures of the board in a calibration report, also where no camera came of them."""

from collections.abc import Sequence

import numpy as np

from twinline.calibration.intrinsics import IntrinsicsResult, ViewFit
from twinline.calibration.views import BoardView
from twinline.operations.calibration_report.model import CoverageReport, ViewReport

_NAN = float("nan")


def coverage_report(views: Sequence[BoardView], camera: IntrinsicsResult | None) -> CoverageReport | None:
    """Verdicts, errors and positions of all views; None where there are none."""
    if not views:
        return None
    fits = {fit.name: fit for fit in camera.views} if camera is not None else {}
    size = camera.camera.size if camera is not None else views[0].size
    return CoverageReport(
        size,
        camera.coverage.share if camera is not None else _NAN,
        tuple(_view_report(view, fits.get(view.name)) for view in views),
        tuple((item.missing, f"{item.text}: {item.detail}") for item in camera.coverage.advice)
        if camera is not None
        else (),
    )


def _view_report(view: BoardView, fit: ViewFit | None) -> ViewReport:
    tilt, direction = view.tilt_deg, _NAN
    if fit is not None and fit.camera_from_board is not None:
        # The board's z points away from the viewer, so its face looks along -z.
        facing = -fit.camera_from_board.rotation[:, 2]
        tilt = float(np.degrees(np.arccos(np.clip(-facing[2], -1.0, 1.0))))
        direction = float(np.degrees(np.arctan2(facing[1], facing[0])))
    return ViewReport(
        view.name,
        view.verdict,
        fit.used if fit is not None else False,
        (fit.reason if fit is not None else "") or view.advice,
        fit.rms_px if fit is not None else _NAN,
        fit.held_out_px if fit is not None else _NAN,
        tilt,
        direction,
        tuple((round(float(u), 1), round(float(v), 1)) for u, v in view.pixels),
    )
