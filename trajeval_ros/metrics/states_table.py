"""The ATE as a function of the number of aligned states: Table III of the tutorial.

The position ATE tends to decrease with this number. Compare only results with the same number.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from dataclasses import dataclass

from trajeval_ros.exceptions import SettingsError, TrajevalError
from trajeval_ros.metrics.evaluation import Evaluation, evaluate_pairs
from trajeval_ros.metrics.statistics import Statistics


def parse_states(text: str) -> int | None:
    """Return the number of aligned states in a text "all" or "10"; None for all."""
    if text == "all":
        return None
    if not text.isdecimal() or not 1.0 <= float(text) < 1e18:
        raise SettingsError(f"align states must be all or a number of states, not {text!r}")
    return int(text)


@dataclass(frozen=True)
class FirstStates:
    """A number of first pairs to align by."""

    states: int | None = None  # the number; None for all pairs, or if `share` is set
    share: float | None = None  # the number as a share of all pairs, above 0 and below 1, or None

    @classmethod
    def parse(cls, text: str) -> FirstStates:
        """Parse "1", "25%" or "all"."""
        text = text.strip()
        if not text.endswith("%"):
            return cls(states=parse_states(text))
        try:
            share = float(text[:-1]) / 100.0
        except ValueError:
            share = math.nan
        if not 0.0 < share < 1.0:
            raise SettingsError(
                f"a share of the states must be between 0 % and 100 %, not {text!r}; use all for "
                "all states"
            )
        return cls(share=share)

    def __str__(self) -> str:
        if self.share is not None:
            return f"{100.0 * self.share:g}%"
        return "all" if self.states is None else str(self.states)

    def count(self, matched: int) -> int | None:
        """Return the number of states out of `matched` pairs; None for all."""
        if self.share is None:
            return self.states
        return max(1, math.floor(self.share * matched + 0.5))


def parse_first_states(text: str) -> tuple[FirstStates, ...]:
    """Parse "1,25%,50%,75%,all"."""
    chosen = tuple(FirstStates.parse(part) for part in text.split(","))
    if len(set(chosen)) < len(chosen):
        raise SettingsError(f"the number of states is given twice in {text!r}; remove one")
    return chosen


@dataclass(frozen=True)
class AlignedBy:
    """The ATE of one alignment."""

    states: str
    states_used: int | None = None  # number of states in the fit; None if there is no alignment
    # Statistics of the position error; None if there is no alignment.
    position_m: Statistics | None = None
    # Statistics of the rotation error; None if not available.
    rotation_deg: Statistics | None = None
    reason: str = ""  # why there is no alignment, or no rotation error; empty otherwise


def states_table(evaluation: Evaluation, chosen: Iterable[FirstStates]) -> tuple[AlignedBy, ...]:
    """Return the ATE of the same pairs for alignments by different numbers of first pairs."""
    return tuple(_aligned_by(evaluation, first) for first in chosen)


def _aligned_by(evaluation: Evaluation, first: FirstStates) -> AlignedBy:
    pairs = evaluation.association
    try:
        protocol = dataclasses.replace(
            evaluation.protocol, align_states=first.count(len(pairs)), lengths=()
        )
        evaluation_of_states = evaluate_pairs(
            pairs, evaluation.groundtruth, evaluation.estimate, protocol
        )
    except TrajevalError as error:
        return AlignedBy(str(first), reason=str(error))
    return AlignedBy(
        states=str(first),
        states_used=evaluation_of_states.alignment.states_used,
        position_m=evaluation_of_states.ate["position_m"],
        rotation_deg=evaluation_of_states.ate["rotation_deg"],
        reason=f"rotation withheld: {evaluation_of_states.withheld}"
        if evaluation_of_states.withheld
        else "",
    )
