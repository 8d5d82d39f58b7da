"""Relative errors and drift for all lengths of a protocol: eq. (25) to (27) of the tutorial.

Drift is the relative error per length of the sub-trajectories: position in percent of the length,
rotation in degrees per metre (tutorial, section IV-B; KITTI).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.travelled import rotation_angle
from trajeval_ros.metrics.alignment import Alignment
from trajeval_ros.metrics.association import Association
from trajeval_ros.metrics.other_programs import distance_errors, pose_errors
from trajeval_ros.metrics.premises import Doubts
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.relative_errors import RelativeErrors, relative_errors
from trajeval_ros.metrics.statistics import Statistics, statistics_in_place, statistics_of
from trajeval_ros.metrics.sub_trajectories import (
    Length,
    select,
    select_frames,
    select_states,
    select_turns,
)

PERCENT = 100.0
# Error to the name of its drift, and to the drift's units per error and metre.
PER_LENGTH = {
    "position_m": ("position_percent", PERCENT),
    "rotation_deg": ("rotation_deg_per_m", 1.0),
}


@dataclass(frozen=True)
class Drift:
    """The drift of an estimate over sub-trajectories of one length."""

    percent: Statistics  # statistics of the position error in percent of the length
    length_m: float  # the length, metres


def position_percent(errors_m: Floats, length_m: float) -> Floats:
    """Return position errors (K,), metres, in percent of the sub-trajectory length."""
    percent: Floats = errors_m * (PERCENT / length_m)
    return percent


def statistics_per_length(
    position: Statistics | None, rotation: Statistics | None, length_m: float | None
) -> dict[str, Statistics | None]:
    """Return the statistics of drift by metric, from those of errors in metres and degrees.

    They are None without errors, or if the length is not in metres.
    """
    percent = per_metre = None
    if length_m is not None and position is not None:
        percent = position.scaled(PERCENT / length_m)
        per_metre = None if rotation is None else rotation.scaled(1.0 / length_m)
    return {"position_percent": percent, "rotation_deg_per_m": per_metre}


class PooledDrift:
    """Drift over sub-trajectories of several lengths together, as in the KITTI ranking."""

    def __init__(self, most: int) -> None:
        """Create it empty, with space for `most` sub-trajectories."""
        self._shares = {name: np.empty(most) for name in PER_LENGTH}
        self._counts = dict.fromkeys(PER_LENGTH, 0)

    def add(self, errors: RelativeErrors, length_m: float) -> None:
        """Add the relative errors of sub-trajectories of a length, metres."""
        for name, (_, units) in PER_LENGTH.items():
            column = getattr(errors, name)
            if column is not None:
                end = self._counts[name] + len(column)
                np.multiply(
                    column, units / length_m, out=self._shares[name][self._counts[name] : end]
                )
                self._counts[name] = end

    def statistics(self) -> dict[str, Statistics | None]:
        """Return the statistics by metric, None without errors, and release the memory."""
        return {
            share: statistics_in_place(self._shares.pop(name)[: self._counts[name]])
            for name, (share, _) in PER_LENGTH.items()
        }


_MOST_HELD = 100_000  # sub-trajectories of a length that are kept in memory, 5 MB


@dataclass(frozen=True, eq=False, repr=False)
class SubTrajectoryErrors:
    """The relative errors of all sub-trajectories of one length."""

    length: Length
    length_m: float | None  # the length in metres; None if it is no distance
    mean_length_m: float | None  # mean true length of the sub-trajectories; None if there are none
    count: int  # K, the number of sub-trajectories
    worst_start: int | None  # pair at the start of the largest position error; None if K is 0
    measure: Callable[[], RelativeErrors]  # function that computes the errors
    # The errors; None for long runs, where they would take most of the memory.
    held: RelativeErrors | None
    # Statistics by metric; None if a metric is not available.
    statistics: dict[str, Statistics | None]

    @cached_property
    def errors(self) -> RelativeErrors:
        """Errors of the K sub-trajectories; computed again for long runs."""
        return self.held or self.measure()

    @property
    def duration_s(self) -> float | None:
        """The length in seconds; None if it is no duration."""
        return self.length.value if self.length.unit == "s" else None

    @property
    def frames(self) -> int | None:
        """The length in frames; None if it is no number of frames."""
        return int(self.length.value) if self.length.unit == "f" else None

    @property
    def turn_deg(self) -> float | None:
        """The length in degrees; None if it is no rotation."""
        return float(np.degrees(self.length.radians)) if self.length.turns else None

    def __repr__(self) -> str:
        return f"<SubTrajectoryErrors of {self.length}: {rmse_text(self.statistics)}>"


def rmse_text(statistics: dict[str, Statistics | None]) -> str:
    """Return the RMSE of position and rotation as a text."""
    position, rotation = statistics["position_m"], statistics["rotation_deg"]
    parts = ["none" if position is None else f"{position.rmse:.4g} m"]
    if rotation is not None:
        parts.append(f"{rotation.rmse:.4g} deg")
    return " ".join(parts)


def relative_evaluation(
    pairs: Association,
    groundtruth: Trajectory,
    alignment: Alignment,
    protocol: Protocol,
    doubts: Doubts,
) -> tuple[tuple[SubTrajectoryErrors, ...] | None, dict[str, Statistics | None]]:
    """Compute the errors of eq. (27) for all sub-trajectories of all lengths of a protocol.

    Sub-trajectories use the scale of the pairs' alignment. The errors are None without lengths, or
    if their positions are withheld. The second value has statistics of
    the drift over all lengths in metres.
    """
    if not protocol.lengths or doubts.about(RelativeErrors, "position_m"):
        return None, PooledDrift(0).statistics()
    scale = alignment.similarity.scale
    along = _Measure(pairs, groundtruth, protocol, scale)
    travelled = along.travelled_by_pairs
    in_metres = sum(length.in_metres for length in protocol.lengths)
    pooled = PooledDrift(in_metres * len(pairs))
    of_lengths = []
    for length in protocol.lengths:
        measure = partial(_errors, pairs, protocol, along, length, scale, doubts)
        errors = measure()
        starts, ends = errors.starts, errors.ends
        length_m = along.metres(length) if length.in_metres else None
        if length_m:
            pooled.add(errors, length_m)
        statistics = _statistics(errors, length_m)
        if protocol.re_form == "evo":
            positions = pairs.groundtruth.positions, pairs.estimate.positions
            statistics |= pose_errors(errors.position_m, errors.rotation_deg)
            statistics |= distance_errors(*positions, starts, ends, scale)
        of_lengths.append(
            SubTrajectoryErrors(
                length=length,
                length_m=length_m,
                mean_length_m=float(np.mean(travelled[ends] - travelled[starts]))
                if len(ends)
                else None,
                count=len(ends),
                worst_start=int(starts[np.argmax(errors.position_m)]) if len(ends) else None,
                measure=measure,
                held=errors if len(ends) <= _MOST_HELD else None,
                statistics=statistics,
            )
        )
        del errors, starts, ends  # frees their memory before the next length
    return tuple(of_lengths), pooled.statistics()


def _errors(
    pairs: Association,
    protocol: Protocol,
    along: _Measure,
    length: Length,
    scale: float,
    doubts: Doubts,
) -> RelativeErrors:
    """Return the errors of all sub-trajectories of a length."""
    sides = pairs.groundtruth, pairs.estimate
    chosen = along.select(length)
    errors = relative_errors(*sides, *chosen, protocol.gauge, scale, protocol.re_form)
    return doubts.without(errors)


class _Measure:
    """Measures lengths along one side: by path, time, number of states and rotation."""

    def __init__(
        self, pairs: Association, groundtruth: Trajectory, protocol: Protocol, scale: float
    ) -> None:
        self._pairs, self._groundtruth = pairs, groundtruth
        self._selection = protocol.selection
        # The devkit measures the path through all frames, including those without an estimate.
        self._by_frame = self._selection.rule == "first-past" and pairs.rule.method == "index"
        if self._by_frame:
            self._states, self._scale = groundtruth, 1.0
        elif self._selection.path == "estimate":
            self._states, self._scale = pairs.estimate, scale
        else:
            self._states, self._scale = pairs.groundtruth, 1.0

    @cached_property
    def _travelled(self) -> Floats:
        """Path up to every state that lengths are measured along, metres."""
        return self._scale * self._states.travelled

    @property
    def travelled_by_pairs(self) -> Floats:
        """The groundtruth's path up to every pair, (N,), metres."""
        if self._by_frame:
            return self._travelled[self._pairs.groundtruth_rows]
        if self._states is self._pairs.groundtruth:
            return self._travelled
        return self._pairs.groundtruth.travelled

    def metres(self, length: Length) -> float:
        """Return a length in metres; the toolbox's percentages are of all groundtruth, in cm."""
        if length.unit != "%":
            return float(length.value)
        if self._selection.rule == "toolbox":
            share = length.value / 100.0 * self._groundtruth.path_length_m
            return float(np.trunc(100.0 * share) / 100.0)
        whole_m = self.travelled_by_pairs[-1] if self._by_frame else self._travelled[-1]
        return float(length.value / 100.0 * whole_m)

    def select(self, length: Length) -> tuple[Indices, Indices]:
        """Return the starts and ends (K,) of sub-trajectories, as indices of pairs."""
        if self._by_frame:
            return self._select_frames(length)
        if length.unit == "f":
            return select_states(len(self._pairs), int(length.value), self._selection)
        if length.turns and self._selection.compares_rotations:
            quaternions = self._states.quaternions
            assert quaternions is not None
            return select_turns(quaternions, length.radians, self._selection.tolerance)
        return select(self._along(length), self._value(length), self._selection)

    def _select_frames(self, length: Length) -> tuple[Indices, Indices]:
        frames, paired = self._groundtruth.reading.frame_numbers, self._pairs.groundtruth_rows
        assert paired is not None
        numbers = np.arange(len(self._groundtruth)) if frames is None else frames
        if length.unit == "f":
            # The first frame beyond `value - 0.5` has that number, or is the next one.
            along, value = numbers.astype(float), length.value - 0.5
        else:
            along, value = self._along(length), self._value(length)
        return select_frames(along, numbers, paired, value, self._selection)

    def _value(self, length: Length) -> float:
        """Return a length in metres, nanoseconds or radians."""
        if length.turns:
            return length.radians
        return length.value * NANOSECONDS if length.unit == "s" else self.metres(length)

    def _along(self, length: Length) -> Floats:
        """Return path (m), time (ns) or rotation (rad) up to every state, by the length's unit.

        Nanoseconds are exact in float64: rounding decides no end at the limit of a tolerance.
        """
        states = self._states
        if length.unit == "s":
            stamps = (states if self._by_frame else self._pairs.groundtruth).stamps
            if (np.diff(stamps) < 0).any():
                raise InputError(
                    "the pairs are not in order of time, which lengths in seconds need; use "
                    "protocol default, which sorts them, or lengths in metres"
                )
            since: Floats = (stamps - stamps[0]).astype(np.float64)
            return since
        if length.turns:
            assert states.quaternions is not None
            return rotation_angle(states.quaternions)
        return self._travelled


def _statistics(errors: RelativeErrors, length_m: float | None) -> dict[str, Statistics | None]:
    position, rotation = statistics_of(errors.position_m), statistics_of(errors.rotation_deg)
    per_length = statistics_per_length(position, rotation, length_m)
    return {
        "position_m": position,
        "position_percent": per_length["position_percent"],
        "rotation_deg": rotation,
        "rotation_deg_per_m": per_length["rotation_deg_per_m"],
        "yaw_deg": statistics_of(errors.yaw_deg),
        "tilt_deg": statistics_of(errors.tilt_deg),
        "velocity_mps": statistics_of(errors.velocity_mps),
    }
