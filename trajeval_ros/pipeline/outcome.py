"""What was found about estimates of one groundtruth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from trajeval_ros.diagnosis.findings import Diagnosis
from trajeval_ros.diagnosis.mending import Mended
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.input_summary import InputSummary
from trajeval_ros.metrics.states_table import AlignedBy
from trajeval_ros.pipeline.request import Request

if TYPE_CHECKING:
    from trajeval_ros.calibration.calibrated import Calibrated
    from trajeval_ros.consistency.integrity import Integrity
    from trajeval_ros.consistency.result import Consistency
    from trajeval_ros.likelihood.assessment import Assessment
    from trajeval_ros.metrics.own_error import OwnError


@dataclass(frozen=True, eq=False, repr=False)
class RunOutcome:
    """What was found about one estimate.

    Attributes:
        estimate: What was read.
        evaluation: Its errors, with the warnings about them.
        calibrated: What was calibrated, and the errors without it; None if nobody asked.
        consistency: Whether its covariances fit its errors; None if nobody asked.
        likelihood: How likely it is; None unless the association is continuous.
        live: What only a live run can tell; None of a recorded one.
        by_states: The ATE by alignments from other numbers of states, as asked for.
        own_error: The ATE without the noise of GNSS fixes; None of other groundtruth, and where
            that noise isn't known.
        diagnosis: The mistakes that the recording shows, and what was looked at.
        mended: The finding that was mended; None unless somebody asked for it.
        integrity: Whether its covariances hold as a promise; None if nobody asked.

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
    likelihood: Assessment | None = None
    live: Mapping[str, object] | None = None
    by_states: tuple[AlignedBy, ...] = ()
    own_error: OwnError | None = None
    diagnosis: Diagnosis = field(default_factory=Diagnosis)
    mended: Mended | None = None
    integrity: Integrity | None = None

    def __repr__(self) -> str:
        """Return a few lines: the errors, and what else was found."""
        lines = [f"<RunOutcome of {self.estimate.name or 'unnamed'}", repr(self.evaluation)]
        if self.calibrated is not None:
            lines.append(f"{self.calibrated.parameters_applied} calibrated parameters applied")
        if self.consistency is not None:
            lines.append(f"covariances: {self.consistency.verdict}, {self.consistency.exactness}")
        if self.likelihood is not None:
            bayes = ", ".join(f"{each:+.4g}" for each in self.likelihood.log_bayes.values())
            lines.append(f"likelihood assessed; log Bayes factors: {bayes or 'none'}")
        return "\n  ".join(lines) + ">"


@dataclass(frozen=True)
class FailedRun:
    """An estimate that could not be evaluated.

    Attributes:
        name: What a table calls it.
        source: What it was read from.
        reason: Why, in a sentence.
    """

    name: str
    source: str
    reason: str


@dataclass(frozen=True, eq=False, repr=False)
class Outcome:
    """What was found about estimates of one groundtruth.

    Attributes:
        request: What was asked for.
        groundtruth: What was read.
        runs: One for each estimate, in their order.
        failed: The estimates that could not be evaluated.

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

    def __repr__(self) -> str:
        """Return a line for each estimate."""
        lines = [f"<Outcome of {counted(len(self.runs), 'estimate')}, {len(self.failed)} failed"]
        lines += [f"{name}: {' '.join(cells)}" for name, *cells in self._rows()]
        return "\n  ".join(lines) + ">"

    def _repr_html_(self) -> str:
        """Return a row for each estimate, for notebooks."""
        from trajeval_ros.formatting.text_tables import html_table

        gauge = self.request.protocol.gauge.value
        header = ("estimate", "position ATE", "rotation ATE", "pairs")
        return html_table(f"position and rotation ATE, gauge {gauge}", header, self._rows())

    def _rows(self) -> list[tuple[str, ...]]:
        rows: list[tuple[str, ...]] = []
        for each in self.runs:
            ate = each.evaluation.ate
            position, rotation = ate["position_m"], ate["rotation_deg"]
            rows.append(
                (
                    each.estimate.name or "unnamed",
                    "" if position is None else f"{position.rmse:.4g} m",
                    "" if rotation is None else f"{rotation.rmse:.4g} deg",
                    counted(len(each.evaluation.association), "pair"),
                )
            )
        return rows + [(each.name, "failed", each.reason, "") for each in self.failed]

    @property
    def likelihoods(self) -> dict[str, Assessment]:
        """How likely the runs are whose association is continuous, by the estimate's name."""
        pairs = ((each.estimate.name, each.likelihood) for each in self.runs)
        return {name: likelihood for name, likelihood in pairs if likelihood is not None}

    @property
    def damage(self) -> tuple[str, ...]:
        """What of the inputs could not be read, one sentence each."""
        pairs = ((run.evaluation.groundtruth, run.evaluation.estimate) for run in self.runs)
        return tuple(
            dict.fromkeys(line for pair in pairs for each in pair for line in each.damage)
        )
