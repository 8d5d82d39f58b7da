"""Sub-trajectories: pairs of states (start, end) that are a given length apart.

Tutorial, section IV-B, eq. (25). Lengths are measured along the path through the paired positions,
in time, in states, or by the rotation of the body. A selection takes O(N log N), except for evo's
pairs by rotation, where all orientations are compared, O(N^2).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

import numpy as np

from trajeval_ros.exceptions import SettingsError, require_one_of
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices

UNITS = ("m", "s", "%", "f", "deg", "rad")


_EXAMPLES = "8 or 8m (metres), 1s (seconds), 10f (frames), 5deg or 0.1rad (of rotation) or 10%"


@dataclass(frozen=True)
class Length:
    """The length of sub-trajectories.

    Attributes:
        value: The number in its unit.
        unit: `m`, of the path; `s`; `%`, of the whole path; `f`, frames, which are paired states;
            `deg` or `rad`, of rotation.

    Raises:
        SettingsError: An unknown unit, or a value that is not positive.

    Example:
        >>> from trajeval_ros import Length
        >>> Length(8, "m") == Length.of(8) == Length.parse("8m")
        True
    """

    value: float
    unit: str

    def __post_init__(self) -> None:
        if self.unit not in UNITS:
            raise SettingsError(
                f"the unit of a length must be one of {', '.join(UNITS)}, not {self.unit!r}"
            )
        if not (np.isfinite(self.value) and self.value > 0.0):
            raise SettingsError(f"a length must be positive, not {self.text}")
        if self.unit == "f" and self.value != round(self.value):
            raise SettingsError(f"a length in frames must be a whole number, not {self.value:g}f")

    @property
    def in_metres(self) -> bool:
        """Whether it is a distance, so that drift is defined."""
        return self.unit in ("m", "%")

    @property
    def turns(self) -> bool:
        """Whether it is a rotation."""
        return self.unit in ("deg", "rad")

    @property
    def radians(self) -> float:
        """The rotation in radians; only for `deg` and `rad`."""
        return float(np.radians(self.value)) if self.unit == "deg" else self.value

    @property
    def text(self) -> str:
        """The length as text for readers: 8 m, 1 s, 10 %, 1 frame, 5 deg."""
        unit = self.unit
        if unit == "f":
            unit = "frame" if self.value == 1.0 else "frames"
        return f"{self.value:g} {unit}"

    @classmethod
    def parse(cls, text: str) -> Length:
        """Parse "8", "8m", "1s", "10f", "5deg", "0.1rad" or "10%"."""
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
        """Return a length from metres, a text or a length.

        Raises:
            SettingsError: The value is not valid.
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
        return f"{self.value:g}{self.unit}"


def parse_lengths(text: str) -> tuple[Length, ...]:
    """Parse "8,16,24", "1s,5s", "1f,10f", "5deg", "10%,20%" or "none"."""
    if text.strip() == "none":
        return ()
    lengths = tuple(Length.parse(part) for part in text.split(","))
    if len(set(lengths)) < len(lengths):
        raise SettingsError(f"a length is given twice in {text!r}; remove one")
    return lengths


RULES = ("nearest", "toolbox", "first-past", "evo")
PAIRS = ("all", "consecutive")
PATHS = ("groundtruth", "estimate")


@dataclass(frozen=True)
class Selection:
    """The rule for the starts and ends of sub-trajectories.

    Lengths in frames are exact for all rules.
    """

    # `nearest`: the state nearest to the length, within 1 % of it or half the local spacing of
    # states, whichever is larger, but at most 20 %. `toolbox`: the nearest within 20 %, as in
    # rpg_trajectory_evaluation. `first-past`: the first state beyond the length, as in the KITTI
    # devkit. `evo`: as evo_rpe. For consecutive pairs the first state at or beyond the length; for
    # all pairs the nearest within the tolerance; for rotations every pair of states whose
    # orientations differ by the length, within the tolerance.
    rule: str = "nearest"
    every: int = 1  # use every n-th state as a start
    # `all`: all starts. `consecutive`: a sub-trajectory starts where the previous ends.
    pairs: str = "all"
    # The side along which positions and rotations are measured: `groundtruth`, or `estimate` with
    # the alignment's scale.
    path: str = "groundtruth"
    # Largest relative deviation from the length, for rule `evo` with all pairs.
    tolerance: float = 0.1

    def __post_init__(self) -> None:
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
        """Return the settings that determine the sub-trajectories, as a short text."""
        parts = [self.rule, f"every {self.every}"]
        parts += [self.pairs] if self.is_consecutive else []
        parts += ["along the estimate"] if self.path == "estimate" else []
        parts += [f"within {self.tolerance:g}"] if self.compares_rotations else []
        return ", ".join(parts)

    @property
    def is_consecutive(self) -> bool:
        """Whether a sub-trajectory starts where the previous one ends."""
        return self.pairs == "consecutive"

    @property
    def compares_rotations(self) -> bool:
        """Whether rotations are measured between any two states, not along the path."""
        return self.rule == "evo" and not self.is_consecutive


LARGEST_DEVIATION = 0.2  # relative deviation from the length, rules `nearest` and `toolbox`
TOLERANCE = 0.01  # relative deviation that rule `nearest` always accepts
_TURN_BLOCK = 256  # states whose orientations are compared with all others at a time


def select(along: Floats, length: float, selection: Selection) -> tuple[Indices, Indices]:
    """Return the starts and ends (K,) of all sub-trajectories of a length, eq. (25).

    `along` (N,) is the path (m), time (ns) or rotation (rad) up to every state, not decreasing.
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
        # Usually only the last starts are rejected: slices need no copy.
        return _used(starts[:count], ends[:count], selection)
    return _used(starts[accepted], ends[accepted], selection)


def select_states(count: int, length: int, selection: Selection) -> tuple[Indices, Indices]:
    """Return the starts and ends (K,) of sub-trajectories of `length` steps between N states."""
    starts = np.arange(0, max(count - length, 0), selection.every)
    return _used(starts, starts + length, selection)


def select_turns(quaternions: Floats, angle: float, tolerance: float) -> tuple[Indices, Indices]:
    """Return the starts and ends (K,) of all pairs of states with a given relative rotation, rad.

    Orientations are (N, 4) xyzw; the angle is at most pi, its tolerance is relative.
    """
    least, most = (1.0 - tolerance) * angle, min((1.0 + tolerance) * angle, np.pi)
    # |q_i . q_j| is the cosine of half the angle between two orientations.
    high, low = np.cos(least / 2.0), np.cos(most / 2.0)
    blocks: list[tuple[Indices, Indices]] = []
    for begin in range(0, len(quaternions), _TURN_BLOCK):
        block = quaternions[begin : begin + _TURN_BLOCK]
        cosine = np.abs(block @ quaternions[begin:].T)
        starts, ends = np.nonzero(np.triu((cosine <= high) & (cosine >= low), 1))
        blocks.append((starts + begin, ends + begin))
    starts, ends = np.hstack(blocks)
    return starts, ends


def _used(starts: Indices, ends: Indices, selection: Selection) -> tuple[Indices, Indices]:
    """Return all sub-trajectories, or only consecutive ones, as selected."""
    if not selection.is_consecutive or not len(starts):
        return starts, ends
    # States that start no sub-trajectory are skipped; sub-trajectories of length 0 are removed.
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
    """Return the starts and ends (K,) of the KITTI devkit, if frames may be missing.

    Starts are frames whose number is a multiple of `selection.every`. The end is the first
    groundtruth frame beyond the length. Sub-trajectories without an estimate at the start or the
    end are left out. `along` and `frames` (M,) are path and numbers of all groundtruth frames;
    starts and ends are indices of `paired` (N,), the frames in a pair.
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
    """Return the state nearest to the length for K starts, and whether it is accepted (K,).

    The length is one number or (K,). The rule is `nearest`, `toolbox`, or `evo` with the largest
    relative deviation `share`.
    """

    def at(starts: Indices, length: Floats) -> tuple[Indices, Booleans]:
        target = along[starts] + length
        within = np.minimum(_search(along, target), len(along) - 1)
        before = np.maximum(within - 1, starts)
        reached, missed = along[within], along[before]
        # Of several states at the same place (a robot at rest), the first one is the end.
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
            # The decision must not depend on rounding of the running sum.
            accepted = deviation <= tolerance * (1.0 + 1e-9)
            accepted &= ends > starts
        return ends, accepted

    ends, accepted = lie.by_blocks(at, starts, np.broadcast_to(length, starts.shape))
    return ends, accepted


def _search(along: Floats, target: Floats) -> Indices:
    """Return `along.searchsorted(target)`, restricted to the range of the targets."""
    if not len(target):
        return np.empty(0, dtype=np.intp)
    low, high = along.searchsorted([target.min(), target.max()])
    places: Indices = low + along[low:high].searchsorted(target)
    return places
