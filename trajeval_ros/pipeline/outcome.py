"""The results for the estimates of one groundtruth, and what needs all of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from trajeval_ros.diagnosis.diagnose import same_estimate
from trajeval_ros.diagnosis.findings import Diagnosis, Finding
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.metrics.as_available import AsAvailable
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.input_summary import InputSummary
from trajeval_ros.pipeline.fix_remarks import fix_remarks
from trajeval_ros.pipeline.request import Request

if TYPE_CHECKING:
    from trajeval_ros.calibration.apply import Calibrated
    from trajeval_ros.consistency.consistency_result import Consistency
    from trajeval_ros.consistency.integrity import Integrity
    from trajeval_ros.formatting.remarks import Remark
    from trajeval_ros.geometry.fix_selection import FixRule
    from trajeval_ros.likelihood.likelihood_assessment import LikelihoodAssessment
    from trajeval_ros.metrics.noise_corrected_ate import NoiseCorrectedAte
    from trajeval_ros.metrics.states_table import AlignedBy
    from trajeval_ros.metrics.stream_health import StreamHealth


@dataclass(frozen=True, eq=False, repr=False)
class RunOutcome:
    """The results for one estimate.

    Attributes:
        estimate: Summary of the input.
        evaluation: Its errors and warnings.
        calibrated: Calibration, and the errors without it; None if not requested.
        consistency: Consistency test of its covariances; None if not requested.
        likelihood: Likelihoods; None unless the association is continuous.
        live: Results that only a live run has; None for a recorded run.
        by_states: The ATE for the requested numbers of aligned states.
        noise_corrected_ate: The ATE without the noise of GNSS fixes; None for other
            groundtruth, and if that noise is unknown.
        diagnosis: The detected mistakes, and the tests for them.
        corrected: The mistakes that were corrected on request, in this order.
        integrity: Errors against protection levels; None if not requested.
        stream: Rate, gaps and arrivals of the messages of a bag; None for other sources.
        available: As-available accuracy; None if not requested.

    Example:
        >>> from trajeval_ros import run, simulate
        >>> flight = simulate(seed=1, duration_s=30.0)
        >>> first = run(flight.groundtruth, [flight.estimate]).runs[0]
        >>> first.consistency is None and first.evaluation.ate["position_m"].count > 500
        True
    """

    estimate: InputSummary
    evaluation: Evaluation
    calibrated: Calibrated | None = None
    consistency: Consistency | None = None
    likelihood: LikelihoodAssessment | None = None
    live: Mapping[str, object] | None = None
    by_states: tuple[AlignedBy, ...] = ()
    noise_corrected_ate: NoiseCorrectedAte | None = None
    diagnosis: Diagnosis = field(default_factory=Diagnosis)
    corrected: tuple[Finding, ...] = ()
    integrity: Integrity | None = None
    stream: StreamHealth | None = None
    available: AsAvailable | None = None

    def __repr__(self) -> str:
        """Return a summary in a few lines."""
        lines = [f"<RunOutcome of {self.estimate.name or 'unnamed'}", repr(self.evaluation)]
        if self.calibrated is not None:
            lines.append(f"{self.calibrated.parameters_applied} calibrated parameters applied")
        if self.consistency is not None:
            lines.append(f"covariances: {self.consistency.verdict}, {self.consistency.exactness}")
        if self.likelihood is not None:
            bayes = ", ".join(f"{factor:+.4g}" for factor in self.likelihood.log_bayes.values())
            lines.append(f"likelihood assessed; log Bayes factors: {bayes or 'none'}")
        return "\n  ".join(lines) + ">"


@dataclass(frozen=True)
class FailedRun:
    """An estimate that could not be evaluated."""

    name: str  # in tables
    source: str
    reason: str  # why it could not be evaluated, one sentence


@dataclass(frozen=True, eq=False, repr=False)
class Outcome:
    """The results for the estimates of one groundtruth.

    Attributes:
        request: The request.
        groundtruth: Summary of the input.
        runs: The results of the estimates, in their order.
        failed: The estimates that could not be evaluated.
        settings: The settings of a live run by name; None for those of the request.

    Example:
        >>> from trajeval_ros import run, simulate
        >>> flight = simulate(seed=1, duration_s=30.0)
        >>> outcome = run(flight.groundtruth, [flight.estimate])
        >>> repr(outcome).splitlines()[0]
        '<Outcome of 1 estimate, 0 failed'
    """

    request: Request
    groundtruth: InputSummary
    runs: tuple[RunOutcome, ...]
    failed: tuple[FailedRun, ...] = ()
    settings: Mapping[str, Any] | None = None

    def __repr__(self) -> str:
        """Return a summary with a line per estimate."""
        lines = [f"<Outcome of {counted(len(self.runs), 'estimate')}, {len(self.failed)} failed"]
        lines += [f"{name}: {' '.join(cells)}" for name, *cells in self._rows()]
        return "\n  ".join(lines) + ">"

    def _repr_html_(self) -> str:
        """Return a table with a row per estimate, for notebooks."""
        from trajeval_ros.formatting.text_tables import html_table

        gauge = self.request.protocol.gauge.value
        header = ("estimate", "position ATE", "rotation ATE", "pairs")
        return html_table(f"position and rotation ATE, gauge {gauge}", header, self._rows())

    def _rows(self) -> list[tuple[str, ...]]:
        """Return name, position ATE, rotation ATE and number of pairs of the estimates."""
        rows: list[tuple[str, ...]] = []
        for run in self.runs:
            ate = run.evaluation.ate
            position, rotation = ate["position_m"], ate["rotation_deg"]
            rows.append(
                (
                    run.estimate.name or "unnamed",
                    "" if position is None else f"{position.rmse:.4g} m",
                    "" if rotation is None else f"{rotation.rmse:.4g} deg",
                    counted(len(run.evaluation.association), "pair"),
                )
            )
        return rows + [(failure.name, "failed", failure.reason, "") for failure in self.failed]

    @property
    def likelihoods(self) -> dict[str, LikelihoodAssessment]:
        """Likelihoods of runs with a continuous association, by the estimate's name."""
        pairs = ((run.estimate.name, run.likelihood) for run in self.runs)
        return {name: likelihood for name, likelihood in pairs if likelihood is not None}

    @property
    def damage(self) -> tuple[str, ...]:
        """Missing data: the sentences of all remarks of level ERROR."""
        remarks = (remark for run in self.runs for remark in run.evaluation.remarks)
        return tuple(
            dict.fromkeys(remark.text for remark in remarks if remark.level is Level.ERROR)
        )


def with_same_estimates_named(runs: Sequence[RunOutcome]) -> list[RunOutcome]:
    """Return the runs with a finding for an estimate that equals a previous one."""
    named = []
    for number, run in enumerate(runs):
        same = same_estimate(run.estimate, [earlier.estimate for earlier in runs[:number]])
        if same is not None:
            diagnosis = run.diagnosis.with_others([same])
            run = dataclasses.replace(with_remarks([same.remark], run), diagnosis=diagnosis)
        named.append(run)
    return named


def with_bayes_factors(runs: Sequence[RunOutcome]) -> Iterator[RunOutcome]:
    """Yield the runs with Bayes factors between their likelihoods."""
    assessments = [run.likelihood for run in runs if run.likelihood is not None]
    if len(assessments) < 2:
        yield from runs
        return
    from trajeval_ros.likelihood.likelihood_assessment import with_bayes_factors

    names = [run.estimate.name for run in runs]
    for run, assessment in zip(runs, with_bayes_factors(names, assessments), strict=True):
        yield dataclasses.replace(run, likelihood=assessment)


def with_noise_corrected_ates(runs: list[RunOutcome], rule: FixRule) -> list[RunOutcome]:
    """Return the runs with errors without the noise of GNSS fixes, and warnings about fixes."""
    evaluations = [run.evaluation for run in runs]
    known = any(run.calibrated is not None and run.calibrated.lever_applied for run in runs)
    if evaluations[0].groundtruth.reading.fixes is None:
        remarks = (
            fix_remarks(evaluation, rule, lever_arm_known=known) for evaluation in evaluations
        )
        both = zip(remarks, runs, strict=True)
        return [with_remarks(more, run, len(run.diagnosis.findings)) for more, run in both]
    from trajeval_ros.metrics.noise_corrected_ate import noise_corrected_ates

    results = []
    for run, (corrected, why) in zip(
        runs, noise_corrected_ates(evaluations, rule.correlation_s), strict=True
    ):
        more = fix_remarks(
            run.evaluation, rule, corrected, why, lever_arm_known=known, of=len(runs)
        )
        run = with_remarks(more, run, len(run.diagnosis.findings))
        results.append(dataclasses.replace(run, noise_corrected_ate=corrected))
    return results


def with_remarks(more: Sequence[Remark], run: RunOutcome, after: int = 0) -> RunOutcome:
    """Return a run with more remarks, after the first ones, which are about findings."""
    if not more:
        return run
    given = run.evaluation.remarks
    remarks = (*given[:after], *more, *given[after:])
    return dataclasses.replace(
        run, evaluation=dataclasses.replace(run.evaluation, remarks=remarks)
    )
