"""Intrinsic calibration of a camera from views of a board, with its evidence, or a refusal with the reason."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinline.arrays import BoolArray, FloatArray
from twinline.calibration.bundle import Sightings, Solution, residuals, stack_sightings, view_rms
from twinline.calibration.camera_evidence import (
    MODELS,
    ModelEvidence,
    Uncertainty,
    camera_of,
    choose_model,
    half_focal_lengths,
    held_out_squares,
    lens_sd_px,
    parameter_names,
    pose_only,
    reject_corners,
    uncertainty,
)
from twinline.calibration.camera_refusals import (
    require_agreement,
    require_focal_length,
    require_lens,
    require_one_size,
    require_views,
)
from twinline.calibration.camera_start import first_solution, trusted_views
from twinline.calibration.coverage import Coverage, coverage
from twinline.calibration.views import BoardView
from twinline.errors import CalibrationError, RigError
from twinline.geometry.camera import Camera
from twinline.geometry.rig import Covariance, Transform

GOOD_FOCAL_SD = 0.005
GOOD_LENS_SD_SHARE = 0.005
GOOD_INFLATION = 9.0
_STRANGE_HELD_OUT = 3.0


@dataclass(frozen=True, eq=False)
class ViewFit:
    """How one view agrees with the calibrated camera.

    Attributes
    ----------
    used
        Whether the camera was fitted to it.
    reason
        Why not; empty if used.
    rms_px, largest_px
        Root mean square and largest distance of its corners from their prediction; NaN where the board was not found.
    held_out_px
        The same root mean square under a camera that was fitted without it.
    rejected
        Number of its corners left out as gross errors.
    residuals_px : (n, 2) array
        Predicted minus measured, for each of the view's corners.
    camera_from_board
        Pose of the board; None where it was not found.
    """

    name: str
    used: bool
    reason: str
    rms_px: float
    largest_px: float
    held_out_px: float
    rejected: int
    residuals_px: FloatArray
    camera_from_board: Transform | None


@dataclass(frozen=True, eq=False)
class IntrinsicsResult:
    """A calibrated camera and what supports it.

    Attributes
    ----------
    covariance
        Of ``camera.fx`` and so on; lens coefficients that the chosen model does not have are absent.
    model
        Coefficients of the chosen lens model, as "k1 k2 p1 p2".
    models
        Every lens model that was tried.
    views
        In the order given.
    rms_px, held_out_rms_px
        Over all corners of the used views, rejected ones left out; and over views not fitted to.
    corner_sd_px
        Standard deviation of a corner along one axis.
    inflation
        Ratio of variances by which views disagree more than independent errors of corners explain; part of the
        covariance.
    rejected_share
        Share of the corners in used views that were left out as gross errors.
    halves_px
        Focal lengths along u from every second view, and from the others.
    lens_sd_px : (9, 9) array
        How surely the camera places a ray, on a grid over the image; see `camera_evidence.lens_sd_px`.
    warnings
        What makes the result weaker than it should be, each with the next step.
    """

    camera: Camera
    covariance: Covariance
    model: str
    models: tuple[ModelEvidence, ...]
    views: tuple[ViewFit, ...]
    rms_px: float
    held_out_rms_px: float
    corner_sd_px: float
    inflation: float
    rejected_share: float
    halves_px: tuple[float, float]
    lens_sd_px: FloatArray
    coverage: Coverage
    warnings: tuple[str, ...]


def calibrate_intrinsics(
    views: Sequence[BoardView], guess: FloatArray | None = None, *, model: str | None = None
) -> IntrinsicsResult:
    """Calibrate a camera.

    Views that are not usable (`BoardView.usable`) are reported and left out, as are views that contradict the others.

    Parameters
    ----------
    views
        Views of one board by one camera, as `views.compare_views` gives them.
    guess : (3, 3) array, optional
        Approximate camera matrix; only a place to start from.
    model
        One of `camera_evidence.MODELS`, then used even where the views leave it open towards the border; chosen by
        evidence where not given.

    Raises
    ------
    CalibrationError
        With the reason, its numbers and the next step. Codes: ``too-few-views``, ``views-alike``, ``wrong-board``,
        ``mirrored-board``, ``blurred-views``, ``badly-exposed-views``, ``mixed-image-sizes``,
        ``views-contradict``, ``focal-length-unobservable``, ``distortion-unobservable``.
    """
    if model is not None and model not in MODELS:
        raise CalibrationError(f"There is no lens model {model!r}; use one of {', '.join(MODELS)}.")
    size = require_one_size(views)
    require_views(views)
    usable = [view for view in views if view.usable]
    sightings = stack_sightings([view.board_mm for view in usable], [view.pixels for view in usable])
    trusted, everywhere = trusted_views(sightings, first_solution(sightings, size, guess))
    require_agreement(trusted)
    names = (model,) if model is not None else tuple(MODELS)
    chosen, fit, models, trusted, kept = _fit(sightings, everywhere, trusted, size, names)
    parameters = MODELS[chosen]
    doubt = uncertainty(kept, fit, parameters)
    seen = coverage(
        [view.pixels for view, used in zip(usable, trusted, strict=True) if used],
        fit.rotations,
        _middles(kept, fit),
        size,
    )
    halves = half_focal_lengths(kept, fit, parameters)
    require_focal_length(fit, doubt, halves, seen)
    lens_sd = lens_sd_px(fit.theta, doubt.matrix, size)
    if model is None:
        require_lens(lens_sd, chosen, size, seen)
    held_out = np.full(len(usable), np.nan)
    held_out[trusted] = np.sqrt(held_out_squares(kept, fit, parameters))
    poses = _all_poses(sightings, everywhere, fit, trusted)
    held_out[~trusted] = view_rms(sightings, poses)[~trusted]
    reports = _view_fits(views, usable, sightings, poses, trusted, kept, held_out)
    corners = float(sightings.take(trusted).weights.sum())
    return IntrinsicsResult(
        camera_of(fit.theta, size),
        Covariance(parameter_names(parameters), doubt.matrix),
        chosen,
        models,
        reports,
        next(m.rms_px for m in models if m.chosen),
        next(m.held_out_rms_px for m in models if m.chosen),
        doubt.corner_sd_px,
        doubt.inflation,
        1.0 - float(kept.weights.sum()) / corners,
        halves,
        lens_sd,
        seen,
        _warnings(fit, doubt, lens_sd, size),
    )


def _fit(
    sightings: Sightings, everywhere: Solution, trusted: BoolArray, size: tuple[int, int], names: Sequence[str]
) -> tuple[str, Solution, tuple[ModelEvidence, ...], BoolArray, Sightings]:
    """Choose and fit the lens model; a view that the others cannot predict is dropped and the choice made again."""
    kept = reject_corners(sightings.take(trusted), everywhere.take(trusted))
    try:
        chosen, fit, models = choose_model(kept, everywhere.take(trusted), size, names)
        squares = held_out_squares(kept, fit, MODELS[chosen])
        strange = np.sqrt(squares) > _STRANGE_HELD_OUT * np.sqrt(np.median(squares))
        if strange.any() and (~strange).sum() >= 5:
            trusted = trusted.copy()
            trusted[np.flatnonzero(trusted)[strange]] = False
            kept = kept.take(~strange)
            chosen, fit, models = choose_model(kept, fit.take(~strange), size, names)
    except RigError as error:
        raise CalibrationError(
            "The lens distortion cannot be determined: every model that fits the views folds back inside the image; "
            "show the board in the corners of the image too, in at least 10 different poses.",
            code="distortion-unobservable",
        ) from error
    return chosen, fit, models, trusted, kept


def _middles(sightings: Sightings, solution: Solution) -> FloatArray:
    weights = sightings.weights[..., None]
    middle = (sightings.board_mm * weights).sum(axis=1) / weights.sum(axis=1)
    return np.asarray(np.einsum("vij,vj->vi", solution.rotations, middle) + solution.translations_mm)


def _all_poses(sightings: Sightings, everywhere: Solution, fit: Solution, trusted: BoolArray) -> Solution:
    rotations, translations = everywhere.rotations.copy(), everywhere.translations_mm.copy()
    rotations[trusted], translations[trusted] = fit.rotations, fit.translations_mm
    left_out = np.flatnonzero(~trusted)
    if len(left_out):
        others = pose_only(sightings, everywhere, fit.theta, left_out)
        rotations[left_out], translations[left_out] = others.rotations, others.translations_mm
    return Solution(fit.theta, rotations, translations)


def _view_fits(
    views: Sequence[BoardView],
    usable: Sequence[BoardView],
    sightings: Sightings,
    poses: Solution,
    trusted: BoolArray,
    kept: Sightings,
    held_out: FloatArray,
) -> tuple[ViewFit, ...]:
    errors = residuals(sightings, poses)
    believed = sightings.weights.copy()
    believed[trusted] = kept.weights
    usual = float(np.median(held_out[trusted]))
    fits: dict[int, ViewFit] = {}
    for i, view in enumerate(usable):
        error = errors[i, : len(view.ids)]
        length = np.linalg.norm(error, axis=1)
        rms = float(np.sqrt((length**2).mean()))
        off = f"its corners are {rms:.2f} px off, {rms / usual:.1f} times the usual {usual:.2f} px"
        reason = "" if trusted[i] else f"{off}; left out of the fit, take it again"
        pose = Transform(poses.rotations[i], poses.translations_mm[i])
        rejected = int(len(view.ids) - believed[i].sum())
        fits[id(view)] = ViewFit(
            view.name, bool(trusted[i]), reason, rms, float(length.max()), float(held_out[i]), rejected, error, pose
        )
    nan = float("nan")
    return tuple(
        fits.get(id(view))
        or ViewFit(view.name, False, f"{view.verdict}: {view.advice}", nan, nan, nan, 0, np.empty((0, 2)), None)
        for view in views
    )


def _warnings(fit: Solution, doubt: Uncertainty, lens_sd: FloatArray, size: tuple[int, int]) -> tuple[str, ...]:
    found = []
    sd = float(np.sqrt(np.diagonal(doubt.matrix)[:2] / fit.theta[:2] ** 2).max())
    if sd > GOOD_FOCAL_SD:
        found.append(
            f"The focal length is known to {100 * sd:.2f} % only (good is {100 * GOOD_FOCAL_SD:g} %); add views tilted "
            "by 30° to 45°."
        )
    worst = float(np.nanmax(lens_sd))
    if worst > GOOD_LENS_SD_SHARE * size[0]:
        found.append(
            f"Towards the border of the image the lens is known to {worst:.1f} px only (good is "
            f"{GOOD_LENS_SD_SHARE * size[0]:.1f} px); show the board there too."
        )
    if doubt.inflation > GOOD_INFLATION:
        found.append(
            f"The views disagree {np.sqrt(doubt.inflation):.1f} times more about the camera than their corners' noise "
            "explains: the board may be bent or its print uneven; mount it on a flat plate."
        )
    return tuple(found)
