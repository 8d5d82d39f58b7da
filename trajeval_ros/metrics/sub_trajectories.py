"""Sub-trajectories: which pairs of states (start, end) are a given length apart.

Tutorial, section IV-B, eq. (25). Lengths are measured along the path through the matched
groundtruth positions, or in time. Selection is a binary search per start: O(N log N).
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import SettingsError, require_one_of
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices

RULES = ("nearest", "toolbox", "first-past")


@dataclass(frozen=True)
class Length:
    """A length to choose sub-trajectories by: metres, seconds, or a share of the whole path.

    Example:
        >>> from trajeval_ros import Length
        >>> Length(8, "m") == Length.of(8) == Length.parse("8m")
        True
    """

    value: float
    unit: str

    def __post_init__(self) -> None:
        """Refuse lengths that no sub-trajectory can have."""
        if self.unit not in ("m", "s", "%"):
            raise SettingsError(f"a length is in m, s or %, not {self.unit!r}")
        if not (np.isfinite(self.value) and self.value > 0.0):
            raise SettingsError(f"a length must be positive, not {self.value:g}{self.unit}")

    @classmethod
    def parse(cls, text: str) -> Length:
        """Read "8", "8m", "1s" or "10%"."""
        match = re.fullmatch(r"\s*([0-9.]+(?:e-?[0-9]+)?)\s*(m|s|%)?\s*", text)
        if match is None:
            raise SettingsError(
                f"{text!r} is no length; write 8 or 8m (metres), 1s (seconds) or 10% (of the path)"
            )
        try:
            return cls(float(match[1]), match[2] or "m")
        except ValueError:
            raise SettingsError(f"{text!r} is no length") from None

    @classmethod
    def of(cls, length: Length | float | str) -> Length:
        """Return a length, one of so many metres, or what a text says.

        Raises:
            SettingsError: It is none.
        """
        if isinstance(length, Length):
            return length
        if isinstance(length, str):
            return cls.parse(length)
        if isinstance(length, bool) or not isinstance(length, (int, float, np.number)):
            raise SettingsError(
                f"{length!r} is no length; write metres as a number, or 8m, 1s or 10% as a text"
            )
        return cls(float(length), "m")

    def __str__(self) -> str:
        """Write it as `parse` reads it."""
        return f"{self.value:g}{self.unit}"


def parse_lengths(text: str) -> tuple[Length, ...]:
    """Read "8,16,24", "1s,5s", "10%,20%" or "none"."""
    if text.strip() == "none":
        return ()
    lengths = tuple(Length.parse(part) for part in text.split(","))
    if len(set(lengths)) < len(lengths):
        raise SettingsError(f"a length is given twice in {text!r}")
    return lengths


@dataclass(frozen=True)
class Selection:
    """The rule by which the end of a sub-trajectory is chosen.

    Attributes:
        rule: `nearest`: the state whose distance is nearest to the length, within 1 % of it or
            half the local spacing of states, whichever is more, but never more than 20 %.
            `toolbox`: nearest, within 20 %, as rpg_trajectory_evaluation does.
            `first-past`: the first state beyond the length, as the KITTI devkit does.
        every: Take each n-th state as a start.
    """

    rule: str = "nearest"
    every: int = 1

    def __post_init__(self) -> None:
        """Refuse rules that there are not."""
        require_one_of(self.rule, RULES, "selection rule")
        if self.every < 1:
            raise SettingsError(f"every n-th state is a start from n = 1 on, not {self.every}")


LARGEST_DEVIATION = 0.2
TOLERANCE = 0.01


def select(along: Floats, length: float, selection: Selection) -> tuple[Indices, Indices]:
    """Return the starts and ends (K,) of all sub-trajectories of that length.

    Args:
        along: (N,) distance travelled, metres, or time, seconds, at each state; not decreasing.
        length: In the unit of `along`.
        selection: How an end is chosen.
    """
    starts = np.arange(0, len(along), selection.every)
    if selection.rule == "first-past":
        ends = np.searchsorted(along, along[starts] + length, side="right")
        found = ends < len(along)
        return starts[found], ends[found]
    ends, accepted = nearest_ends(along, starts, length, selection.rule)
    return starts[accepted], ends[accepted]


def select_frames(
    along: Floats, frames: Indices, paired: Indices, length: float, selection: Selection
) -> tuple[Indices, Indices]:
    """Return the starts and ends (K,) that the KITTI devkit takes where frames may be missing.

    Every n-th frame by its number is a start, and the end is the first groundtruth frame beyond
    the length. Sub-trajectories whose start or end has no estimate are left out.

    Args:
        along: (M,) as for `select`, of all groundtruth frames.
        frames: (M,) their numbers.
        paired: (N,) index of those that are in a pair; starts and ends count these pairs.
        length: In the unit of `along`.
        selection: Of rule `first-past`.
    """
    starts = np.flatnonzero(frames % selection.every == 0)
    ends = np.searchsorted(along, along[starts] + length, side="right")
    starts, ends = starts[ends < len(along)], ends[ends < len(along)]
    pair = np.full(len(along), -1)
    pair[paired] = np.arange(len(paired))
    both = (pair[starts] >= 0) & (pair[ends] >= 0)
    return pair[starts[both]], pair[ends[both]]


def nearest_ends(
    along: Floats, starts: Indices, length: float | Floats, rule: str = "nearest"
) -> tuple[Indices, Booleans]:
    """Return the state nearest to the length from each start (K,), and whether it is near enough.

    Args:
        along: (N,) as for `select`.
        starts: (K,) indices of first states.
        length: One for all starts, or (K,).
        rule: `nearest` or `toolbox`.
    """
    target = along[starts] + length
    within = np.minimum(along.searchsorted(target), len(along) - 1)
    reached, missed = along[within], along[np.maximum(within - 1, starts)]
    # Of states at the same place (a robot at rest) the first one ends the sub-trajectory.
    before = np.maximum(along.searchsorted(missed), starts)
    too_long, too_short = np.abs(reached - target), np.abs(missed - target)
    ends = np.where(too_long < too_short, within, before)
    deviation = np.minimum(too_long, too_short)
    if rule == "toolbox":
        accepted = deviation < LARGEST_DEVIATION * length
    else:
        spacing = reached - missed
        tolerance = np.minimum(
            np.maximum(TOLERANCE * length, spacing / 2.0), LARGEST_DEVIATION * length
        )
        # The comparison must not depend on rounding in the running sum of the distance.
        accepted = deviation <= tolerance * (1.0 + 1e-9)
        accepted &= ends > starts
    return ends, accepted
