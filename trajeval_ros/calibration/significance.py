"""Verdicts on estimated parameters: observability, precision and significance.

A body rotation is also tested against rotations and positions separately. If the body rotates
about one axis only, its rotations do not determine a rotation about that axis. Positions do, but
attitude drift has the same effect on them. Mirrored axes have the opposite effect: a rotation
reduces the rotation residuals and increases the position residuals. Therefore the gain of the
rotation is computed for both groups of rows, with Huber's cost rho of the residuals in the best
fits without and with the rotation:

    gain = 1 - sum rho(with) / sum rho(without)

On simulated flights with correct bodies, gains of rotation rows are below 0.01 whenever the fit
has a rotation. With a true rotation of at least 3 deg they are above 0.12, unless it is about the
only axis. Mirrored axes have position gains below -3, true rotations at least -0.2.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from trajeval_ros.calibration.increments import BODY_ROTATION, POSITION, ROTATION, Increments
from trajeval_ros.calibration.observability import (
    LEAST_RELIABILITY,
    CalibrationFit,
    Directions,
    basis_of,
    observability,
)
from trajeval_ros.calibration.robust_fit import fit, huber_cost
from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Floats

SIGNIFICANT, INSIGNIFICANT, WEAK, UNOBSERVABLE = (
    "significant",
    "insignificant",
    "weak",
    "unobservable",
)
# Two-sided p-value of three standard deviations.
CHANCE = 0.0027
# Standard deviations of skews are too small on real recordings.
CHANCE_OF_SKEW = 0.0001
_NAMED_AXIS = 0.97


@dataclass(frozen=True, eq=False)
class Parameter:
    """An estimated parameter with its verdict."""

    value: Floats | None  # (k,): s; s/s; a rotation vector, rad; or metres; None if unknown
    # (k,), standard deviations; None if unknown; NaN for components with a part along an
    # unobservable direction.
    sigma: Floats | None
    half_width_95: Floats | None  # (k,), half widths of 95 % intervals; NaN likewise
    reliability: Floats  # (k,), of the principal directions; empty if unknown
    # `significant`, `insignificant`, `weak` (less precise than useful) or `unobservable`.
    status: str
    reason: str  # the reason for the status, as the end of a sentence
    # p-value of the hypothesis that the parameter is zero; None if unknown.
    chance: float | None = None

    @property
    def is_significant(self) -> bool:
        """Whether it is observable, precise and significantly different from zero."""
        return self.status == SIGNIFICANT

    @property
    def seen(self) -> int:
        """Number of observable directions: the degrees of freedom of the value."""
        return int(np.count_nonzero(self.reliability >= LEAST_RELIABILITY))


def unobservable(reason: str, reliability: Floats | None = None) -> Parameter:
    """Return the verdict on an unobservable parameter."""
    none = np.empty(0)
    return Parameter(
        None, None, None, none if reliability is None else reliability, UNOBSERVABLE, reason
    )


def judge(
    value: Floats,
    covariance: Floats,
    systematic: float,
    directions: Directions,
    blocks: int,
    *,
    widest: float,
    unit: str,
    chance: float = CHANCE,
    whole: bool = False,
) -> Parameter:
    """Return the verdict on a parameter (k,) from its observable directions.

    The covariance (k, k) is from the run, with `blocks` blocks. `systematic` is the standard
    deviation of errors that a run does not reveal; it reduces the significance, not the stated
    precision. `widest` is the largest useful half width of a 95 % interval, in `unit`. `chance` is
    the largest p-value that counts as significant. `whole`: all directions must be observable.
    """
    from scipy.special import stdtrit

    quantile = float(stdtrit(blocks - 1, 0.975))
    axes = directions.directions[directions.seen]
    hidden = ", ".join(map(axis_name, directions.directions[~directions.seen]))
    if whole and hidden:
        return unobservable(
            f"not observable about {hidden} in this motion", directions.reliability
        )
    if not len(axes):
        best = float(directions.reliability.max())
        why = f"not observable in this motion (reliability {best:.2f}, required 0.5)"
        return unobservable(why, directions.reliability)
    # Unobservable directions are zero and not tested.
    shown = axes @ covariance @ axes.T
    within = shown + systematic**2 * np.eye(len(axes))
    by_chance = chance_of(axes @ value, within, blocks)
    sigma = np.sqrt(np.maximum(np.diag(axes.T @ within @ axes), 0.0))
    # Components along unobservable directions have an unknown error.
    sigma[np.linalg.norm(axes, axis=0) <= _NAMED_AXIS] = np.nan
    half_width = quantile * float(np.sqrt(np.linalg.eigvalsh(shown)[-1]))
    if half_width > widest:
        status = WEAK
        reason = f"95 % half width {half_width:.2g} {unit}, limit {widest:g} {unit}"
    else:
        status = SIGNIFICANT if by_chance < chance else INSIGNIFICANT
        reason = "p < 1e-6" if by_chance < 1e-6 else f"p = {by_chance:.2g}"
    if hidden:
        reason += f"; not observable along {hidden}, assumed 0 there"
    return Parameter(
        value, sigma, quantile * sigma, directions.reliability, status, reason, by_chance
    )


def chance_of(value: Floats, covariance: Floats, blocks: int) -> float:
    """Return the p-value of a value (k,) under the hypothesis that it is zero (Wald's F test)."""
    from scipy.special import fdtrc

    statistic = float(value @ np.linalg.solve(covariance, value)) / len(value)
    return float(fdtrc(len(value), blocks - 1, statistic))


def axis_name(direction: Floats) -> str:
    """Return the name of an axis, or its components."""
    largest = int(np.abs(direction).argmax())
    if abs(direction[largest]) > _NAMED_AXIS:
        return "xyz"[largest]
    return "(" + " ".join(f"{component:.2f}" for component in direction) + ")"


LEAST_OF_ROTATIONS = 0.02
LEAST_OF_POSITIONS = -0.5
POSITIONS_ALONE = (
    "only positions support it and rotations do not, as with attitude drift; if the transform "
    "is known, give --hand-eye FILE"
)
POSITIONS_WORSE = (
    "it reduces the rotation error and increases the position error; check for mirrored axes"
)


def supported_by_both(
    rotation: Parameter, increments: Increments, solution: CalibrationFit, systematic_rad: float
) -> Parameter:
    """Return the verdict on a body rotation: `insignificant` if one group of rows contradicts it.

    `rotation` is the verdict from all rows together; there are orientations on both sides.
    """
    if not rotation.is_significant:
        return rotation
    rest = {name: axes for name, axes in solution.free.items() if name != "rotation"}
    none = dataclasses.replace(solution.fit.unknowns, rotation=np.eye(3))
    without = fit(increments, none, basis_of(rest))
    if without is None:
        return rotation
    before, after = without.linearised.residual, solution.fit.linearised.residual
    by_rotation, by_position = (
        1.0 - huber_cost(after, after, kind) / huber_cost(before, after, kind)
        for kind in (ROTATION, POSITION)
    )
    if by_position <= LEAST_OF_POSITIONS:
        return dataclasses.replace(rotation, status=INSIGNIFICANT, reason=POSITIONS_WORSE)
    if by_rotation > LEAST_OF_ROTATIONS:
        return rotation
    if _by_rotations_alone(increments, solution, systematic_rad) < CHANCE:
        return rotation
    return dataclasses.replace(rotation, status=INSIGNIFICANT, reason=POSITIONS_ALONE)


def _by_rotations_alone(
    increments: Increments, solution: CalibrationFit, systematic_rad: float
) -> float:
    """Return the p-value of the rotation from rotation rows alone.

    Only observable directions are tested; noise along the others looks like a rotation.
    """
    basis = basis_of({"rotation": np.eye(3)})
    alone = fit(increments, solution.fit.unknowns, basis, (ROTATION,))
    if alone is None:
        return 1.0
    value = so3.log(alone.unknowns.rotation[None])[0]
    covariance = alone.covariance[BODY_ROTATION, BODY_ROTATION] + systematic_rad**2 * np.eye(3)
    shown = observability(increments, alone)["rotation"]
    axes = shown.directions[shown.seen]
    if not len(axes):
        return 1.0
    return chance_of(axes @ value, axes @ covariance @ axes.T, alone.blocks)
