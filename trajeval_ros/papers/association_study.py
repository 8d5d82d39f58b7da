"""The association study: the ATE by association with degraded against accurate groundtruth.

Groundtruth is degraded: fewer samples, dropouts and noise. This applies the probabilistic paper's
argument for continuous groundtruth to any pair of trajectories.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from trajeval_ros.continuous_time.samples import Noise
from trajeval_ros.exceptions import InputError, SettingsError, TrajevalError
from trajeval_ros.formatting.numbers import NOTHING, counted, four_digits, whole_percent
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.likelihood.likelihood_assessment import assess_likelihood
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.evaluation import Evaluation, evaluate
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.report.console import Table

# Distance of dropouts from the ends of their intervals, so that they do not meet.
_MARGIN_S = 1.0


@dataclass(frozen=True)
class Degradation:
    """The settings of a degradation."""

    rate_hz: float = 2.0  # rate of the kept samples
    dropouts: int = 3  # number of dropouts, one in every one of as many equal intervals
    shortest_s: float = 1.0  # shortest dropout, seconds
    longest_s: float = 2.5  # longest dropout, seconds
    noise: Noise = dataclasses.field(default_factory=Noise)  # noise added to the samples
    seed: int = 0  # seed of the random numbers

    def __post_init__(self) -> None:
        if not 0.0 < self.rate_hz < 1e6:
            raise SettingsError(f"the rate must be greater than 0 Hz, not {self.rate_hz:g}")
        if self.dropouts < 0:
            raise SettingsError(f"the number of dropouts must be at least 0, not {self.dropouts}")
        if not 0.0 < self.shortest_s <= self.longest_s:
            raise SettingsError(
                "the shortest and longest duration of a dropout must be greater than 0 and in "
                f"ascending order, not {self.shortest_s:g},{self.longest_s:g}"
            )

    def of(self, groundtruth: Trajectory) -> Trajectory:
        """Return the degraded groundtruth."""
        random = np.random.default_rng(self.seed)
        groundtruth = groundtruth.in_order()
        seconds = groundtruth.seconds
        step = 1.0 / self.rate_hz
        grid = np.arange(random.uniform(0.0, step), seconds[-1], step)
        rows = np.unique(np.clip(np.searchsorted(seconds, grid), 0, len(seconds) - 1))
        rows = rows[~self._lost(seconds[rows], float(seconds[-1]), random)]
        kept = groundtruth[rows]
        shape = (len(rows), 3)
        positions = kept.positions + random.normal(scale=self.noise.position_m, size=shape)
        rotations = random.normal(scale=self.noise.rotation_rad, size=shape)
        rotated = (
            None if kept.rotations is None else kept.rotations * Rotation.from_rotvec(rotations)
        )
        return dataclasses.replace(
            kept,
            positions=positions,
            quaternions=None if rotated is None else rotated.as_quat(),
            velocities=None,
            gyroscope_biases=None,
            accelerometer_biases=None,
            covariances=None,
            reading=kept.reading.without("matrices"),
        )

    def _lost(self, times: Floats, end: float, random: np.random.Generator) -> Booleans:
        """Return which times (N,), seconds, are in a dropout."""
        lost = np.zeros(len(times), dtype=bool)
        if not self.dropouts:
            return lost
        room = end / self.dropouts - 2.0 * _MARGIN_S - self.longest_s
        if room < 0.0:
            raise InputError(
                f"{counted(self.dropouts, 'dropout')} of up to {self.longest_s:g} s, "
                f"{2 * _MARGIN_S:g} s apart, do not fit into {end:.1f} s of groundtruth; use "
                "fewer or shorter dropouts"
            )
        for begin in np.arange(self.dropouts) * end / self.dropouts:
            start = begin + _MARGIN_S + random.uniform(0.0, room)
            length = random.uniform(self.shortest_s, self.longest_s)
            lost |= (times > start) & (times < start + length)
        return lost


_ANY_GAP_S = 1e6


@dataclass(frozen=True)
class ReportedAte:
    """The ATE by one association."""

    association: str  # the association in words
    ate_m: float | None  # position ATE, metres; None if there is none
    share: float  # share of the estimate's poses in the ATE
    # Interval of the ATE against exact groundtruth; None if not available.
    interval_m: tuple[float, float] | None = None
    reason: str = ""  # why there is no number; empty if there is one


@dataclass(frozen=True)
class AssociationComparison:
    """The comparison for one estimate."""

    name: str  # name of the estimate
    true_ate_m: float  # ATE against all of the accurate groundtruth, interpolated
    reported: tuple[ReportedAte, ...]  # the ATE against the poor groundtruth by association


def compare_associations(
    groundtruth: Trajectory, poor: Trajectory, estimate: Trajectory, protocol: Protocol
) -> AssociationComparison:
    """Compare associations of one estimate with accurate and with degraded groundtruth.

    The protocol has gauge and alignment. Its association is `continuous`, with the model and the
    noise of the degraded groundtruth.
    """

    def ruled(rule: AssociationRule) -> Protocol:
        return dataclasses.replace(protocol, association=rule, lengths=())

    modelled = protocol.association
    base = dataclasses.replace(modelled, method="linear")
    true = _position_ate(evaluate(groundtruth, estimate, ruled(base)))
    nearest = dataclasses.replace(base, method="nearest")
    plain = {
        f"nearest, within {base.max_time_difference_s:g} s": nearest,
        "nearest, every pose": dataclasses.replace(modelled, model="nearest"),
        f"linear, gaps up to {base.max_gap_s:g} s": base,
        "linear, every pose": base.bridging(_ANY_GAP_S),
    }
    reported = [_plain(name, poor, estimate, ruled(rule)) for name, rule in plain.items()]
    reported += _continuous(poor, estimate, ruled(modelled))
    return AssociationComparison(estimate.name, true, tuple(reported))


def _plain(name: str, poor: Trajectory, estimate: Trajectory, protocol: Protocol) -> ReportedAte:
    """Return the ATE by an association without uncertainty."""
    try:
        evaluation = evaluate(poor, estimate, protocol)
    except TrajevalError as error:
        return ReportedAte(name, None, 0.0, reason=str(error))
    return ReportedAte(name, _position_ate(evaluation), _covered(evaluation))


def _continuous(poor: Trajectory, estimate: Trajectory, protocol: Protocol) -> list[ReportedAte]:
    """Return the ATEs by the continuous association: plain, weighted, of supported poses."""
    model = protocol.association.model
    names = [f"{model}, {which}" for which in ("plain", "weighted", "supported")]
    try:
        evaluation = evaluate(poor, estimate, protocol)
        ate = assess_likelihood(evaluation).ate
    except TrajevalError as error:
        return [ReportedAte(name, None, 0.0, reason=str(error)) for name in names]
    covered = _covered(evaluation)
    nowhere = "" if ate.supported_m is not None else "the groundtruth is too uncertain everywhere"
    return [
        ReportedAte(names[0], _position_ate(evaluation), covered),
        ReportedAte(names[1], ate.weighted_m, covered),
        ReportedAte(
            names[2], ate.supported_m, covered * ate.supported_share, ate.interval_m, nowhere
        ),
    ]


def _covered(evaluation: Evaluation) -> float:
    """Return the share of estimated poses in a pair."""
    covered = evaluation.association.estimate_coverage
    assert covered is not None  # pairs are at the estimate's stamps
    return covered


def _position_ate(evaluation: Evaluation) -> float:
    """Return the position ATE, metres."""
    statistics = evaluation.ate["position_m"]
    assert statistics is not None
    return statistics.rmse


def association_table(comparison: AssociationComparison) -> Table:
    """Return a row for the accurate groundtruth and one per association."""
    true = comparison.true_ate_m
    table = Table(
        f"{comparison.name}: position ATE by association",
        ["association"],
        ["ATE [m]", "by the accurate groundtruth", "of poses", "approx. 95 % [m]"],
    )
    rows = [["all groundtruth (accurate)", four_digits(true), "1", "", ""]]
    for reported in comparison.reported:
        ratio = interval = NOTHING
        if reported.ate_m is not None and true > 0.0:
            ratio = four_digits(reported.ate_m / true)
        if reported.interval_m is not None:
            interval = " to ".join(map(four_digits, reported.interval_m))
        ate = NOTHING if reported.ate_m is None else four_digits(reported.ate_m)
        rows.append([reported.association, ate, ratio, whole_percent(reported.share), interval])
    for row in rows:
        table.add(row)
    return table
