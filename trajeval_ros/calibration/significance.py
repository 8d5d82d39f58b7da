"""What may be said of an estimated parameter: observable, precise, and not there by chance."""

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
# Of a normal deviate, beyond three standard deviations.
CHANCE = 0.0027
# Skews of real recordings are surer of themselves than they should be.
CHANCE_OF_SKEW = 0.0001
_NAMED_AXIS = 0.97


@dataclass(frozen=True, eq=False)
class Parameter:
    """An estimated parameter and what may be said of it.

    Attributes:
        value: (k,): seconds; seconds per second; a rotation vector, rad; or metres. None if
            nothing is known.
        sigma: (k,), standard deviations; None if nothing is known, NaN of a component of which
            a direction that can't be seen makes a part.
        half_width_95: (k,), of the 95 % interval; NaN likewise.
        reliability: (k,), of the principal directions; empty if nothing is known.
        status: `significant`, `insignificant`, `weak` (less precise than is of use) or
            `unobservable`.
        reason: Why, as the end of a sentence.
        chance: How often as much would be seen if there were nothing; None if nothing is known.
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
        """Whether it is observable, precise, and there."""
        return self.status == SIGNIFICANT

    @property
    def seen(self) -> int:
        """Number of principal directions that can be seen: the degrees of freedom of the value."""
        return int(np.count_nonzero(self.reliability >= LEAST_RELIABILITY))


def unobservable(reason: str, reliability: Floats | None = None) -> Parameter:
    """Return the verdict on what can't be seen."""
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
    """Judge a parameter by its observable directions.

    Args:
        value: (k,).
        covariance: (k, k), by what the run itself shows.
        systematic: Standard deviation of what no run shows of itself. It counts against
            significance, not against precision.
        found: Its principal directions.
        blocks: Number of blocks that the covariance is from.
        widest: Half width of a 95 % interval beyond which a value is of no use.
        unit: Of the value and of `widest`, for the sentence: `s`, `rad`, `m`, ...
        chance: The largest probability of chance that is taken for significance.
        whole: Whether it means nothing unless all directions are observable.
    """
    from scipy.special import stdtrit

    quantile = float(stdtrit(blocks - 1, 0.975))
    axes = found.directions[found.seen]
    hidden = ", ".join(_axis(each) for each in found.directions[~found.seen])
    if whole and hidden:
        return unobservable(f"not observable about {hidden} in this motion", found.reliability)
    if not len(axes):
        best = float(found.reliability.max())
        why = f"not observable in this motion (reliability {best:.2f}, required 0.5)"
        return unobservable(why, found.reliability)
    # Directions that can't be seen stay zero and play no part in the test.
    shown = axes @ covariance @ axes.T
    within = shown + systematic**2 * np.eye(len(axes))
    by_chance = chance_of(axes @ value, within, blocks)
    sigma = np.sqrt(np.maximum(np.diag(axes.T @ within @ axes), 0.0))
    # What a hidden direction adds to a component could be anything.
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
    """Return how often a value as far from zero would be seen if there were nothing (Wald's F).

    Args:
        value: (k,).
        covariance: (k, k).
        blocks: Number of blocks that the covariance is from.
    """
    from scipy.special import fdtrc

    statistic = float(value @ np.linalg.solve(covariance, value)) / len(value)
    return float(fdtrc(len(value), blocks - 1, statistic))


def _axis(direction: Floats) -> str:
    """Return an axis by name, or its components."""
    largest = int(np.abs(direction).argmax())
    if abs(direction[largest]) > _NAMED_AXIS:
        return "xyz"[largest]
    return "(" + " ".join(f"{each:.2f}" for each in direction) + ")"
