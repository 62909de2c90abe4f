"""The joint adjustment: all parameters of the scanner against all observations at once.

Levenberg-Marquardt on the normal equations with analytic derivatives. Observations are grouped before they count:
stripes on the bed by the pixels at which they were seen, points on objects by patches of surface. What lens, estimator
and surface do wrong is common to a group, so a group is one observation with a standard deviation of its own kind that
the residuals themselves tell (variance components: F. R. Helmert, 1907; K.-R. Koch, "Parameter Estimation and
Hypothesis Testing in Linear Models"). The loss is soft-L1 first and Geman-McClure's in the end.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from twinline.arrays import BoolArray, FloatArray
from twinline.calibration.joint_model import Scanner
from twinline.calibration.joint_patches import associate
from twinline.calibration.joint_rows import evaluate
from twinline.calibration.joint_types import KINDS, Association, Observations, Prior, Rows

_FIRST_SYSTEMATIC_MM = 0.03
_LEAST_SYSTEMATIC_MM = 0.015
_LEAST_ON_BOARD_MM = 0.05
"""All stripes of one view share the error of its board's pose."""
_OUTER = 14
_INNER = 4
_SETTLED = 0.02
_LOSS_SCALE = 3.0

Loss = Literal["soft-l1", "geman-mcclure"]


@dataclass(frozen=True, eq=False)
class JointResult:
    """The adjusted scanner.

    Attributes
    ----------
    covariance : (p, p) array
        Of `Scanner.vector`.
    rows
        Observations at the solution, without derivatives.
    weights : (r,) array
        Robust weight of each, 0 to 1.
    systematic_mm : (kinds,) array
        Standard deviation of a group beyond its noise.
    information : (p, p) array
        What the observations alone say, without priors.
    cell_residuals : (kinds,) tuple of arrays
        Residuals of single cells, not averaged over patches.
    steps
        Number of linearisations.
    """

    scanner: Scanner
    covariance: FloatArray
    rows: Rows
    weights: FloatArray
    systematic_mm: FloatArray
    information: FloatArray
    cell_residuals: tuple[FloatArray, ...]
    steps: int


def adjust(
    scanner: Scanner,
    observations: Observations,
    priors: tuple[Prior, ...],
    *,
    cell_mm: float,
    systematic_mm: FloatArray | None = None,
    hold_out: bool = False,
    free: BoolArray | None = None,
) -> JointResult:
    """Adjust a scanner.

    Parameters
    ----------
    cell_mm
        Size of the cells in which sensors are compared: a little more than the distance of neighbouring points.
    hold_out
        Leave out every fifth group.
    free : (p,) bool array, optional
        Parameters to adjust; the others are taken as they are, their uncertainty by the priors carried over.
    """
    theta = scanner.vector()
    free = np.ones(len(theta), bool) if free is None else free
    systematic = first_scatter() if systematic_mm is None else systematic_mm
    steps = 0
    loss: Loss = "soft-l1"
    settled = 0
    link = associate(scanner, observations, cell_mm)
    for outer in range(_OUTER):
        scanner, moved, taken = _descend(scanner, observations, link, priors, systematic, loss, hold_out, free)
        steps += taken
        link = associate(scanner, observations, cell_mm)
        rows = evaluate(scanner, observations, link, derivatives=False)
        if loss != "soft-l1":
            # Before that, what is not yet adjusted would pass for scatter and be given up as such.
            systematic = _components(rows, systematic, hold_out)
        if loss == "soft-l1" and (moved < 0.5 or outer >= _OUTER // 2):
            loss = "geman-mcclure"
            continue
        settled = settled + 1 if moved < _SETTLED and loss != "soft-l1" else 0
        if settled >= 2:
            break
    rows = evaluate(scanner, observations, link)
    weights = _weights(rows, systematic, loss)
    used = weights * ~rows.held_out if hold_out else weights
    normal = _normal(rows, used, systematic)[0]
    covariance = _covariance(normal, scanner.vector(), priors, free)
    return JointResult(
        scanner, covariance, replace(rows, jacobian=None), weights, systematic, normal, link.cells, steps
    )


def first_scatter() -> FloatArray:
    """Standard deviation of a group beyond its noise, (kinds,) in mm, before its residuals tell it."""
    return np.array([_LEAST_ON_BOARD_MM if "on a board" in kind else _FIRST_SYSTEMATIC_MM for kind in KINDS])


def cost_of(rows: Rows, priors: tuple[Prior, ...], theta: FloatArray, systematic_mm: FloatArray) -> float:
    """What the first rounds of an adjustment minimise: soft-L1 loss of all observations, and the priors."""
    return _cost(rows, systematic_mm, "soft-l1", np.ones(len(rows.kind))) + _prior_cost(priors, theta)


def _sd(rows: Rows, systematic: FloatArray) -> FloatArray:
    return np.sqrt(rows.noise**2 + systematic[rows.kind] ** 2)


def _weights(rows: Rows, systematic: FloatArray, loss: Loss) -> FloatArray:
    standard = (rows.residual / (_LOSS_SCALE * _sd(rows, systematic))) ** 2
    if loss == "soft-l1":
        return np.asarray(1.0 / np.sqrt(1.0 + standard))
    return np.asarray(1.0 / (1.0 + standard) ** 2)


def _cost(rows: Rows, systematic: FloatArray, loss: Loss, used: FloatArray) -> float:
    standard = (rows.residual / (_LOSS_SCALE * _sd(rows, systematic))) ** 2
    value = 2.0 * (np.sqrt(1.0 + standard) - 1.0) if loss == "soft-l1" else standard / (1.0 + standard)
    return float(_LOSS_SCALE**2 * (rows.share * used * value).sum())


def _normal(rows: Rows, weights: FloatArray, systematic: FloatArray) -> tuple[FloatArray, FloatArray]:
    assert rows.jacobian is not None
    weight = weights * rows.share / _sd(rows, systematic) ** 2
    weighted = rows.jacobian * weight[:, None]
    return rows.jacobian.T @ weighted, weighted.T @ rows.residual


def _descend(
    scanner: Scanner, observations: Observations, link: Association, priors: tuple[Prior, ...], systematic: FloatArray,
    loss: Loss, hold_out: bool, free: BoolArray,
) -> tuple[Scanner, float, int]:  # fmt: skip
    """A few Levenberg-Marquardt steps; returns how far they went in standard deviations of the parameters."""
    damping, moved, taken = 1e-6, 0.0, 0
    for _ in range(_INNER):
        rows = evaluate(scanner, observations, link)
        used = (~rows.held_out).astype(float) if hold_out else np.ones(len(rows.kind))
        theta = scanner.vector()
        before = _cost(rows, systematic, loss, used) + _prior_cost(priors, theta)
        normal, gradient = _normal(rows, used * _weights(rows, systematic, loss), systematic)
        for prior in priors:
            error, design = prior.rows(theta)
            normal += design.T @ design
            gradient += design.T @ error
        accepted = False
        for _ in range(8):
            step = _step(normal, gradient, damping, free)
            trial = scanner.with_vector(theta + step)
            trial_rows = evaluate(trial, observations, link, derivatives=False)
            after = _cost(trial_rows, systematic, loss, used) + _prior_cost(priors, trial.vector())
            if np.isfinite(after) and after <= before * (1 + 1e-12):
                accepted = True
                break
            damping = max(damping, 1e-9) * 10
        if not accepted:
            break
        damping = max(damping / 10, 1e-12)
        size = float(np.sqrt(np.abs(step @ (normal @ step)) / max(int(free.sum()), 1)))
        moved += size
        taken += 1
        scanner = trial
        if size < 1e-3:
            break
    return scanner, moved, taken


def _prior_cost(priors: tuple[Prior, ...], theta: FloatArray) -> float:
    return float(sum((prior.rows(theta)[0] ** 2).sum() for prior in priors))


def _step(normal: FloatArray, gradient: FloatArray, damping: float, free: BoolArray) -> FloatArray:
    step = np.zeros(len(gradient))
    part, slope = normal[np.ix_(free, free)], gradient[free]
    scale = np.sqrt(np.maximum(np.diagonal(part), 1e-300))
    system = part / np.outer(scale, scale) + damping * np.eye(len(scale))
    step[free] = -np.linalg.solve(system, slope / scale) / scale
    return step


def _components(rows: Rows, systematic: FloatArray, hold_out: bool) -> FloatArray:
    """Standard deviation of each kind beyond its noise, from the middle of its residuals."""
    out = systematic.copy()
    for kind in np.unique(rows.kind):
        here = (rows.kind == kind) & ~(rows.held_out & hold_out)
        if here.sum() < 8:
            continue
        total = 1.4826 * float(np.median(np.abs(rows.residual[here])))
        noise = float(np.median(rows.noise[here]))
        least = _LEAST_ON_BOARD_MM if "on a board" in KINDS[kind] else _LEAST_SYSTEMATIC_MM
        out[kind] = np.clip(np.sqrt(max(total**2 - noise**2, 0.0)), least, 10.0)
    return out


def _covariance(normal: FloatArray, theta: FloatArray, priors: tuple[Prior, ...], free: BoolArray) -> FloatArray:
    """Inverse information; parameters that were held keep what the priors say of them, and pass it on."""
    prior_normal = np.zeros_like(normal)
    for prior in priors:
        design = prior.rows(theta)[1]
        prior_normal += design.T @ design
    if free.all():
        return _inverse(normal + prior_normal)
    whole = normal + prior_normal
    held = ~free
    own = _inverse(prior_normal)[np.ix_(held, held)]
    part = _inverse(whole[np.ix_(free, free)])
    carry = -part @ whole[np.ix_(free, held)]
    out = np.zeros_like(whole)
    out[np.ix_(free, free)] = part + carry @ own @ carry.T
    out[np.ix_(free, held)] = carry @ own
    out[np.ix_(held, free)] = (carry @ own).T
    out[np.ix_(held, held)] = own
    return out


def _inverse(information: FloatArray) -> FloatArray:
    # A parameter that nothing is known of keeps its zero row out of the way.
    scale = np.sqrt(np.where(np.diagonal(information) > 0, np.diagonal(information), 1.0))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    inverse = (vectors / np.maximum(values, 1e-14)) @ vectors.T / np.outer(scale, scale)
    return np.asarray((inverse + inverse.T) / 2)
