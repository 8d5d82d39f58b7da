"""Verdicts on estimated parameters: observability, precision and significance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.calibration.observability import LEAST_RELIABILITY, Directions
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
    """An estimated parameter with its verdict.

    Attributes:
        value: (k,): s; s/s; a rotation vector, rad; or metres. None if unknown.
        sigma: (k,), standard deviations; None if unknown; NaN for components with a part along an
            unobservable direction.
        half_width_95: (k,), half widths of 95 % intervals; NaN likewise.
        reliability: (k,), of the principal directions; empty if unknown.
        status: `significant`, `insignificant`, `weak` (less precise than useful) or
            `unobservable`.
        reason: The reason for the status, as the end of a sentence.
        chance: p-value of the hypothesis that the parameter is zero; None if unknown.
    """

    value: Floats | None
    sigma: Floats | None
    half_width_95: Floats | None
    reliability: Floats
    status: str
    reason: str
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
    found: Directions,
    blocks: int,
    *,
    widest: float,
    unit: str,
    chance: float = CHANCE,
    whole: bool = False,
) -> Parameter:
    """Return the verdict on a parameter from its observable directions.

    Args:
        value: (k,).
        covariance: (k, k), from the run.
        systematic: Standard deviation of systematic errors, which a run does not reveal. It
            reduces the significance, not the stated precision.
        found: The principal directions.
        blocks: Number of blocks of the covariance.
        widest: Largest useful half width of a 95 % interval.
        unit: Unit of `value` and `widest`, for messages: `s`, `rad`, `m`, ...
        chance: Largest p-value that counts as significant.
        whole: Whether the parameter needs all directions to be observable.
    """
    from scipy.special import stdtrit

    quantile = float(stdtrit(blocks - 1, 0.975))
    axes = found.directions[found.seen]
    hidden = ", ".join(map(_axis, found.directions[~found.seen]))
    if whole and hidden:
        return unobservable(f"not observable about {hidden} in this motion", found.reliability)
    if not len(axes):
        best = float(found.reliability.max())
        why = f"not observable in this motion (reliability {best:.2f}, required 0.5)"
        return unobservable(why, found.reliability)
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
    return Parameter(value, sigma, quantile * sigma, found.reliability, status, reason, by_chance)


def chance_of(value: Floats, covariance: Floats, blocks: int) -> float:
    """Return the p-value of a value under the hypothesis that it is zero (Wald's F test).

    Args:
        value: (k,).
        covariance: (k, k).
        blocks: Number of blocks of the covariance.
    """
    from scipy.special import fdtrc

    statistic = float(value @ np.linalg.solve(covariance, value)) / len(value)
    return float(fdtrc(len(value), blocks - 1, statistic))


def _axis(direction: Floats) -> str:
    """Return the name of an axis, or its components."""
    largest = int(np.abs(direction).argmax())
    if abs(direction[largest]) > _NAMED_AXIS:
        return "xyz"[largest]
    return "(" + " ".join(f"{component:.2f}" for component in direction) + ")"
