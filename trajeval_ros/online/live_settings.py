"""What a live evaluator is asked to do."""

from __future__ import annotations

from dataclasses import dataclass

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.online.pairing import Limits
from trajeval_ros.online.window import Window


@dataclass(frozen=True, init=False)
class OnlineSettings:
    """What a live evaluator does.

    Attributes:
        protocol: Gauge, states to align by, gap, offset, lengths and forms, as offline. Lengths
            that are shares of the path can only be had at the end.
        window: What the sliding numbers are about: a `Window`, or "0" (the whole run), "30s",
            "50m" or "500" (pairs).
        freeze: Keep the first alignment that the states determine well.
        limits: Of the memory for states that wait for their groundtruth.
        up: The axes that point up in the frames of groundtruth and estimate; None for those that
            the names of the frames tell, or z.

    Raises:
        SettingsError: A window or an axis that is none, or a protocol that can't be live.

    Example:
        >>> from trajeval_ros import OnlineSettings, Protocol
        >>> settings = OnlineSettings(Protocol(modality="stereo-inertial"), window="30s")
        >>> settings.window.size, settings.window.unit
        (30.0, 's')
    """

    protocol: Protocol
    window: Window
    freeze: bool
    limits: Limits
    up: tuple[str, str] | None

    def __init__(
        self,
        protocol: Protocol | None = None,
        window: Window | str = "0",
        freeze: bool = False,
        limits: Limits | None = None,
        up: tuple[str, str] | None = None,
    ) -> None:
        values = {
            "protocol": protocol or Protocol(),
            "window": Window.parse(window) if isinstance(window, str) else window,
            "freeze": freeze,
            "limits": limits or Limits(),
            "up": up,
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)
        self._require_possible()

    def _require_possible(self) -> None:
        """Refuse what can't be done live."""
        for axis in self.up or ():
            UpAxis(axis)
        method = self.protocol.association.method
        if method != "linear":
            raise SettingsError(
                f"association {method} can't be live: which pairs are closest shows at the end "
                "of a recording; use linear"
            )
        if self.protocol.re_form == "fitted" or self.protocol.lever_m:
            raise SettingsError(
                "RE form fitted and a protocol's lever arm need the whole recording; evaluate the "
                "recorded run"
            )
        if self.protocol.apply == "scale":
            raise SettingsError(
                "the scale of an alignment can't be applied alone live; apply all of it, or "
                "evaluate the recorded run"
            )
        if self.protocol.selection.is_consecutive or any(
            length.turns for length in self.protocol.lengths
        ):
            raise SettingsError(
                "consecutive pairs and lengths in degrees or radians can't be live; use pairs all "
                "and metres, seconds or frames, or evaluate the recorded run"
            )
        if self.freeze and self.protocol.align_states is not None:
            raise SettingsError("align states is either a number or frozen, not both")
