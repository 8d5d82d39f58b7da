"""The request: everything that the numbers of an evaluation depend on, corrections included."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.consistency.covariance_request import CovarianceRequest, IntegrityRequest
from trajeval_ros.diagnosis.causes import CAUSES
from trajeval_ros.exceptions import InputError, SettingsError, require_one_of
from trajeval_ros.geometry.fix_selection import FixRule
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.pose_conventions import Conventions
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.trajectory_edits import TimeSpan
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.metrics.as_available import AvailabilityRule
from trajeval_ros.metrics.discontinuities.events import CLOCK_STEP
from trajeval_ros.metrics.discontinuities.handling import DiscontinuityRule
from trajeval_ros.metrics.protocol import GROUNDTRUTH_WEIGHTS, Protocol
from trajeval_ros.metrics.states_table import FirstStates

if TYPE_CHECKING:
    from trajeval_ros.diagnosis.findings import Diagnosis, Finding

SUGGESTED = "suggested"  # value of --correct: the most severe finding, and then the next ones
CONTINUOUS = "continuous"

# Corrections that change the pairs.
OF_PAIRS = {"time_offset", "estimate.clock_rate", "end", "max_gap"}


@dataclass(frozen=True)
class Corrections:
    """Conventions of both sides that differ from those that were read; by default none."""

    groundtruth: Conventions = field(default_factory=Conventions)
    estimate: Conventions = field(default_factory=Conventions)
    then: Corrections | None = None  # corrections of what these leave; None for none

    def changed(self, correction: Mapping[str, str]) -> Corrections:
        """Return these corrections and then those of a finding, such as `estimate.scale`."""
        if self.then is not None:
            return dataclasses.replace(self, then=self.then.changed(correction))
        sides: dict[str, dict[str, float | str]] = {"groundtruth": {}, "estimate": {}}
        for name, text in correction.items():
            side, _, attribute = name.partition(".")
            if attribute:
                sides[side][attribute] = type(getattr(Conventions(), attribute))(text)
        if not any(sides.values()):
            return self
        return dataclasses.replace(
            self,
            then=Corrections(**{side: Conventions(**of) for side, of in sides.items()}),  # type: ignore[arg-type]
        )


def require_correctable(cause: str) -> None:
    """Refuse a name that is neither `suggested` nor a cause with a correction."""
    known = [name for name, item in CAUSES.items() if item.correction]
    require_one_of(cause, [SUGGESTED, *known], "cause to correct")


def finding_to_correct(diagnosis: Diagnosis, cause: str, *, is_first: bool) -> Finding | None:
    """Return the finding to correct; None for `suggested` without findings.

    After the first correction, it is None if nothing is left to correct.
    """
    left = [finding for finding in diagnosis.findings if cause in (SUGGESTED, finding.cause)]
    correctable = next((item for item in left if item.correction), None)
    if correctable is not None or not is_first:
        return correctable
    if cause == SUGGESTED:
        if left:
            raise InputError(f"no option corrects the finding: {left[0].text}; remove --correct")
        return None
    finding = diagnosis.named(cause)
    if finding is None:
        causes = ", ".join(item.cause for item in diagnosis.findings) or "nothing"
        raise InputError(
            f"{cause} not found in the recording (found: {causes}); remove --correct, or convert "
            "the file with trajeval trajectory"
        )
    raise InputError(f"no option corrects {cause}: {finding.text}; remove --correct")


@dataclass(frozen=True, eq=False)
class Request:
    """What to compute for the estimates.

    Attributes:
        protocol: Association, alignment and errors.
        calibration: Clock and body parameters to estimate or to apply first.
        covariances: Settings of the consistency test.
        span_ns: First and last timestamp, by the groundtruth's clock, of the estimated states to
            evaluate; None for all.
        time_span: Part of the groundtruth's time to evaluate, relative to its first timestamp;
            both sides are cut. None for all.
        lengths_of_groundtruth: Whether lengths in percent refer to the path of all groundtruth,
            the same for all estimates, instead of the paired path.
        up: Up axes of the groundtruth's and the estimates' frame, such as "z" or "-y"; None for
            the trajectories' own.
        states_table: Further numbers of aligned states for which the ATE is computed.
        fixes: Selection and frame of the groundtruth's GNSS fixes.
        gauge_is_default: Whether the gauge is not chosen by the user, or only by sensors `lidar`.
            It is then yaw for GNSS fixes, because their heights would tilt the estimate.
        corrections: Conventions of the inputs that differ from those that were read; None
            for none.
        correct: Cause to correct if the diagnosis finds it, `suggested` for the most severe
            finding; "" for no correction.
        integrity: Alert limits and risk for protection levels; None for none.
        available: The as-available accuracy to compute, if it is requested.
        discontinuities: What to do at restarts, outliers and clock steps.
        watch_factor: Factor of a watchdog whose errors count as alerts; None for none.

    Raises:
        SettingsError: Contradictory parts, or an unknown axis.

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
    fixes: FixRule = field(default_factory=FixRule)
    gauge_is_default: bool = False
    corrections: Corrections | None = None
    correct: str = ""
    integrity: IntegrityRequest | None = None
    watch_factor: float | None = None
    available: AvailabilityRule = field(default_factory=AvailabilityRule)
    discontinuities: DiscontinuityRule = field(default_factory=DiscontinuityRule)

    def __post_init__(self) -> None:
        """Refuse contradictory parts and unknown axes."""
        for axis in self.up or ():
            UpAxis(axis)
        if self.correct:
            require_correctable(self.correct)
        if self.protocol.apply == "scale" and (
            self.is_continuous or self.covariances.source != "none" or self.calibration.anything
        ):
            raise SettingsError(
                "--apply scale excludes covariances, likelihoods and calibration; remove "
                "--apply scale or these options"
            )
        if self.integrity is not None and self.covariances.source == "none":
            raise SettingsError(
                "--alert-limit needs covariances; add --covariance message or FILE.npz"
            )
        if self.watch_factor is not None and self.integrity is None:
            raise SettingsError("--watch-factor needs --alert-limit; add it")
        if self.is_continuous and self.covariances.source != "none":
            raise SettingsError(
                "--covariance can't be combined with association continuous; use association "
                "linear or nearest"
            )

    @property
    def is_continuous(self) -> bool:
        """Whether likelihoods are computed: the association is continuous."""
        return self.protocol.association.method == CONTINUOUS

    @property
    def reads_covariances(self) -> bool:
        """Whether the covariances in the estimate's messages are read."""
        return self.covariances.source == "message" or self.protocol.align_weights == "covariance"

    @property
    def reads_groundtruth_covariances(self) -> bool:
        """Whether the covariances in the groundtruth's messages are read."""
        return self.protocol.align_weights == GROUNDTRUTH_WEIGHTS

    @property
    def received(self) -> str:
        """Which times of a bag are receive times; empty if poses are not read as received."""
        return self.available.received if self.available.is_asked_for else ""

    def for_trajectories(
        self, groundtruth: Trajectory, estimates: Sequence[Trajectory]
    ) -> Request:
        """Return the request with the default gauge for the kind of groundtruth.

        Raises:
            InputError: GNSS fixes cannot be used as requested.
        """
        protocol = self.protocol
        if self.gauge_is_default and groundtruth.reading.fixes is not None:
            protocol = dataclasses.replace(protocol, gauge=Gauge.YAW, modality=None)
        if groundtruth.reading.fixes is not None:
            from trajeval_ros.pipeline.fix_remarks import require_fixes_fit

            require_fixes_fit(groundtruth, estimates, protocol.gauge, self.fixes)
        return dataclasses.replace(self, protocol=protocol)

    def corrected(self, correction: Mapping[str, str]) -> Request:
        """Return the request with the correction of a finding, see `Finding.correction`."""
        protocol, calibration, rule = self.protocol, self.calibration, self.protocol.association
        up, time_span, discontinuities = self.up, self.time_span, self.discontinuities
        if correction.get("correct") == CLOCK_STEP:
            discontinuities = dataclasses.replace(discontinuities, correct_clock_steps=True)
        if "drop_groundtruth_outliers" in correction:
            discontinuities = dataclasses.replace(discontinuities, drop_groundtruth_outliers=True)
        if "gauge" in correction:
            gauge = Gauge.of(correction["gauge"])
            protocol = dataclasses.replace(protocol, gauge=gauge, modality=None)
        if "max_gap" in correction:
            rule = dataclasses.replace(rule, max_gap_s=float(correction["max_gap"]))
        if "time_offset" in correction:
            rule = dataclasses.replace(rule, time_offset_s=float(correction["time_offset"]))
        if "hand_eye" in correction:
            pose = HandEye.from_text(correction["hand_eye"])
            assert pose is not None
            # The pose is relative to the groundtruth after a known one.
            pose = pose if calibration.known is None else pose.after(calibration.known)
            calibration = dataclasses.replace(
                calibration, hand_eye=False, known=pose, source="the diagnosis"
            )
        if "up" in correction:
            groundtruth, _, estimate = correction["up"].partition(",")
            up = groundtruth, estimate
        if "end" in correction:
            until = TimeSpan.parse(None, correction["end"])
            assert until is not None
            time_span = until if time_span is None else _shorter(time_span, until)
        return dataclasses.replace(
            self,
            protocol=dataclasses.replace(protocol, association=rule),
            calibration=calibration,
            corrections=(self.corrections or Corrections()).changed(correction),
            up=up,
            time_span=time_span,
            discontinuities=discontinuities,
        )

    @functools.cached_property
    def fingerprint(self) -> str:
        """Hash of everything that the numbers depend on."""
        text = json.dumps(dataclasses.asdict(self), default=_plain, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


def _shorter(span: TimeSpan, until: TimeSpan) -> TimeSpan:
    """Return a span that ends earlier, relative to its start."""
    assert until.end_ns is not None
    end_ns = (span.start_ns or 0) + until.end_ns
    return dataclasses.replace(span, end_ns=end_ns, absolute_end=span.absolute_start)


def _plain(value: Any) -> Any:
    """Return a value without a JSON type, with all digits."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if hasattr(value, "tocoo"):  # a sparse matrix
        entries = value.tocoo()
        return [
            entries.shape,
            *(array.tolist() for array in (entries.row, entries.col, entries.data)),
        ]
    return str(value)
