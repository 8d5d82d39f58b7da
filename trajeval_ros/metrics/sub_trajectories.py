"""Sub-trajectories: which pairs of states (start, end) are a given length apart.

Tutorial, section IV-B, eq. (25). Lengths are measured along the path through the matched
positions, in time, in states, or by how far the body has turned. Selection is a binary search per
start, O(N log N), but for evo's pairs of rotations, which are compared with one another, O(N^2).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

import numpy as np

from trajeval_ros.exceptions import SettingsError, require_one_of
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices

RULES = ("nearest", "toolbox", "first-past", "evo")
PAIRS = ("all", "consecutive")
PATHS = ("groundtruth", "estimate")
UNITS = ("m", "s", "%", "f", "deg", "rad")
_EXAMPLES = "8 or 8m (metres), 1s (seconds), 10f (frames), 5deg or 0.1rad (of rotation) or 10%"


@dataclass(frozen=True)
class Length:
    """A length to choose sub-trajectories by.

    Attributes:
        value: In its unit.
        unit: `m`, of the path; `s`; `%`, of the whole path; `f`, frames, which are matched states;
            `deg` or `rad`, by which the body turns.

    Example:
        >>> from trajeval_ros import Length
        >>> Length(8, "m") == Length.of(8) == Length.parse("8m")
        True
    """

    value: float
    unit: str

    def __post_init__(self) -> None:
        """Refuse lengths that no sub-trajectory can have."""
        if self.unit not in UNITS:
            raise SettingsError(
                f"the unit of a length must be one of {', '.join(UNITS)}, not {self.unit!r}"
            )
        if not (np.isfinite(self.value) and self.value > 0.0):
            raise SettingsError(f"a length must be positive, not {self.value:g}{self.unit}")
        if self.unit == "f" and self.value != round(self.value):
            raise SettingsError(f"a length in frames must be a whole number, not {self.value:g}f")

    @property
    def in_metres(self) -> bool:
        """Whether it is a distance, so that errors can be a share of it."""
        return self.unit in ("m", "%")

    @property
    def turns(self) -> bool:
        """Whether it is a rotation."""
        return self.unit in ("deg", "rad")

    @property
    def radians(self) -> float:
        """How far the body turns, of a length that is a rotation."""
        return float(np.radians(self.value)) if self.unit == "deg" else self.value

    @classmethod
    def parse(cls, text: str) -> Length:
        """Read "8", "8m", "1s", "10f", "5deg", "0.1rad" or "10%"."""
        pattern = rf"\s*([0-9.]+(?:e-?[0-9]+)?)\s*({'|'.join(UNITS)})?\s*"
        match = re.fullmatch(pattern, text)
        if match is None:
            raise SettingsError(f"{text!r} is not a length; give {_EXAMPLES} (of the path)")
        try:
            return cls(float(match[1]), match[2] or "m")
        except ValueError:
            raise SettingsError(f"{text!r} is not a length") from None

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
                f"{length!r} is not a length; give metres as a number, or a text such as "
                f"{_EXAMPLES}"
            )
        return cls(float(length), "m")

    def __str__(self) -> str:
        """Write it as `parse` reads it."""
        return f"{self.value:g}{self.unit}"


def parse_lengths(text: str) -> tuple[Length, ...]:
    """Read "8,16,24", "1s,5s", "1f,10f", "5deg", "10%,20%" or "none"."""
    if text.strip() == "none":
        return ()
    lengths = tuple(Length.parse(part) for part in text.split(","))
    if len(set(lengths)) < len(lengths):
        raise SettingsError(f"a length is given twice in {text!r}; remove one")
    return lengths


@dataclass(frozen=True)
class Selection:
    """The rule by which starts and ends of sub-trajectories are chosen.

    Frames are counted, so that all rules agree about them.

    Attributes:
        rule: `nearest`: the state whose distance is nearest to the length, within 1 % of it or
            half the local spacing of states, whichever is more, but never more than 20 %.
            `toolbox`: nearest, within 20 %, as rpg_trajectory_evaluation does.
            `first-past`: the first state beyond the length, as the KITTI devkit does.
            `evo`: as evo_rpe does. Of consecutive pairs the first state at or beyond the length;
            of all pairs the nearest one within the tolerance, but of rotations every pair of
            states whose orientations are so far apart, within the tolerance.
        every: Take each n-th state as a start.
        pairs: `all`: every start is used. `consecutive`: the next sub-trajectory begins where
            the one before ends.
        path: Along which positions and rotations lengths are measured: the `groundtruth`'s, or
            the `estimate`'s with the alignment's scale.
        tolerance: By what share an end may miss the length: rule `evo`, all pairs.
    """

    rule: str = "nearest"
    every: int = 1
    pairs: str = "all"
    path: str = "groundtruth"
    tolerance: float = 0.1

    def __post_init__(self) -> None:
        """Refuse rules that there are not."""
        require_one_of(self.rule, RULES, "selection rule")
        require_one_of(self.pairs, PAIRS, "selection of pairs")
        require_one_of(self.path, PATHS, "path")
        if self.every < 1:
            raise SettingsError(f"the step of start states must be at least 1, not {self.every}")
        if self.every > 1 and self.is_consecutive:
            raise SettingsError(
                "consecutive sub-trajectories start at the end of the previous one, so every "
                f"must be 1, not {self.every}; use pairs all, or every 1"
            )
        if not 0.0 < self.tolerance < 1.0:
            raise SettingsError(
                "the tolerance must be a fraction of the length between 0 and 1, not "
                f"{self.tolerance:g}"
            )

    def __str__(self) -> str:
        """Return what the sub-trajectories depend on, in a few words."""
        parts = [self.rule, f"every {self.every}"]
        parts += [self.pairs] if self.is_consecutive else []
        parts += ["along the estimate"] if self.path == "estimate" else []
        parts += [f"within {self.tolerance:g}"] if self.compares_rotations else []
        return ", ".join(parts)

    @property
    def is_consecutive(self) -> bool:
        """Whether a sub-trajectory begins where the one before ends."""
        return self.pairs == "consecutive"

    @property
    def compares_rotations(self) -> bool:
        """Whether lengths in degrees are between the orientations of any two states."""
        return self.rule == "evo" and not self.is_consecutive


LARGEST_DEVIATION = 0.2
TOLERANCE = 0.01
_TURN_BLOCK = 256


def select(along: Floats, length: float, selection: Selection) -> tuple[Indices, Indices]:
    """Return the starts and ends (K,) of all sub-trajectories of that length.

    Args:
        along: (N,) distance travelled, metres, angle turned, or time, seconds, at each state; not
            decreasing.
        length: In the unit of `along`.
        selection: How an end is chosen.
    """
    starts = np.arange(0, len(along), selection.every)
    if selection.rule == "first-past" or (selection.rule == "evo" and selection.is_consecutive):
        side: Literal["left", "right"] = "left" if selection.rule == "evo" else "right"
        ends = np.searchsorted(along, along[starts] + length, side=side)
        accepted = ends < len(along)
    else:
        ends, accepted = nearest_ends(along, starts, length, selection.rule, selection.tolerance)
    count = int(np.count_nonzero(accepted))
    if accepted[:count].all():
        # All but the last ones, as is usual: no copies.
        return _used(starts[:count], ends[:count], selection)
    return _used(starts[accepted], ends[accepted], selection)


def select_states(count: int, length: int, selection: Selection) -> tuple[Indices, Indices]:
    """Return the starts and ends (K,) of sub-trajectories of so many steps between N states."""
    starts = np.arange(0, max(count - length, 0), selection.every)
    return _used(starts, starts + length, selection)


def select_turns(quaternions: Floats, angle: float, tolerance: float) -> tuple[Indices, Indices]:
    """Return the starts and ends (K,) of all pairs of states whose orientations are so far apart.

    Args:
        quaternions: (N, 4) xyzw, unit.
        angle: Radians, at most half a turn.
        tolerance: Share of the angle by which it may be missed.
    """
    least, most = (1.0 - tolerance) * angle, min((1.0 + tolerance) * angle, np.pi)
    # |q_i . q_j| is the cosine of half the angle between them.
    high, low = np.cos(least / 2.0), np.cos(most / 2.0)
    found: list[tuple[Indices, Indices]] = []
    for begin in range(0, len(quaternions), _TURN_BLOCK):
        block = quaternions[begin : begin + _TURN_BLOCK]
        cosine = np.abs(block @ quaternions[begin:].T)
        starts, ends = np.nonzero(np.triu((cosine <= high) & (cosine >= low), 1))
        found.append((starts + begin, ends + begin))
    starts, ends = np.hstack(found)
    return starts, ends


def _used(starts: Indices, ends: Indices, selection: Selection) -> tuple[Indices, Indices]:
    """Return all sub-trajectories, or those that begin where the one before ends."""
    if not selection.is_consecutive or not len(starts):
        return starts, ends
    # A state may be passed over that begins none, and none ends where it begins.
    forward = ends > starts
    starts, ends = starts[forward], ends[forward]
    following = np.searchsorted(starts, ends).tolist()
    kept, place = [], 0
    while place < len(following):
        kept.append(place)
        place = following[place]
    return starts[kept], ends[kept]


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
    inside = ends < len(along)
    starts, ends = _used(starts[inside], ends[inside], selection)
    pair = np.full(len(along), -1)
    pair[paired] = np.arange(len(paired))
    both = (pair[starts] >= 0) & (pair[ends] >= 0)
    return pair[starts[both]], pair[ends[both]]


def nearest_ends(
    along: Floats,
    starts: Indices,
    length: float | Floats,
    rule: str = "nearest",
    share: float = LARGEST_DEVIATION,
) -> tuple[Indices, Booleans]:
    """Return the state nearest to the length from each start (K,), and whether it is near enough.

    Args:
        along: (N,) as for `select`.
        starts: (K,) indices of first states.
        length: One for all starts, or (K,).
        rule: `nearest`, `toolbox` or `evo`.
        share: Of the length by which an end may miss it: rule `evo`.
    """

    def at(starts: Indices, length: Floats) -> tuple[Indices, Booleans]:
        target = along[starts] + length
        within = np.minimum(_search(along, target), len(along) - 1)
        before = np.maximum(within - 1, starts)
        reached, missed = along[within], along[before]
        # Of states at the same place (a robot at rest) the first one ends the sub-trajectory.
        rests = np.flatnonzero(along[np.maximum(before - 1, 0)] == missed)
        before[rests] = np.maximum(along.searchsorted(missed[rests]), starts[rests])
        too_long, too_short = np.abs(reached - target), np.abs(missed - target)
        ends = np.where(too_long < too_short, within, before)
        deviation = np.minimum(too_long, too_short)
        if rule == "toolbox":
            accepted = deviation < LARGEST_DEVIATION * length
        elif rule == "evo":
            accepted = (deviation <= share * length) & (ends > starts)
        else:
            spacing = reached - missed
            tolerance = np.minimum(
                np.maximum(TOLERANCE * length, spacing / 2.0), LARGEST_DEVIATION * length
            )
            # The comparison must not depend on rounding in the running sum of the distance.
            accepted = deviation <= tolerance * (1.0 + 1e-9)
            accepted &= ends > starts
        return ends, accepted

    ends, accepted = lie.by_blocks(at, starts, np.broadcast_to(length, starts.shape))
    return ends, accepted


def _search(along: Floats, target: Floats) -> Indices:
    """Return `along.searchsorted(target)`, looking no further than the least and the greatest."""
    if not len(target):
        return np.empty(0, dtype=np.intp)
    low, high = along.searchsorted([target.min(), target.max()])
    found: Indices = low + along[low:high].searchsorted(target)
    return found
