"""Tests of the motions of both sides: clocks, conventions, scale, worlds, bodies, in this order.

A mistake is a model of the short motions. It is stated if its odds against no mistake are large,
so no test needs the result of another one, but for the clock, which selects the motions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from trajeval_ros.diagnosis import naming
from trajeval_ros.diagnosis.clock_match import (
    SMALL_S,
    ClockMatch,
    parts_log_odds,
    rates_of_both,
    search_rate,
)
from trajeval_ros.diagnosis.dropout_tests import groundtruth_defects, without_defects
from trajeval_ros.diagnosis.findings import Examined, Seen
from trajeval_ros.diagnosis.hypotheses import (
    AS_READ,
    EULER_HYPOTHESES,
    HYPOTHESES,
    MISTAKE,
    ROTATIONS,
)
from trajeval_ros.diagnosis.input_pair import FEWEST_POSES, InputPair, TimedPoses, lengths
from trajeval_ros.diagnosis.input_tests import is_at_rest, rhythm, velocities
from trajeval_ros.diagnosis.motion_models import Model, ModelScores
from trajeval_ros.diagnosis.motion_parameters import (
    OFFSET,
    RATE,
    SPREADS,
    Parameters,
    Spread,
    fit_parameters,
    log_odds,
)
from trajeval_ros.diagnosis.naming import ODDS, TIE
from trajeval_ros.diagnosis.short_motions import FEWEST_MOTIONS, ShortMotions
from trajeval_ros.diagnosis.world_axes import vertical_axes
from trajeval_ros.metrics.statistics import median

_SHORTEST_S = 8.0  # of a side: less motion has no evidence
_LEAST_GAP_S, _MOST_GAP_S = 0.3, 1.1  # of the groundtruth to interpolate across
AGREE_NATS = 3.0  # per independent motion: unrelated motions reach less
_USABLE_PEAK = 0.6  # correlation of rates from which on an offset is applied to other tests
_ALIKE_PEAK, _ALIKE_RATE = 0.95, 0.985  # correlations from which on no other rate is searched
_NEAR_S = 0.5  # largest offset with the second of these: turn rates can match at random
_RATE_PRIOR = -4.0  # logarithm: other clock rates are rare
_UNRELATED_PEAK, _UNRELATED_S = 0.8, 15.0  # correlation and common time of another run
_NO_PEAK, _LONG_S = 0.45, 20.0  # the same, without common motions
_AT_REST_RAD = 0.01  # median rotation of a body that does not rotate, which is noise
# Causes that no mistake in Euler angles looks like, if they fit.
_OF_DIRECTIONS = {AS_READ, "wxyz", "xyzw", "inverse", "mirrored", "axes_mixed"}
_MISFIT = 2.0  # of directions relative to lengths of rotation vectors; conventions keep lengths
_REFINED_S, _REFINED_GROWTH_S = 0.03, 0.06  # clock errors from which on motions are sampled again
_WANDER_S = 0.005  # of healthy clocks along a run: short runs show no rate
_STEPS_APART = 0.05  # of a step of the estimate, healthy offset of its timestamps


@dataclass(frozen=True, eq=False)
class _Clock:
    """The coarse clock: the estimate's time t is mapped to t0 + factor (t - t0) + offset."""

    match: ClockMatch | None
    offset_s: float = 0.0
    factor: float = 1.0
    is_stated: bool = False  # whether the offset is significant


def tests_of_motion(inputs: InputPair) -> list[Examined]:
    """Apply all tests of motions."""
    groundtruth, estimate = inputs.in_order
    if min(groundtruth.span_s, estimate.span_s) < _SHORTEST_S or len(estimate) < FEWEST_POSES:
        return [Examined("motions", why_not=f"a side is shorter than {_SHORTEST_S:g} s")]
    examined: list[Examined] = []
    gap_s = max(inputs.max_gap_s, 4.0 * groundtruth.usual_step_s, _LEAST_GAP_S)
    clock, has_defects = _Clock(None), False
    if inputs.by_time:
        gap_s = min(gap_s, _MOST_GAP_S)
        is_odometry = inputs.estimate.reading.format.endswith("/Odometry")
        defects = groundtruth_defects(groundtruth, estimate, inputs.max_gap_s)
        examined += [defects, rhythm(groundtruth, estimate, is_odometry=is_odometry)]
        has_defects = bool(defects.seen)
        if has_defects:
            groundtruth = without_defects(groundtruth)
        clock = _coarse_clock(groundtruth, estimate, has_defects=has_defects)
        estimate = estimate.shifted(0.0, clock.factor - 1.0)
    motions = ShortMotions.between(groundtruth, estimate, gap_s, clock.offset_s)
    if len(motions) < FEWEST_MOTIONS:
        return [*examined, _few_motions(clock, inputs)]
    shifted = estimate.shifted(clock.offset_s)
    return [
        *examined,
        velocities(groundtruth, shifted),
        *_Comparison(inputs, groundtruth, estimate, motions, clock, gap_s).results(
            states_clock=not has_defects
        ),
    ]


def _coarse_clock(groundtruth: TimedPoses, estimate: TimedPoses, *, has_defects: bool) -> _Clock:
    rates = rates_of_both(groundtruth, estimate)
    if not all(len(side.known) for side in rates):
        return _Clock(None)
    match = ClockMatch.between(*rates)
    prior = MISTAKE
    if match is not None:
        prior -= math.log(max(match.searched_s, 1.0) / SMALL_S)
    is_alike = match is not None and (
        match.peak > _ALIKE_PEAK or (match.highest > _ALIKE_RATE and abs(match.offset_s) < _NEAR_S)
    )
    differs = match is None or (not is_alike and parts_log_odds(*rates, match) > ODDS)
    if differs and not has_defects:
        other = search_rate(*rates)
        if other is not None:
            factor, faster = other
            least = (0.0 if match is None else match.log_odds) + ODDS - prior - _RATE_PRIOR
            if faster.log_odds > least and faster.peak > _USABLE_PEAK:
                return _Clock(faster, faster.offset_s, factor, is_stated=True)
    if match is None or match.peak <= _USABLE_PEAK:
        return _Clock(match)
    others = max(match.log_odds_at_zero - prior, match.log_odds_of_second)
    if match.log_odds > others + ODDS:
        return _Clock(match, match.offset_s, is_stated=abs(match.offset_s) > SMALL_S)
    return _Clock(match, match.offset_s if abs(match.offset_s) <= SMALL_S else 0.0)


def _few_motions(clock: _Clock, inputs: InputPair) -> Examined:
    match = clock.match
    is_unknown = match is None or match.overlap_s < _LONG_S or match.peak > _NO_PEAK
    if is_unknown or is_at_rest(inputs):
        seen: tuple[Seen, ...] = ()
        if clock.is_stated:
            assert match is not None
            seen = (_coarse_finding(clock, match, inputs),)
        return Examined("models", seen=seen, why_not="too few short motions have groundtruth")
    assert match is not None
    return Examined("models", {"peak": match.peak}, (_other_run(match),))


def _coarse_finding(clock: _Clock, match: ClockMatch, inputs: InputPair) -> Seen:
    span_s = inputs.in_order[1].span_s
    ppm = 1e6 * (clock.factor - 1.0)
    growth_s = (clock.factor - 1.0) * span_s
    return naming.clock(match, clock.offset_s, ppm, growth_s, inputs.time_offset_s)


def _other_run(match: ClockMatch) -> Seen:
    return Seen.of("other_run", peak=match.peak)


@dataclass(frozen=True, eq=False)
class _Comparison:
    """The comparison of motions at the coarse clock."""

    inputs: InputPair
    groundtruth: TimedPoses
    estimate: TimedPoses  # with the factor of the clock
    motions: ShortMotions
    clock: _Clock
    max_gap_s: float

    def results(self, *, states_clock: bool) -> list[Examined]:
        """Return the results of all tests; only if `states_clock`, small clock errors are stated.

        Defects of the groundtruth shift the motions by a part of a second.
        """
        scores = ModelScores(self.motions)
        models = scores.likeliest(HYPOTHESES)
        best = max(models, key=lambda model: model.score)
        as_read = max(
            (model for model in models if model.cause == AS_READ), key=lambda model: model.score
        )
        unrelated = scores.unrelated
        oriented, rotates = self.motions.has_orientations, self._rotates(scores)
        if oriented and rotates and self._may_be_euler(scores, best):
            models += scores.likeliest(EULER_HYPOTHESES)
            best = max(models, key=lambda model: model.score)
        related = max(best.log_likelihood, unrelated.positions) - unrelated.motions
        nats = related / scores.evidence
        statistics = {
            "as_read": as_read.score - unrelated.motions,
            "best": best.score - unrelated.motions,
            "positions_alone": unrelated.positions - unrelated.motions,
            "nats_per_motion": nats,
        }
        # Few independent directions can agree at random, and rates of motion hardly can.
        least_nats = 2.0 * AGREE_NATS if self._has_unrelated_rates() else AGREE_NATS
        if nats < least_nats:
            return [self._clock_result(None), self._unrelated(statistics)]
        if oriented and rotates and unrelated.positions + MISTAKE > best.score + ODDS:
            by_scale = naming.unit_or_scale(
                unrelated.scale, SPREADS["scale"].healthy ** 2, self.motions, self.inputs.gauge
            )
            return [
                self._clock_result(None),
                Examined("models", statistics, (naming.rotations(scores),)),
                Examined("scale", {"scale": unrelated.scale}, tuple(by_scale)),
            ]
        seen: tuple[Seen, ...] = ()
        if best.cause != AS_READ and best.score > as_read.score + ODDS:
            seen = (naming.convention(scores, best, models, as_read),)
        else:
            best = as_read
        agrees = (best.log_likelihood - unrelated.motions) / scores.evidence > AGREE_NATS
        parameters, scores = self._fitted(scores, best)
        results = [
            self._clock_result(
                parameters,
                states_offset=states_clock,
                states_rate=states_clock and oriented and not seen,
            ),
            Examined("models", statistics, seen),
            self._scale_result(parameters),
        ]
        if not (oriented and agrees):
            why_not = "no orientations" if not oriented else "rotations do not agree"
            return [*results, Examined("bodies", why_not=why_not)]
        if not self.inputs.gauge.turns_about_gravity_only:
            why_not = "the alignment includes roll and pitch, or no rotation"
            results.append(Examined("vertical axes", why_not=why_not))
        elif not best.changes_axes:
            results.append(self._world_result(scores, best, parameters))
        if best.hypothesis.cause == ROTATIONS:
            return [*results, Examined("bodies", why_not="rotations do not agree")]
        of_bodies, bodies = naming.body_and_lever(scores, parameters, best)
        return [*results, Examined("bodies", of_bodies, tuple(bodies))]

    def _rotates(self, scores: ModelScores) -> bool:
        """Return whether the groundtruth rotates more than by noise."""
        rotations, _ = scores.read(HYPOTHESES[0]).groundtruth
        return median(lengths(rotations)) > _AT_REST_RAD

    def _has_unrelated_rates(self) -> bool:
        """Return whether neither speeds nor angular speeds correlate at any offset."""
        match = self.clock.match
        return match is not None and match.overlap_s > _LONG_S and match.highest < _NO_PEAK

    def _may_be_euler(self, scores: ModelScores, best: Model) -> bool:
        """Return whether directions of rotations fit worse than their lengths."""
        usual = best.cause in _OF_DIRECTIONS
        positions = scores.unrelated.positions + 2.0 * MISTAKE
        if not usual or positions > best.score:
            return True
        read = scores.read(best.hypothesis)
        rotations, _ = read.groundtruth
        unit = read.of_groundtruth.units[0]
        apart = lengths(rotations - read.rotations @ best.body.T) / unit
        sizes_apart = np.abs(lengths(rotations) - lengths(read.rotations)) / unit
        return median(apart) > _MISFIT * (median(sizes_apart) + 0.01)

    def _unrelated(self, statistics: dict[str, float]) -> Examined:
        match = self.clock.match
        if is_at_rest(self.inputs):
            why_not = "both at rest; motions can't be compared"
            return Examined("models", statistics, why_not=why_not)
        seen: tuple[Seen, ...] = ()
        if match is not None and match.overlap_s > _UNRELATED_S:
            # The rates of one run correlate most without an offset, even if the estimate is bad.
            is_apart = match.peak < _UNRELATED_PEAK and abs(match.offset_s) > SMALL_S
            if is_apart or self._has_unrelated_rates():
                seen = (_other_run(match),)
        return Examined("models", statistics, seen, "" if seen else "the motions do not agree")

    def _fitted(self, scores: ModelScores, model: Model) -> tuple[Parameters, ModelScores]:
        """Fit the parameters, a second time if the motions were sampled at wrong times."""
        parameters = fit_parameters(scores, model)
        growth_s = abs(parameters.rate) * self.estimate.span_s
        if abs(parameters.offset_s) < _REFINED_S and growth_s < _REFINED_GROWTH_S:
            return parameters, scores
        offset_s = self.clock.offset_s + parameters.offset_s
        again = ShortMotions.between(
            self.groundtruth, self.estimate, self.max_gap_s, offset_s, parameters.rate
        )
        if len(again) < FEWEST_MOTIONS:
            return parameters, scores
        scores = ModelScores(again)
        refined = fit_parameters(scores, model)
        refined.values[7:9] += parameters.values[7:9]
        return refined, scores

    def _clock_result(
        self,
        parameters: Parameters | None,
        *,
        states_offset: bool = False,
        states_rate: bool = False,
    ) -> Examined:
        """Return the offset or the rate of the clock, by the fit if there is one."""
        clock, match = self.clock, self.clock.match
        if match is None:
            return Examined("clocks", why_not="no timestamps, or too little common time")
        statistics = {
            "offset_s": clock.offset_s,
            "peak": match.peak,
            "as_stamped": match.as_stamped,
            "log_odds": match.log_odds - match.log_odds_at_zero,
        }
        if parameters is None:
            seen = (_coarse_finding(clock, match, self.inputs),) if clock.is_stated else ()
            return Examined("clocks", statistics, seen)
        offset_s = clock.offset_s + parameters.offset_s
        rate = clock.factor * (1.0 + parameters.rate) - 1.0
        usual, wander = SPREADS["offset"], _WANDER_S / max(self.estimate.span_s, 1.0)
        rates = SPREADS["rate"]
        rate_odds = log_odds(
            parameters.values[RATE],
            parameters.covariance[RATE, RATE],
            Spread(max(rates.healthy, wander), rates.mistake),
        )
        healthy = max(usual.healthy, _STEPS_APART * self.estimate.usual_step_s)
        spread = Spread(healthy, usual.mistake)
        variance = parameters.covariance[OFFSET, OFFSET]
        offset_odds = log_odds(np.array([offset_s]), variance, spread)
        statistics |= {
            "fitted_offset_s": offset_s,
            "fitted_ppm": 1e6 * rate,
            "log_odds_of_offset": offset_odds,
            "log_odds_of_rate": rate_odds,
        }
        applied_s = self.inputs.time_offset_s
        first_s = offset_s - parameters.rate * self.estimate.span_s / 2.0
        # One rate explains an offset that grows from the first pose on.
        grows = offset_odds > ODDS and rate_odds > TIE and abs(first_s) < abs(offset_s) / 2.0
        if clock.factor != 1.0 or (states_rate and (rate_odds > ODDS or grows)):
            span_s = self.estimate.span_s / clock.factor
            seen = (naming.clock(match, first_s, 1e6 * rate, rate * span_s, applied_s),)
        elif clock.is_stated or (states_offset and offset_odds > ODDS):
            seen = (naming.clock(match, offset_s, 0.0, 0.0, applied_s),)
        else:
            seen = ()
        return Examined("clocks", statistics, seen)

    def _scale_result(self, parameters: Parameters) -> Examined:
        variance = float(parameters.covariance[3, 3])
        statistics = {"scale": parameters.scale, "sigma_of_log": math.sqrt(variance)}
        seen = naming.unit_or_scale(parameters.scale, variance, self.motions, self.inputs.gauge)
        return Examined("scale", statistics, tuple(seen))

    def _world_result(self, scores: ModelScores, model: Model, parameters: Parameters) -> Examined:
        # The same poses with z flipped, in place of the rotation by 180 deg that up = -z is.
        flipped = replace(model, axes=-np.eye(3), body=model.body @ np.diag([-1.0, -1.0, 1.0]))
        [flipped] = scores.with_likelihoods([flipped])
        can_mirror = flipped.log_likelihood > model.log_likelihood - TIE
        statistics, seen = vertical_axes(
            scores, model, parameters.body, self.inputs, can_mirror=can_mirror
        )
        stated = statistics["log_odds"] > ODDS or any(
            one.cause == "groundtruth_up_axis" for one in seen
        )
        return Examined("vertical axes", statistics, tuple(seen) if stated else ())
