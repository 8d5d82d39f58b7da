"""The rule of an association: its method and its limits."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

from trajeval_ros.continuous_time.samples import DEFAULT_MODEL, MODELS, Noise
from trajeval_ros.exceptions import SettingsError, require_one_of
from trajeval_ros.geometry.arrays import Booleans, Stamps
from trajeval_ros.geometry.interpolation import Bracket
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory

LATEST_CLOCK_S = 5e9  # the year 2128
_LONGEST_S = 1e9  # limit of time differences and gaps; int64 nanoseconds hold more
AUTO, AT_GROUNDTRUTH = "auto", "groundtruth-stamps"
# Methods that interpolate one side at the timestamps of the other.
INTERPOLATING = (AUTO, "linear", AT_GROUNDTRUTH, "continuous")
_PAIR_IN_GAPS = (AT_GROUNDTRUTH, "continuous")  # methods with pairs in gaps of the groundtruth
METHODS = (AUTO, "linear", AT_GROUNDTRUTH, "continuous", "nearest", "rpg", "evo", "index")


@dataclass(frozen=True)
class AssociationRule:
    """The settings of an association.

    Attributes:
        method: One of `METHODS`.
        max_time_difference_s: Largest time difference in a pair, for `nearest`, `rpg` and `evo`.
        max_gap_s: Longest step between two states that is interpolated: of the groundtruth, or of
            the estimate for `groundtruth-stamps`.
        time_offset_s: Added to the estimate's timestamps before pairing, seconds.
        model: Motion model of the groundtruth, for `continuous`.
        noise: Noise of the groundtruth's samples, for `continuous`.

    Raises:
        SettingsError: An unknown method or model, or a number out of range.

    Example:
        >>> from trajeval_ros import AssociationRule, Protocol
        >>> rule = AssociationRule("nearest", max_time_difference_s=0.01)
        >>> Protocol(association=rule).association.method
        'nearest'
    """

    method: str = AUTO
    max_time_difference_s: float = 0.02
    max_gap_s: float = 0.5
    time_offset_s: float = 0.0
    model: str = DEFAULT_MODEL
    noise: Noise = field(default_factory=Noise)

    def __post_init__(self) -> None:
        require_one_of(self.method, METHODS, "association")
        for name in ("max_time_difference_s", "max_gap_s"):
            if not 0.0 < getattr(self, name) <= _LONGEST_S:
                raise SettingsError(
                    f"{name.removesuffix('_s')} must be greater than 0 and at most "
                    f"{_LONGEST_S:.0f} s, not {getattr(self, name):g}"
                )
        require_one_of(self.model, MODELS, "continuous model")
        if not abs(self.time_offset_s) <= LATEST_CLOCK_S:
            raise SettingsError(
                f"the time offset must be within {LATEST_CLOCK_S:g} s, not {self.time_offset_s}"
            )

    def for_kind(self, kind: str) -> AssociationRule:
        """Return the rule for a kind of groundtruth (`Trajectory.kind`), with `auto` resolved.

        Rates are not used for the choice, because a live run does not have them at its start.
        """
        if self.method != AUTO:
            return self
        return dataclasses.replace(self, method="linear" if kind == "poses" else AT_GROUNDTRUTH)

    @property
    def longest_step_s(self) -> float:
        """Longest step that a pair can be within, seconds: of `nearest`, both time differences."""
        return self.max_gap_s if self.method in INTERPOLATING else 2.0 * self.max_time_difference_s

    def bridging(self, step_s: float) -> AssociationRule:
        """Return the rule that interpolates steps of up to `step_s`, too."""
        longest_s = max(self.max_gap_s, min(step_s, _LONGEST_S))
        return dataclasses.replace(self, max_gap_s=longest_s)

    def is_gap(self, steps: Stamps) -> Booleans:
        """Return which time steps (N,), nanoseconds, are not interpolated."""
        return steps > round(self.max_gap_s * NANOSECONDS)

    def is_groundtruth_gap(self, steps: Stamps) -> Booleans:
        """Return which time steps (N,) of the groundtruth, nanoseconds, can have no pairs.

        None: between fixes or points, and with a model of the groundtruth's motion.
        """
        return self.is_gap(steps) & (self.method not in _PAIR_IN_GAPS)

    def cell_ns(self, longest_ns: int) -> int:
        """Return a step that resolves the groundtruth's gaps, nanoseconds: at most half of one."""
        if self.method in _PAIR_IN_GAPS:
            return longest_ns
        return min(longest_ns, max(round(self.max_gap_s * NANOSECONDS) // 2, 1))

    def interpolated(self, states: Trajectory, stamps: Stamps) -> tuple[Trajectory, Bracket]:
        """Interpolate states in order of time at stamps (N,): see `Trajectory.at`."""
        return states.at(stamps, self.max_gap_s)
