"""What to compute about estimates."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.consistency.covariance_request import CovarianceRequest
from trajeval_ros.diagnosis.fix_hints import require_fixes_fit
from trajeval_ros.diagnosis.mending import require_fix
from trajeval_ros.diagnosis.mends import Mends
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.fixes import FixRule
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.time_span import TimeSpan
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.metrics.protocol import GROUNDTRUTH_WEIGHTS, Protocol
from trajeval_ros.metrics.states_table import FirstStates

if TYPE_CHECKING:
    from trajeval_ros.consistency.integrity import IntegrityRequest
    from trajeval_ros.watchdog.limits import WatchLimits

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
        fixes: Which GNSS fixes of the groundtruth are used, and in which frame.
        gauge_is_default: Whether nobody chose the gauge: then it is yaw for GNSS fixes, whose
            heights would tilt an estimate.
        mends: What of both sides is to be read otherwise than it was written.
        fix: A cause to be mended where the diagnosis finds it, `suggested` for the gravest
            finding; "" to mend nothing.
        integrity: Alert limits and risk to compare protection levels with; None for none.
        watch_limits: Of a watch whose errors are alerts, too, where integrity is asked for.

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
    mends: Mends = field(default_factory=Mends)
    fix: str = ""
    integrity: IntegrityRequest | None = None
    watch_limits: WatchLimits | None = None

    def __post_init__(self) -> None:
        """Refuse parts that contradict each other, and an axis that is none.

        Raises:
            SettingsError: They do.
        """
        for axis in self.up or ():
            UpAxis(axis)
        if self.fix:
            require_fix(self.fix)
        if self.protocol.apply == "scale" and (
            self.is_continuous or self.covariances.source != "none" or self.calibration.anything
        ):
            raise SettingsError(
                "--apply scale excludes covariances, likelihoods and calibration; remove "
                "--apply scale or these options"
            )
        if self.integrity is not None and self.covariances.source == "none":
            raise SettingsError(
                "--integrity needs covariances; add --covariance message or --covariance FILE.npz"
            )
        if self.watch_limits is not None and self.integrity is None:
            raise SettingsError("--watch-limits needs --integrity; add it")
        if self.is_continuous and self.covariances.source != "none":
            raise SettingsError(
                "--covariance can't be combined with association continuous; use association "
                "linear or nearest"
            )

    @property
    def is_continuous(self) -> bool:
        """Whether likelihoods are assessed: the groundtruth is continuous in time."""
        return self.protocol.association.method == CONTINUOUS

    @property
    def reads_covariances(self) -> bool:
        """Whether the covariances in the estimate's messages are needed."""
        return self.covariances.source == "message" or self.protocol.align_weights == "covariance"

    @property
    def reads_groundtruth_covariances(self) -> bool:
        """Whether the covariances in the groundtruth's messages are needed."""
        return self.protocol.align_weights == GROUNDTRUTH_WEIGHTS

    def for_trajectories(
        self, groundtruth: Trajectory, estimates: Sequence[Trajectory]
    ) -> Request:
        """Return the request with the gauge that groundtruth of this kind has by default.

        Raises:
            InputError: Fixes can't be used as requested.
        """
        protocol = self.protocol
        if self.gauge_is_default and groundtruth.fixes is not None:
            protocol = dataclasses.replace(protocol, gauge=Gauge.YAW)
        require_fixes_fit(groundtruth, estimates, protocol.gauge, self.fixes)
        return dataclasses.replace(self, protocol=protocol)

    @functools.cached_property
    def fingerprint(self) -> str:
        """Hash of everything in it that numbers depend on."""
        text = json.dumps(dataclasses.asdict(self), default=_plain, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


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
