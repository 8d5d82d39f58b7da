"""The pipeline: a request and trajectories in, an outcome out. It knows no files.

The command line, comparisons and their workers, live runs and Python all go this way, so that the
same request gives the same numbers everywhere:

    calibrate -> associate, align, measure -> warn -> judge covariances -> assess likelihoods
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.consistency.covariance_request import CovarianceRequest
from trajeval_ros.diagnosis.clock_hint import clock_hint
from trajeval_ros.diagnosis.rotation_hints import require_same_body
from trajeval_ros.diagnosis.vertical import require_vertical, without_vertical
from trajeval_ros.diagnosis.warnings import warnings_of
from trajeval_ros.exceptions import InputError, SettingsError, TrajevalError
from trajeval_ros.formatting.text_tables import html_table
from trajeval_ros.geometry.time_span import TimeSpan
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.geometry.upright import upright
from trajeval_ros.metrics import evaluation as measuring
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.input_summary import InputSummary
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.states_table import AlignedBy, FirstStates, states_table
from trajeval_ros.metrics.sub_trajectories import Length

if TYPE_CHECKING:
    from trajeval_ros.calibration.apply import Calibrated
    from trajeval_ros.consistency.result import Consistency
    from trajeval_ros.likelihood.assessment import Assessment
    from trajeval_ros.metrics.association import Association

CONTINUOUS = "continuous"


@dataclass(frozen=True, eq=False)
class Request:
    """What to compute about estimates.

    Attributes:
        protocol: How poses are paired, aligned and measured.
        calibration: What of clocks and bodies to estimate or apply first.
        covariances: Which covariances of the estimate to judge, and by which groundtruth noise.
        span_ns: First and last stamp, in the groundtruth's clock, of the estimate's states to
            evaluate; None for all.
        time_span: The part of the groundtruth's time to evaluate, counted from its first stamp;
            both sides are cut to it. None for all.
        lengths_of_groundtruth: Whether lengths in percent are shares of the whole groundtruth's
            path, the same for all estimates, instead of the matched path.
        up: The axes that point up in the groundtruth's frame and in the estimates', such as "z"
            or "-y"; None for those that the trajectories have.
        states_table: Numbers of first states to give the ATE of the alignment for, besides the
            protocol's.

    Example:
        >>> from trajeval_ros import CalibrationRequest, Protocol, Request
        >>> request = Request(Protocol(modality="mono"), CalibrationRequest(offset=True))
        >>> request.is_continuous
        False
    """

    protocol: Protocol = field(default_factory=Protocol)
    calibration: CalibrationRequest = field(default_factory=CalibrationRequest)
    covariances: CovarianceRequest = field(default_factory=CovarianceRequest)
    span_ns: tuple[int, int] | None = None
    lengths_of_groundtruth: bool = False
    time_span: TimeSpan | None = None
    up: tuple[str, str] | None = None
    states_table: tuple[FirstStates, ...] = ()

    def __post_init__(self) -> None:
        """Refuse parts that contradict each other, and an axis that is none.

        Raises:
            SettingsError: They do.
        """
        for axis in self.up or ():
            UpAxis(axis)
        if self.protocol.apply == "scale" and (
            self.is_continuous or self.covariances.source != "none" or self.calibration.anything
        ):
            raise SettingsError(
                "covariances, likelihoods and calibration are of whole alignments; leave out "
                "--apply scale"
            )
        if self.is_continuous and self.covariances.source != "none":
            raise SettingsError(
                "--covariance compares with samples of the groundtruth, and association "
                "continuous also with poses between them; use association linear or nearest"
            )

    @property
    def is_continuous(self) -> bool:
        """Whether likelihoods are assessed: the groundtruth is continuous in time."""
        return self.protocol.association.method == CONTINUOUS

    @property
    def reads_covariances(self) -> bool:
        """Whether the covariances in the estimate's messages are needed."""
        return self.covariances.source == "message" or self.protocol.align_weights != "none"

    @property
    def fingerprint(self) -> str:
        """Hash of everything in it that numbers depend on."""
        text = json.dumps(dataclasses.asdict(self), default=_plain, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


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
        '<Outcome of 1 estimates, 0 failed'
    """

    request: Request
    groundtruth: InputSummary
    runs: tuple[RunOutcome, ...]
    failed: tuple[FailedRun, ...] = ()

    def __repr__(self) -> str:
        """Return a line for each estimate."""
        lines = [f"<Outcome of {len(self.runs)} estimates, {len(self.failed)} failed"]
        lines += [f"{name}: {' '.join(cells)}" for name, *cells in self._rows()]
        return "\n  ".join(lines) + ">"

    def _repr_html_(self) -> str:
        """Return a row for each estimate, for notebooks."""
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
                    f"{len(each.evaluation.association)} pairs",
                )
            )
        return rows + [(each.name, "failed", each.reason, "") for each in self.failed]

    @property
    def damage(self) -> tuple[str, ...]:
        """What of the inputs could not be read, one sentence each."""
        pairs = ((run.evaluation.groundtruth, run.evaluation.estimate) for run in self.runs)
        return tuple(
            dict.fromkeys(line for pair in pairs for each in pair for line in each.damage)
        )


def run(
    groundtruth: Trajectory, estimates: Sequence[Trajectory], request: Request | None = None
) -> Outcome:
    """Evaluate estimates of one groundtruth, as the request says.

    All estimates use the calibration of the first one: errors under parameters of their own can't
    be ranked.

    Args:
        groundtruth: M states.
        estimates: Each in a frame of its own, with a name of its own.
        request: What to compute; by default ATE and relative errors by the default protocol.

    Raises:
        InputError: There is no estimate, or one can't be evaluated as requested; then the message
            begins with its source or name.

    Example:
        >>> from trajeval_ros import Request, run, simulate
        >>> flight = simulate(seed=1, duration_s=30.0)
        >>> outcome = run(flight.groundtruth, [flight.estimate, flight.estimate[::2]], Request())
        >>> len(outcome.runs)
        2
    """
    request = request or Request()
    if not estimates:
        raise InputError("there is no estimate to evaluate; give at least one")
    if request.up is not None:
        groundtruth, *estimates = _with_up(request.up, groundtruth, *estimates)
    first_ns = int(groundtruth.stamps.min()) if len(groundtruth) else 0
    if request.time_span is not None:
        with _named(groundtruth):
            groundtruth = request.time_span.cut(groundtruth, first_ns)
    runs: list[RunOutcome] = []
    for estimate in estimates:
        with _named(estimate):
            if request.time_span is not None:
                offset_ns = round(request.protocol.association.time_offset_s * NANOSECONDS)
                estimate = request.time_span.cut(estimate, first_ns, offset_ns)
            same_as = runs[0].calibrated if runs else None
            runs.append(_run(groundtruth, estimate, request, same_as))
    used = runs[0].evaluation.groundtruth
    return Outcome(request, InputSummary.of(groundtruth, used), tuple(_with_bayes_factors(runs)))


def run_pairs(
    pairs: Association, groundtruth: Trajectory, estimate: Trajectory, request: Request
) -> RunOutcome:
    """Evaluate pairs that a live run has made.

    Args:
        pairs: States paired by the request's association.
        groundtruth: What stands for all groundtruth states; its rows are those of the pairs.
        estimate: Likewise.
        request: What to compute. A time offset can't be applied any more, and likelihoods need
            the groundtruth between pairs.

    Raises:
        InputError: The pairs lack what the request needs.
        SettingsError: The request needs more than pairs.
    """
    if request.calibration.offset:
        raise SettingsError(
            "pairs are made with a fixed time offset; set time_offset for the live evaluator, or "
            "evaluate a bag with --time-offset auto"
        )
    if request.is_continuous or request.span_ns is not None or request.time_span is not None:
        raise SettingsError(
            "likelihoods and time spans need the whole groundtruth, and a live run keeps pairs "
            "alone; evaluate a bag"
        )
    if request.up is not None:
        groundtruth, estimate = _with_up(request.up, groundtruth, estimate)
        sides = _with_up(request.up, pairs.groundtruth, pairs.estimate)
        pairs = dataclasses.replace(pairs, groundtruth=sides[0], estimate=sides[1])
    return _run(groundtruth, estimate, request, None, pairs)


def evaluate(
    groundtruth: Trajectory, estimate: Trajectory, protocol: Protocol | None = None
) -> Evaluation:
    """Measure the errors of one estimate: ATE and relative errors, with warnings.

    Tutorial: alignment by eq. (13) in the protocol's gauge, absolute errors (23) with the rmse
    (24), relative errors (27) over sub-trajectories (25).

    Args:
        groundtruth: M states; its `up` axis is what yaw and tilt are about.
        estimate: N states in a frame of their own, whose `up` axis gauges yaw and planar bring to
            the groundtruth's.
        protocol: How poses are paired, aligned and measured; None for gauge se3 and lengths of 8
            to 40 m.

    Returns:
        Errors in metres and degrees, pair by pair and as statistics, in the groundtruth's frame;
        for gauges yaw and planar, and association continuous, in that frame with z up.

    Raises:
        InputError: Trajectories that can't be evaluated; NoMatchError where no stamps match.
        DegenerateGeometryError: Too few states, or no motion, for the gauge's alignment.

    Example:
        >>> from trajeval_ros import Protocol, evaluate, simulate
        >>> flight = simulate(seed=1, duration_s=30.0)
        >>> protocol = Protocol(modality="stereo-inertial", lengths=(8, 16))
        >>> found = evaluate(flight.groundtruth, flight.estimate, protocol)
        >>> 0.0 < found.ate["position_m"].rmse < 1.0
        True
    """
    protocol = protocol or Protocol()
    require_vertical(groundtruth, protocol.gauge)
    if protocol.is_upright:
        groundtruth, estimate = upright(groundtruth), upright(estimate)
    return with_warnings(measuring.evaluate(groundtruth, estimate, protocol))


def with_warnings(evaluation: Evaluation) -> Evaluation:
    """Return an evaluation with what a reader must know, without what has no meaning.

    Raises:
        InputError: It is aligned by the orientations of another body.
    """
    require_same_body(evaluation)
    evaluation = without_vertical(evaluation)
    hints = clock_hint(evaluation.association, evaluation.aligned)
    return dataclasses.replace(
        evaluation, warnings=(*hints, *warnings_of(evaluation), *evaluation.warnings)
    )


def _run(
    groundtruth: Trajectory,
    estimate: Trajectory,
    request: Request,
    same_as: Calibrated | None,
    pairs: Association | None = None,
) -> RunOutcome:
    """Evaluate one estimate: the stations of the pipeline, one after the other."""
    protocol, used = request.protocol, estimate
    if request.span_ns is not None:
        used = _cut(estimate, request.span_ns, protocol)
    if request.lengths_of_groundtruth:
        protocol = _with_lengths_of(groundtruth, protocol)
    require_vertical(groundtruth, protocol.gauge)
    if protocol.is_upright:
        groundtruth, used = upright(groundtruth), upright(used)
        if pairs is not None:
            pairs = dataclasses.replace(
                pairs, groundtruth=upright(pairs.groundtruth), estimate=upright(pairs.estimate)
            )

    calibrated = None
    if request.calibration.anything:
        from trajeval_ros.calibration.apply import evaluate_calibrated

        calibrated = evaluate_calibrated(
            groundtruth, used, protocol, request.calibration, same_as=same_as, pairs=pairs
        )
        evaluation = calibrated.evaluation
    elif pairs is not None:
        evaluation = measuring.evaluate_pairs(pairs, groundtruth, used, protocol)
    else:
        evaluation = measuring.evaluate(groundtruth, used, protocol)
    evaluation = with_warnings(evaluation)

    consistency = likelihood = None
    if request.covariances.source != "none":
        from trajeval_ros.consistency.judge import judge

        consistency = judge(evaluation, request.covariances)
    if request.is_continuous:
        from trajeval_ros.likelihood.assessment import assess

        likelihood = assess(evaluation)
    return RunOutcome(
        InputSummary.of(estimate, evaluation.estimate),
        evaluation,
        calibrated,
        consistency,
        likelihood,
        by_states=states_table(evaluation, request.states_table),
    )


def _with_up(
    up: tuple[str, str], groundtruth: Trajectory, *estimates: Trajectory
) -> list[Trajectory]:
    """Return trajectories with the axes that were given."""
    axes = [UpAxis(up[0]), *[UpAxis(up[1])] * len(estimates)]
    return [
        dataclasses.replace(each, up=axis)
        for each, axis in zip((groundtruth, *estimates), axes, strict=True)
    ]


def _with_bayes_factors(runs: Sequence[RunOutcome]) -> Iterator[RunOutcome]:
    """Yield the runs, their likelihoods compared with those of the others."""
    assessments = [each.likelihood for each in runs if each.likelihood is not None]
    if len(assessments) < 2:
        yield from runs
        return
    from trajeval_ros.likelihood.assessment import compared

    names = [each.estimate.name for each in runs]
    for each, assessment in zip(runs, compared(names, assessments), strict=True):
        yield dataclasses.replace(each, likelihood=assessment)


def _cut(estimate: Trajectory, span_ns: tuple[int, int], protocol: Protocol) -> Trajectory:
    """Return the states of the estimate that lie within the span."""
    if not estimate.stamped or protocol.association.method == "index":
        raise InputError("it is paired row by row, so it can't be cut to a time span")
    offset = round(protocol.association.time_offset_s * NANOSECONDS)
    stamps = estimate.stamps + offset
    inside = (stamps >= span_ns[0]) & (stamps <= span_ns[1])
    if not inside.any():
        raise InputError("it has no pose in the time span")
    return estimate[inside]


def _with_lengths_of(groundtruth: Trajectory, protocol: Protocol) -> Protocol:
    """Return the protocol with shares of the whole groundtruth's path in metres.

    A share of the matched path would be another length for each algorithm. The toolbox's rule
    has lengths of all groundtruth anyway.
    """
    if protocol.selection.rule == "toolbox":
        return protocol
    whole = groundtruth.in_order() if protocol.in_order else groundtruth
    lengths = tuple(
        Length(each.value / 100.0 * whole.path_length_m, "m") if each.unit == "%" else each
        for each in protocol.lengths
    )
    return dataclasses.replace(protocol, lengths=lengths)


@contextlib.contextmanager
def _named(estimate: Trajectory) -> Iterator[None]:
    """Say which estimate an error is about."""
    name = estimate.source or estimate.name
    try:
        yield
    except TrajevalError as error:
        raise InputError(f"{name}: {error}" if name else str(error)) from error


def _plain(value: Any) -> Any:
    """Return what JSON has no type for, to the last digit."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if hasattr(value, "tocoo"):  # a sparse matrix
        entries = value.tocoo()
        return [
            entries.shape,
            *(each.tolist() for each in (entries.row, entries.col, entries.data)),
        ]
    return str(value)
