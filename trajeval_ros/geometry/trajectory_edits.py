"""Edits of trajectories: time spans, thinning, merging, projection on a plane."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from typing import Any

import numpy as np

from trajeval_ros.exceptions import InputError, SettingsError, require_one_of
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import note, warning
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Indices, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.valid_poses import add_counts

_LATEST_S = 4_000_000_000  # the sum of two still fits int64 nanoseconds


@dataclass(frozen=True)
class TimeSpan:
    """A period of time, both ends included."""

    # Nanoseconds after the first timestamp, or a timestamp; None for the first state.
    start_ns: int | None = None
    end_ns: int | None = None  # likewise; None for the last state
    absolute_start: bool = False  # whether `start_ns` is a timestamp
    absolute_end: bool = False  # whether `end_ns` is a timestamp

    @classmethod
    def parse(cls, start: str | None, end: str | None) -> TimeSpan | None:
        """Parse "10" (seconds after the first timestamp), "@1403636580.5" or, as an end, "+30".

        `start`: None for the first state; "@..." is a timestamp. `end`: None for the last state;
        "+30" is 30 seconds after the start.

        Returns:
            None if both are None.
        """
        if start is None and end is None:
            return None
        start_ns, absolute_start = (None, False) if start is None else _time(start, "start")
        if end is None:
            return cls(start_ns, None, absolute_start)
        end_ns, absolute_end = _time(end, "end")
        if end.strip().startswith("+"):
            end_ns, absolute_end = end_ns + (start_ns or 0), absolute_start
        if start_ns is not None and absolute_start is absolute_end and end_ns < start_ns:
            raise SettingsError(f"end {end} is before start {start}")
        return cls(start_ns, end_ns, absolute_start, absolute_end)

    def stamps(self, first_ns: int) -> tuple[int | None, int | None]:
        """Return the first and the last timestamp, None for an open end.

        `first_ns`: the timestamp that relative times count from.
        """
        start, end = self.start_ns, self.end_ns
        if start is not None and not self.absolute_start:
            start += first_ns
        if end is not None and not self.absolute_end:
            end += first_ns
        return start, end

    def cut(self, trajectory: Trajectory, first_ns: int, offset_ns: int = 0) -> Trajectory:
        """Return the states in the time span.

        `first_ns`: the timestamp that relative times count from. `offset_ns`: added to the
        trajectory's timestamps for the comparison only.
        """
        if not trajectory.reading.stamped:
            raise InputError("no timestamps, which a time span needs")
        start, end = self.stamps(first_ns)
        stamps = trajectory.stamps
        inside = stamps == stamps
        if start is not None:
            inside &= stamps >= start - offset_ns
        if end is not None:
            inside &= stamps <= end - offset_ns
        if not inside.any():
            raise InputError(
                f"no pose in the time span: its timestamps are from {_seconds(stamps.min())} to "
                f"{_seconds(stamps.max())} s"
            )
        return trajectory[inside]


def _time(text: str, what: str) -> tuple[int, bool]:
    """Return a time in nanoseconds, and whether it is a timestamp."""
    absolute = text.strip().startswith("@")
    try:
        seconds = Decimal(text.strip().removeprefix("@"))
    except InvalidOperation:
        seconds = Decimal("nan")
    if not (seconds.is_finite() and abs(seconds) < _LATEST_S) or (seconds < 0 and not absolute):
        raise SettingsError(
            f"{what} {text!r} is not valid; give seconds after the first timestamp, as in 10.5, "
            "a timestamp in seconds, as in @1403636580.5"
            + (", or seconds after the start, as in +30" if what == "end" else "")
        )
    return round(seconds * NANOSECONDS), absolute


def _seconds(stamp: int) -> str:
    return f"{Decimal(int(stamp)) / NANOSECONDS:.3f}"


_FIRST_LOOK = 16  # states that are compared at once


def evenly(count: int, selected: int) -> Indices:
    """Return `selected` of `count` rows, evenly spread, including the first and the last."""
    if selected >= count:
        return np.arange(count)
    return np.round(np.linspace(0, count - 1, selected)).astype(np.int64)


def every_nth(count: int, most: int) -> slice:
    """Return the slice of every n-th of `count` rows, with the least n for at most `most`."""
    return slice(None, None, max(1, -(-count // most)))


def at_rate(stamps: Stamps, rate_hz: float) -> Indices:
    """Return the first row at or after every tick of a clock that starts with the first stamp.

    `stamps`: (N,) nanoseconds, increasing.
    """
    # Long doubles are exact to a nanosecond over years.
    since = (stamps - stamps[0]).astype(np.longdouble)
    ticks = np.floor(since * rate_hz / NANOSECONDS).astype(np.int64)
    return np.flatnonzero(np.diff(ticks, prepend=-1) > 0)


def by_motion(trajectory: Trajectory, distance_m: float, angle_rad: float) -> Indices:
    """Return the first row, and every row at a given distance or angle from the previous kept one.

    Unlike the length of the path, this measure does not accumulate noise of a body at rest.
    `trajectory`: N states; without orientations only the distance is used. `distance_m`: least
    distance between kept states, metres. `angle_rad`: least angle between their orientations, rad;
    one of the two is sufficient.
    """
    positions, quaternions = trajectory.positions, trajectory.quaternions
    count = len(positions)
    kept, at, look = [0], 1, _FIRST_LOOK
    # One iteration per kept state or block, with a vectorised search for the next one.
    while at < count:
        last, ahead = kept[-1], slice(at, at + look)
        steps = positions[ahead] - positions[last]
        enough = np.einsum("ni,ni->n", steps, steps) >= distance_m**2
        if quaternions is not None:
            rotations = lie.multiply(lie.conjugate(quaternions[last]), quaternions[ahead])
            enough |= lie.angle(rotations) >= angle_rad
        first = int(enough.argmax())
        if enough[first]:
            look = max(_FIRST_LOOK, 2 * (at + first - last))
            kept.append(at + first)
            at = kept[-1] + 1
        else:
            at, look = at + len(enough), 2 * look
    return np.array(kept)


_ROWS = (
    "positions", "quaternions", "velocities", "gyroscope_biases", "accelerometer_biases",
    "covariances",
)  # fmt: skip


def merged(parts: Sequence[Trajectory]) -> Trajectory:
    """Return all states in order of time, with the columns that all parts have.

    `parts`: trajectories in one frame, with timestamps. Of equal timestamps, the state of the
    first part is kept.
    """
    first = parts[0]
    for part in parts:
        if not part.reading.stamped:
            raise InputError(f"{part.name} has no timestamps, which --merge needs")
        for word in ("frame", "child_frame"):
            one, other = getattr(first, word), getattr(part, word)
            if one and other and one != other:
                raise InputError(
                    f"{first.name} and {part.name} can't be merged: their {word} differs, {one} "
                    f"and {other}"
                )
        if part.up.name != first.up.name:
            raise InputError(
                f"{first.name} and {part.name} can't be merged: the vertical axis is {first.up} "
                f"in one and {part.up} in the other; convert one with --world-axes first"
            )
    columns: dict[str, Any] = {}
    for name in _ROWS:
        available = [column for part in parts if (column := getattr(part, name)) is not None]
        columns[name] = np.concatenate(available) if len(available) == len(parts) else None
    stamps = np.concatenate([part.stamps for part in parts])
    remarks = [note("merged", f"merged from {', '.join(part.name for part in parts)}")]
    repeated = len(stamps) - len(np.unique(stamps))
    if repeated:
        remarks.append(
            warning(
                "merged_duplicates",
                f"{repeated} of {counted(len(stamps), 'pose')} dropped: an earlier source has a "
                "pose with the same timestamp; merge only parts of one trajectory",
            )
        )
    return dataclasses.replace(
        first,
        stamps=stamps,
        reading=dataclasses.replace(
            first.reading.without(),
            dropped=add_counts(*(part.reading.dropped for part in parts)),
            remarks=(
                *remarks,
                *dict.fromkeys(remark for part in parts for remark in part.reading.remarks),
            ),
        ),
        **columns,
    ).in_order()


PLANES = {"xy": 2, "xz": 1, "yz": 0}  # and the index of the normal axis


def flattened(trajectory: Trajectory, plane: str) -> Trajectory:
    """Return positions and velocities in a plane, and rotations about its normal.

    A rotation is replaced by its twist about the normal. A rotation by pi about an axis in the
    plane has none and becomes the identity. Covariances are dropped. `trajectory`: in any frame.
    """
    require_one_of(plane, PLANES, "plane")
    normal = PLANES[plane]
    flat = np.ones(3)
    flat[normal] = 0.0
    quaternions, velocities = trajectory.quaternions, trajectory.velocities
    if quaternions is not None:
        # The normal takes the place of z.
        places = [*(axis for axis in range(3) if axis != normal), normal, 3]
        rotations = np.empty_like(quaternions)
        rotations[:, places] = lie.normalized(lie.heading(quaternions[:, places]))
        quaternions = rotations
    return dataclasses.replace(
        trajectory,
        positions=trajectory.positions * flat,
        quaternions=quaternions,
        velocities=None if velocities is None else velocities * flat,
        covariances=None,
        reading=trajectory.reading.without("matrices"),
    )
