"""Tests of the motions of both sides: clocks, conventions, scale, worlds, bodies, in this order.

A mistake is a model of the short motions. It is stated if its odds against no mistake are large,
so no test needs the result of another one, but for the clock, which selects the motions.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from trajeval_ros.diagnosis import naming
from trajeval_ros.diagnosis.clocks import Clock
from trajeval_ros.diagnosis.column_tests import is_at_rest, rhythm, velocities
from trajeval_ros.diagnosis.dropout_tests import groundtruth_defects, without_defects
from trajeval_ros.diagnosis.findings import Detection, TestResult
from trajeval_ros.diagnosis.hypotheses import (
    AS_READ,
    EULER_HYPOTHESES,
    HYPOTHESES,
    MISTAKE,
    ODDS,
    ROTATIONS,
    TIE,
)
from trajeval_ros.diagnosis.input_pair import (
    FEWEST,
    SHORTEST_S,
    InputPair,
    TimedPoses,
)
from trajeval_ros.diagnosis.motion_models import Model, ModelScores
from trajeval_ros.diagnosis.motion_parameters import (
    OFFSET,
    RATE,
    SCALE,
    SPREADS,
    Parameters,
    Spread,
    fit_parameters,
    log_odds,
)
from trajeval_ros.diagnosis.short_motions import ShortMotions
from trajeval_ros.diagnosis.world_axes import vertical_axes
from trajeval_ros.geometry.arrays import Indices, lengths
from trajeval_ros.metrics.statistics import median, quantile

_LEAST_GAP_S, _MOST_GAP_S = 0.3, 1.1  # of the groundtruth to interpolate across
DISAGREE = "the motions do not agree"
AGREE_NATS = 3.0  # per independent motion: unrelated motions reach less
_UNRELATED_PEAK, _NO_PEAK = 0.8, 0.45  # correlation of another run, also if motions agree
_LONG_S = 20.0  # common time from which on another run is stated
_RESTS_M = 0.1  # median displacement of a groundtruth that mostly rests: the others are few
_AT_REST_RAD = 0.01  # median rotation of a body that does not rotate, which is noise
# Rotations about a second axis over those about the most frequent one: with fewer, mistakes in
# Euler angles look like other conventions, and more are slower to test.
_ONE_AXIS = 0.2
_MISFIT = 2.0  # of directions relative to lengths of rotation vectors; conventions keep lengths
_NOISE = 0.1  # of these lengths, relative to them: if they differ by more, no model fits
_REFINED_S = 0.03  # largest clock error from which on motions are sampled again
_WANDER_S = 0.005  # of healthy clocks along a run: short runs show no rate
# Of the time between two frames, healthy offset of the timestamps; and quantile of the estimate's
# steps that is nearest to this time: a smaller one is jitter of the timestamps.
_STEPS_APART, _OF_FRAMES = 0.05, 0.1


def tests_of_motion(inputs: InputPair, *, is_copied: bool) -> list[TestResult]:
    """Apply all tests of motions. In an order of time, rows that are copied look like a rate."""
    groundtruth, estimate = inputs.in_order
    if min(groundtruth.span_s, estimate.span_s) < SHORTEST_S or len(estimate) < FEWEST:
        return [TestResult("motions", why_not=f"a side is shorter than {SHORTEST_S:g} s")]
    examined: list[TestResult] = []
    longest_step_s = inputs.protocol.association.longest_step_s
    gap_s = max(longest_step_s, 4.0 * groundtruth.usual_step_s, _LEAST_GAP_S)
    clock, has_defects, is_held = Clock(), False, False
    if inputs.by_time:
        gap_s = min(gap_s, _MOST_GAP_S)
        is_odometry = inputs.estimate.reading.format.endswith("/Odometry")
        defects = groundtruth_defects(groundtruth, estimate, longest_step_s)
        examined = [defects, rhythm(groundtruth, estimate, is_odometry=is_odometry)]
        has_defects = bool(defects.seen)
        is_held = any(seen.cause == "groundtruth_held" for seen in defects.seen)
        if has_defects:
            groundtruth = without_defects(groundtruth)
        clock = Clock.between(groundtruth, estimate, searches_rate=not (has_defects or is_copied))
        estimate = estimate.shifted(0.0, clock.factor - 1.0)
    motions = ShortMotions.between(groundtruth, estimate, gap_s, clock.offset_s)
    if len(motions) >= FEWEST:
        examined.append(velocities(groundtruth, estimate.shifted(clock.offset_s)))
    sides = groundtruth, estimate
    comparison = _Comparison(inputs, *sides, motions, clock, gap_s, has_defects, is_held)
    return [*examined, *comparison.results()]


@dataclass(frozen=True, eq=False)
class _Comparison:
    """The comparison of motions at the coarse clock."""

    inputs: InputPair
    groundtruth: TimedPoses
    estimate: TimedPoses  # with the factor of the clock
    motions: ShortMotions
    clock: Clock
    gap_s: float
    has_defects: bool  # of the groundtruth, which shift the motions by a part of a second
    is_held: bool  # the groundtruth's poses are repeated, so that no rotation fits exactly

    def results(self) -> list[TestResult]:
        """Return the results of all tests."""
        match = self.clock.match
        if len(self.motions) < FEWEST:
            is_apart = match is not None and self._rates_are_unrelated(match.peak)
            few = TestResult("models", why_not="too few short motions have groundtruth")
            return [self._clock_result(), self._unrelated({}) if is_apart else few]
        scores = ModelScores(self.motions)
        models = scores.likeliest(HYPOTHESES)
        as_read = _best(model for model in models if model.cause == AS_READ)
        best, unrelated = _best(models), scores.unrelated
        oriented = self.motions.has_orientations
        read = scores.read(HYPOTHESES[0])
        rotated = (lengths(vectors) for vectors in (read.truth.motions[0], read.rotations))
        rotates = oriented and max(map(median, rotated)) > _AT_REST_RAD
        if rotates and not self.is_held and self._may_be_euler(scores, best, as_read):
            models += scores.likeliest(EULER_HYPOTHESES)
            best = _best(models)
        related = max(best.log_likelihood, unrelated.positions) - unrelated.motions
        statistics = {
            "as_read": as_read.score - unrelated.motions,
            "best": best.score - unrelated.motions,
            "positions_alone": unrelated.positions - unrelated.motions,
            "nats_per_motion": related / scores.evidence,
        }
        # Few independent directions can agree at random, and rates of motion hardly can.
        is_apart = match is not None and self._rates_are_unrelated(match.highest)
        if related < (2.0 if is_apart else 1.0) * AGREE_NATS * scores.evidence:
            return [self._clock_result(), self._unrelated(statistics, is_apart=is_apart)]
        if rotates and unrelated.positions + MISTAKE > best.score + ODDS:
            seen = (naming.rotations(scores),)
            scale = self._scale_result(unrelated.scale, SPREADS["scale"].healthy ** 2)
            return [self._clock_result(), TestResult("models", statistics, seen), scale]
        conventions: tuple[Detection, ...] = ()
        if best.cause != AS_READ and best.score > as_read.score + ODDS:
            conventions = (naming.convention(scores, best, models, as_read),)
        else:
            best = as_read
        agrees = best.log_likelihood - unrelated.motions > AGREE_NATS * scores.evidence
        parameters, scores = self._fitted(scores, best)
        results = [
            self._clock_result(parameters, states_rate=oriented and not conventions),
            TestResult("models", statistics, conventions),
            self._scale_result(parameters.scale, parameters.covariance[SCALE, SCALE].item()),
        ]
        if not (oriented and agrees):
            why_not = "rotations do not agree" if oriented else "no orientations"
            return [*results, TestResult("bodies", why_not=why_not)]
        if not self.inputs.gauge.yaw_only:
            why_not = "the alignment includes roll and pitch, or no rotation"
            results.append(TestResult("vertical axes", why_not=why_not))
        elif not best.changes_axes:
            results.append(vertical_axes(scores, best, parameters.body, self.inputs))
        if best.hypothesis.cause == ROTATIONS:
            return [*results, TestResult("bodies", why_not="rotations do not agree")]
        return [*results, naming.body_and_lever(scores, parameters, best)]

    def _rates_are_unrelated(self, correlation: float, least: float = _NO_PEAK) -> bool:
        """Return whether a correlation of rates of motion is that of another run."""
        match = self.clock.match
        return match is not None and match.overlap_s > _LONG_S and correlation < least

    def _may_be_euler(self, scores: ModelScores, best: Model, as_read: Model) -> bool:
        """Return whether no model explains the directions of the rotations in a part of the run.

        A convention holds for the whole run, but a body flips and a clock drifts during it.
        """
        rows = np.arange(len(self.motions))
        if _fits(scores, best, rows):
            return False
        thirds = np.array_split(rows, 3)
        return not any(
            _fits(scores, model, third) for model in (best, as_read) for third in thirds
        )

    def _unrelated(self, statistics: dict[str, float], *, is_apart: bool = True) -> TestResult:
        match, why_not = self.clock.match, DISAGREE
        if is_at_rest(self.inputs):
            why_not = "both at rest; motions can't be compared"
        elif match is not None:
            # The rates of one run correlate most without an offset, even if the estimate is bad.
            is_far = self.clock.is_far and self._rates_are_unrelated(match.peak, _UNRELATED_PEAK)
            if is_apart or is_far:
                seen = Detection.of("other_run", peak=match.peak)
                return TestResult("models", statistics, (seen,))
            if median(lengths(self.motions.groundtruth.displacements)) < _RESTS_M:
                why_not = "mostly at rest; few motions can be compared"
        return TestResult("models", statistics, why_not=why_not)

    def _fitted(self, scores: ModelScores, model: Model) -> tuple[Parameters, ModelScores]:
        """Fit the parameters, a second time if the motions were sampled at wrong times."""
        parameters = fit_parameters(scores, model)
        offset_s, rate = parameters.offset_s, parameters.rate
        if abs(offset_s) + abs(rate) * self.estimate.span_s / 2.0 < _REFINED_S:
            return parameters, scores
        sides, offset_s = (self.groundtruth, self.estimate), self.clock.offset_s + offset_s
        again = ShortMotions.between(*sides, self.gap_s, offset_s, rate)
        if len(again) < FEWEST:
            return parameters, scores
        refined = fit_parameters(scores := ModelScores(again), model)
        refined.values[OFFSET.start :] += parameters.values[OFFSET.start :]
        return refined, scores

    def _clock_result(
        self, parameters: Parameters | None = None, *, states_rate: bool = False
    ) -> TestResult:
        """Return the offset or the rate of the clock, by the fit if there is one."""
        clock, match, span_s = self.clock, self.clock.match, self.estimate.span_s
        if match is None:
            return TestResult("clocks", why_not="no timestamps, or too little common time")
        statistics = {
            "offset_s": clock.offset_s,
            "peak": match.peak,
            "as_stamped": match.as_stamped,
            "log_odds": match.log_odds - match.log_odds_at_zero,
        }
        offset_s, rate, is_stated = clock.offset_s, clock.factor - 1.0, clock.is_stated
        if parameters is not None:
            offset_s += parameters.offset_s
            fitted = clock.factor * (1.0 + parameters.rate) - 1.0
            rows = {  # values, and healthy spreads of this run
                "offset": (OFFSET, offset_s, _STEPS_APART * self._frame_s),
                "rate": (RATE, parameters.rate, _WANDER_S / max(span_s, 1.0)),
            }
            statistics |= {"fitted_offset_s": offset_s, "fitted_ppm": 1e6 * fitted}
            odds = {}
            for name, (column, value, least) in rows.items():
                spread = Spread(max(SPREADS[name].healthy, least), SPREADS[name].mistake)
                variance = parameters.covariance[column, column]
                odds[name] = statistics[f"log_odds_of_{name}"] = log_odds(
                    np.array([value]), variance, spread
                )
            first_s = offset_s - parameters.rate * span_s / 2.0
            # One rate explains an offset that grows from the first pose on.
            grows = odds["offset"] > ODDS and 2.0 * abs(first_s) < abs(offset_s)
            has_rate = odds["rate"] > (TIE if grows else ODDS) and not self.has_defects
            if (states_rate and has_rate) or rate:
                offset_s, rate, is_stated = first_s, fitted, True
            else:
                is_stated = is_stated or (odds["offset"] > ODDS and not self.has_defects)
        applied_s = self.inputs.protocol.association.time_offset_s
        seen = clock.seen(offset_s, rate, span_s / clock.factor, applied_s)
        return TestResult("clocks", statistics, (seen,) * is_stated)

    @property
    def _frame_s(self) -> float:
        """The time between two frames, which is at most the time between two keyframes."""
        return quantile(np.sort(np.diff(self.estimate.seconds)), _OF_FRAMES)

    def _scale_result(self, scale: float, variance: float) -> TestResult:
        statistics = {"scale": scale, "sigma_of_log": math.sqrt(variance)}
        seen = naming.unit_or_scale(scale, variance, self.motions, self.inputs.gauge)
        return TestResult("scale", statistics, seen)


def _fits(scores: ModelScores, model: Model, rows: Indices) -> bool:
    """Return whether a model explains the directions of rotations, in rows of the motions.

    They are about several axes there, unless they are those of the whole run as it is read.
    """
    read = scores.read(model.hypothesis)
    rotations, unit = read.truth.motions[0], read.truth.units[0][rows]
    most = np.linalg.norm(rotations, ord=2) / math.sqrt(len(rotations))
    rotations = rotations[rows]
    second = np.linalg.svd(rotations, compute_uv=False)[1] / math.sqrt(len(rows))
    is_as_read = model.cause == AS_READ and len(rows) == len(scores.motions)
    if second < _ONE_AXIS * most and not is_as_read:
        return False
    rotated = read.rotations[rows] @ model.body.T
    apart = lengths(rotations - rotated) / unit
    sizes_apart = np.abs(lengths(rotations) - lengths(rotated)) / unit
    return median(apart) <= _MISFIT * (min(median(sizes_apart), _NOISE) + 0.01)


def _best(models: Iterable[Model]) -> Model:
    return max(models, key=lambda model: model.score)
