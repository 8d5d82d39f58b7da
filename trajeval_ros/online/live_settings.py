"""What a live evaluator is asked to do."""

from __future__ import annotations

from dataclasses import dataclass, field

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.online.pairing import Limits
from trajeval_ros.online.window import Window


@dataclass(frozen=True)
class OnlineSettings:
    """What a live evaluator does.

    Attributes:
        protocol: Gauge, states to align by, gap, offset, lengths and forms, as offline. Lengths
            that are shares of the path can only be had at the end.
        window: What the sliding numbers are about.
        freeze: Keep the first alignment that the states determine well.
        limits: Of the memory for states that wait for their groundtruth.
    """

    protocol: Protocol = field(default_factory=Protocol)
    window: Window = field(default_factory=Window)
    freeze: bool = False
    limits: Limits = field(default_factory=Limits)

    def __post_init__(self) -> None:
        """Refuse what can't be done live."""
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
        if self.freeze and self.protocol.align_states is not None:
            raise SettingsError("align states is either a number or frozen, not both")
