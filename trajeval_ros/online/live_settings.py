"""Settings of a live evaluator."""

from __future__ import annotations

from dataclasses import dataclass, replace

from trajeval_ros.consistency.covariance_request import CovarianceRequest, IntegrityRequest
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.metrics.as_available import AvailabilityRule
from trajeval_ros.metrics.association_rule import AT_GROUNDTRUTH, AUTO
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.sub_trajectories import Selection
from trajeval_ros.online.state_buffer import BufferLimits
from trajeval_ros.online.window import Window


@dataclass(frozen=True, init=False)
class OnlineSettings:
    """Settings of a live evaluator.

    Raises:
        SettingsError: An invalid window or axis, or a protocol that is not supported live.

    Example:
        >>> from trajeval_ros import OnlineSettings, Protocol
        >>> settings = OnlineSettings(Protocol(modality="stereo-inertial"), window="30s")
        >>> settings.window.size, settings.window.unit
        (30.0, 's')
    """

    # As offline; lengths in percent of the path are available at the end only.
    protocol: Protocol
    # Of the sliding statistics; as a text "0" (the whole run), "30s", "50m" or "500" (pairs).
    window: Window
    freeze: bool  # keep the first alignment that the states determine well
    limits: BufferLimits  # of the memory for states
    covariances: CovarianceRequest  # the consistency test with the covariances of messages
    integrity: IntegrityRequest | None  # alert limits and risk for protection levels
    # Up axes of groundtruth and estimate; None for those that the frames' names imply, or z.
    up: tuple[str, str] | None
    available: AvailabilityRule  # as-available accuracy to compute, if it is requested

    def __init__(
        self,
        protocol: Protocol | None = None,
        window: Window | str = "0",
        freeze: bool = False,
        limits: BufferLimits | None = None,
        covariances: CovarianceRequest | None = None,
        up: tuple[str, str] | None = None,
        integrity: IntegrityRequest | None = None,
        available: AvailabilityRule | None = None,
    ) -> None:
        values = {
            "protocol": protocol or Protocol(),
            "window": Window.parse(window) if isinstance(window, str) else window,
            "freeze": freeze,
            "limits": limits or BufferLimits(),
            "covariances": covariances or CovarianceRequest(),
            "up": up,
            "integrity": integrity,
            "available": available or AvailabilityRule(),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)
        self._require_possible()

    def with_gauge(self, gauge: Gauge) -> OnlineSettings:
        """Return the settings with another gauge, which is that of no modality."""
        if gauge is self.protocol.gauge:
            return self
        return replace(self, protocol=replace(self.protocol, gauge=gauge, modality=None))

    def with_offset(self, offset_s: float) -> OnlineSettings:
        """Return the settings with another offset of the estimate's timestamps, seconds."""
        rule = replace(self.protocol.association, time_offset_s=offset_s)
        return replace(self, protocol=replace(self.protocol, association=rule))

    @property
    def offset_s(self) -> float:
        """Offset added to the estimate's timestamps, seconds."""
        return self.protocol.association.time_offset_s

    @property
    def offset_ns(self) -> int:
        """Offset added to the estimate's timestamps, nanoseconds."""
        return round(self.offset_s * NANOSECONDS)

    def _require_possible(self) -> None:
        for axis in self.up or ():
            UpAxis(axis)
        method = self.protocol.association.method
        if method not in (AUTO, "linear", AT_GROUNDTRUTH):
            raise SettingsError(
                f"association {method} is not supported live; use linear or {AT_GROUNDTRUTH}"
            )
        if self.protocol.re_form == "fitted" or self.protocol.align_weights != "none":
            raise SettingsError(
                "RE form fitted and weights of the alignment are not supported live; "
                "evaluate the recorded run"
            )
        if self.protocol.score is not None or self.protocol.recall is not None:
            raise SettingsError("a score is not supported live; evaluate the recorded run")
        if self.protocol.apply == "scale":
            raise SettingsError(
                "apply scale is not supported live; use apply all, or evaluate the recorded run"
            )
        if self.protocol.selection.is_consecutive or any(
            length.turns for length in self.protocol.lengths
        ):
            raise SettingsError(
                "consecutive pairs and lengths in degrees or radians are not supported live; "
                "use pairs all and metres, seconds or frames, or evaluate the recorded run"
            )
        if self.integrity is not None and self.covariances.source == "none":
            raise SettingsError("an alert limit needs covariances; use covariance message")
        if self.covariances.source == "joint":
            raise SettingsError(
                "a joint covariance is not supported live; use covariance message, or evaluate "
                "the recorded run"
            )
        selection = replace(self.protocol.selection, tolerance=Selection.tolerance)
        if self.protocol.lengths and selection != Selection():
            raise SettingsError(
                f"sub-trajectory selection {selection} is not supported live; use lengths "
                "none, or evaluate the recorded run"
            )
        if self.freeze and self.protocol.align_states is not None:
            raise SettingsError("align states must be either a number or frozen, not both")
