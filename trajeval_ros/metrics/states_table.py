"""The ATE by the number of states that the alignment is from: Table III of the tutorial.

The more of them, the smaller the position ATE tends to be, so that numbers compare only where as
many were used.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from dataclasses import dataclass

from trajeval_ros.exceptions import SettingsError, TrajevalError
from trajeval_ros.metrics.evaluation import Evaluation, evaluate_pairs
from trajeval_ros.metrics.settings import parse_states
from trajeval_ros.metrics.statistics import Statistics


@dataclass(frozen=True)
class FirstStates:
    """How many of the first matched states to align by.

    Attributes:
        states: So many; None for all, or for a share.
        share: So large a share of them, above 0 and below 1; None otherwise.
    """

    states: int | None = None
    share: float | None = None

    @classmethod
    def parse(cls, text: str) -> FirstStates:
        """Read "1", "25%" or "all".

        Raises:
            SettingsError: It is none of them.
        """
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
        """Write it as `parse` reads it."""
        if self.share is not None:
            return f"{100.0 * self.share:g}%"
        return "all" if self.states is None else str(self.states)

    def count(self, matched: int) -> int | None:
        """Return how many of so many matched states these are; None for all."""
        if self.share is None:
            return self.states
        return max(1, math.floor(self.share * matched + 0.5))


def parse_first_states(text: str) -> tuple[FirstStates, ...]:
    """Read "1,25%,50%,75%,all".

    Raises:
        SettingsError: A part means nothing, or is given twice.
    """
    chosen = tuple(FirstStates.parse(part) for part in text.split(","))
    if len(set(chosen)) < len(chosen):
        raise SettingsError(f"the number of states is given twice in {text!r}; remove one")
    return chosen


@dataclass(frozen=True)
class AlignedBy:
    """The ATE of one alignment.

    Attributes:
        states: As asked for.
        states_used: So many; None where there is no such alignment.
        position_m: Statistics of the position error; None where there is no such alignment.
        rotation_deg: Statistics of the rotation error; None where there is none.
        reason: Empty, or why there is no such alignment, or no rotation error.
    """

    states: str
    states_used: int | None = None
    position_m: Statistics | None = None
    rotation_deg: Statistics | None = None
    reason: str = ""


def states_table(evaluation: Evaluation, chosen: Iterable[FirstStates]) -> tuple[AlignedBy, ...]:
    """Return the ATE of the same pairs by alignments from other numbers of their first states."""
    return tuple(_aligned_by(evaluation, each) for each in chosen)


def _aligned_by(evaluation: Evaluation, first: FirstStates) -> AlignedBy:
    pairs = evaluation.association
    try:
        protocol = dataclasses.replace(
            evaluation.protocol, align_states=first.count(len(pairs)), lengths=()
        )
        found = evaluate_pairs(pairs, evaluation.groundtruth, evaluation.estimate, protocol)
    except TrajevalError as error:
        return AlignedBy(str(first), reason=str(error))
    return AlignedBy(
        states=str(first),
        states_used=found.alignment.states_used,
        position_m=found.ate["position_m"],
        rotation_deg=found.ate["rotation_deg"],
        reason=f"rotation withheld: {found.withheld}" if found.withheld else "",
    )
