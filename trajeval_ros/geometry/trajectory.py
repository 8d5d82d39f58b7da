"""Trajectories as columns: stamps, positions, quaternions and optional quantities."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.dropped_counts import add_counts
from trajeval_ros.geometry.repeated_stamps import Conflicts, conflicts_of
from trajeval_ros.geometry.travelled import travelled_distance
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis
from trajeval_ros.geometry.valid_poses import LARGEST, at_length_one, judge_poses

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

    from trajeval_ros.geometry.fixes import Fixes

NANOSECONDS = 1_000_000_000
_UNIT = 1e-9  # largest error of the mean squared length of unit quaternions
# Shape of a row by column.
_COLUMNS: dict[str, tuple[int, ...]] = {
    "stamps": (),
    "frames": (),
    "matrices": (3, 3),
    "positions": (3,),
    "quaternions": (4,),
    "velocities": (3,),
    "gyroscope_biases": (3,),
    "accelerometer_biases": (3,),
    "covariances": (6, 6),
}


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory:
    """States of a moving body over time in one fixed frame; immutable.

    `from_columns` makes one from raw numbers and drops invalid poses.

    Attributes:
        stamps: (N,) int64, nanoseconds.
        positions: (N, 3), metres, of the body in the frame.
        quaternions: (N, 4), xyzw, unit, rotations from the body to the frame; None for sensors
            without orientation.
        velocities: (N, 3), m/s, in the frame, or None.
        gyroscope_biases: (N, 3), rad/s, in the body, or None.
        accelerometer_biases: (N, 3), m/s^2, in the body, or None.
        covariances: (N, 6, 6) of the pose, position first, rotation second as a rotation about
            the frame's fixed axes (`geometry_msgs/PoseWithCovariance`), or None.
        frames: (N,) int64, frame numbers in an image sequence (KITTI), or None.
        matrices: (N, 3, 3), rotation matrices exactly as in KITTI's file, or None. With few
            digits they are not quite the rotations of `quaternions`.
        fixes: The N GNSS fixes of the positions, with their datum; None for other sources.
        frame: Name of the fixed frame, "" if unknown.
        child_frame: Name of the body's frame, "" if unknown.
        up: The axis of the frame that points up, and its origin; z by default (REP-103).
        name: Its name in tables.
        source: The source, as the user names it; "" if there is none.
        unturned: Whether a topic's orientations were dropped because all are the identity. A live
            run cannot detect this before the last message.
        stamped: False if the file has no timestamps; stamps then count rows, one second apart.
        numbered: Whether the file has the numbers in `frames`; otherwise they count its rows.
        dropped: Number of dropped rows, by reason.
        notes: What the reader detected or corrected, one sentence each.
        damage: Unreadable parts of the source, one sentence each.
        conflicts: Contradictions between states, one sentence each.

    Example:
        >>> import numpy as np
        >>> from trajeval_ros import Trajectory
        >>> stamps = np.array([0, 500_000_000])
        >>> Trajectory.from_columns(stamps, [[0, 0, 0], [2, 0, 0]], [[0, 0, 0, 1], [0, 0, 0, 2]])
        <Trajectory unnamed, 2 poses, 0.5 s, 2.0 m>
    """

    stamps: NDArray[np.int64]
    positions: Floats
    quaternions: Floats | None = None
    velocities: Floats | None = None
    gyroscope_biases: Floats | None = None
    accelerometer_biases: Floats | None = None
    covariances: Floats | None = None
    frames: NDArray[np.int64] | None = None
    matrices: Floats | None = None
    fixes: Fixes | None = None
    frame: str = ""
    child_frame: str = ""
    up: UpAxis = Z_UP
    name: str = ""
    source: str = ""
    unturned: bool = False
    stamped: bool = True
    numbered: bool = False
    dropped: Mapping[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    damage: tuple[str, ...] = ()
    conflicts: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check types and shapes of the columns.

        Raises:
            TypeError: The stamps are not int64, or a column is no array.
            ValueError: A column has a wrong shape, or quaternions are not of length 1.
        """
        count = len(self.stamps)
        for name, row_shape in _COLUMNS.items():
            column = getattr(self, name)
            if column is None:
                continue
            if not isinstance(column, np.ndarray):
                raise TypeError(f"{name} must be a numpy array, not {type(column).__name__}")
            if column.shape != (count, *row_shape):
                raise ValueError(
                    f"{name} has shape {column.shape}, expected {(count, *row_shape)}"
                )
        if self.fixes is not None and len(self.fixes) != count:
            raise ValueError(
                f"{counted(len(self.fixes), 'fix', 'fixes')} for {counted(count, 'timestamp')}; "
                "give one fix per timestamp"
            )
        if self.stamps.dtype != np.int64:
            raise TypeError(f"timestamps must be int64 nanoseconds, not {self.stamps.dtype}")
        if self.quaternions is not None:
            # A check of the mean is cheap and detects NaN, zeros and rows without normalisation.
            excess = float(np.vdot(self.quaternions, self.quaternions)) - count
            if not abs(excess) <= _UNIT * count:
                raise ValueError(
                    "quaternions must have length 1; use Trajectory.from_columns to normalise them"
                )

    @classmethod
    def from_columns(
        cls,
        stamps: NDArray[np.int64],
        positions: ArrayLike,
        quaternions: ArrayLike | None = None,
        **columns: object,
    ) -> Trajectory:
        """Make a trajectory from raw numbers; invalid poses are dropped and counted.

        Args:
            stamps: (N,) int64, nanoseconds.
            positions: (N, 3), metres.
            quaternions: (N, 4), xyzw, of any length except zero; None without orientations.
            **columns: Other attributes of `Trajectory`.

        Rows with a position or quaternion that is not finite, or too large to be squared, are
        dropped as `not_finite`. Quaternions of (nearly) zero length are dropped as
        `zero_quaternion`: see `judge_poses`. If a velocity or bias is not finite, that column is
        dropped with a note. Covariances that are not finite are kept; their users check them.
        """
        position_rows = np.asarray(positions, dtype=np.float64)
        quaternion_rows: Floats | None = None
        if quaternions is not None:
            quaternion_rows = np.asarray(quaternions, dtype=np.float64)
        finite, nonzero = judge_poses(position_rows, quaternion_rows)
        keep = finite & nonzero
        dropped = {
            "not_finite": int(np.count_nonzero(~finite)),
            "zero_quaternion": int(np.count_nonzero(finite & ~nonzero)),
        }
        if not keep.all():
            stamps, position_rows = stamps[keep], position_rows[keep]
            quaternion_rows = None if quaternion_rows is None else quaternion_rows[keep]
            columns = {
                name: value[keep] if isinstance(value, np.ndarray) else value
                for name, value in columns.items()
            }
        if quaternion_rows is not None:
            quaternion_rows = at_length_one(quaternion_rows)
        trajectory = cls(stamps, position_rows, quaternion_rows, **columns)  # type: ignore[arg-type]
        return dataclasses.replace(
            trajectory, dropped=add_counts(trajectory.dropped, dropped)
        )._with_finite_columns()

    def _with_finite_columns(self) -> Trajectory:
        """Return the trajectory without columns that are not finite, with a note."""
        bad = [
            name
            for name in ("velocities", "gyroscope_biases", "accelerometer_biases")
            if (column := getattr(self, name)) is not None
            and not (np.abs(column) <= LARGEST).all()
        ]
        if not bad:
            return self
        note = f"{' and '.join(bad).replace('_', ' ')} dropped: some values are not finite"
        columns: dict[str, Any] = dict.fromkeys(bad)
        return dataclasses.replace(self, **columns, notes=(*self.notes, note))

    def __len__(self) -> int:
        """Return the number of states."""
        return len(self.stamps)

    def __repr__(self) -> str:
        """Return a summary in one line, without arrays."""
        count = len(self)
        parts = [
            self.name or "unnamed",
            f"{counted(count, 'pose')}",
            f"{self.duration_s:.1f} s",
            f"{self.path_length_m:.1f} m",
        ]
        if self.frame or self.child_frame:
            parts.append(f"{self.child_frame or '?'} in {self.frame or '?'}")
        return f"<Trajectory {', '.join(parts)}>"

    def __getitem__(self, rows: slice | NDArray[np.int64] | Booleans) -> Trajectory:
        """Return the states of a slice, a mask or an array of indices."""
        if isinstance(rows, np.ndarray) and len(rows) == len(self):
            everything = rows if rows.dtype == bool else rows == np.arange(len(self))
            if everything.all():
                return self
        picked = {
            name: column[rows]
            for name in (*_COLUMNS, "fixes")
            if (column := getattr(self, name)) is not None
        }
        return dataclasses.replace(self, **picked)

    @property
    def seconds(self) -> Floats:
        """Time since the first state, (N,), seconds."""
        since: Floats = (self.stamps - self.stamps[0]) / NANOSECONDS
        return since

    @property
    def duration_s(self) -> float:
        """Time from the earliest to the latest state, seconds."""
        return float(self.stamps.max() - self.stamps.min()) / NANOSECONDS if len(self) else 0.0

    @property
    def travelled(self) -> Floats:
        """Path length up to every state, (N,), metres."""
        return travelled_distance(self.positions)

    @property
    def path_length_m(self) -> float:
        """Length of the path through all states, metres."""
        return float(self.travelled[-1]) if len(self) else 0.0

    @property
    def kind(self) -> str:
        """The content of its source: `gnss` fixes, `points` without orientation, or `poses`."""
        if self.fixes is not None:
            return "gnss"
        return "points" if self.quaternions is None and not self.unturned else "poses"

    @property
    def rotations(self) -> Rotation | None:
        """The orientations as a scipy `Rotation` of N; imports `scipy.spatial`."""
        if self.quaternions is None:
            return None
        from scipy.spatial.transform import Rotation

        # The quaternions are unit already; normalisation would change last digits.
        return Rotation(self.quaternions, normalize=False)

    def in_order(self) -> Trajectory:
        """Return the states sorted by stamp, the first of equal stamps, with notes and counts."""
        steps = np.diff(self.stamps)
        if (steps > 0).all():
            return self
        order = np.argsort(self.stamps, kind="stable")
        first = np.concatenate([[True], np.diff(self.stamps[order]) > 0])
        conflicts = conflicts_of(self.stamps[order], self.positions[order])
        duplicates = int(np.count_nonzero(~first))
        backwards = int(np.count_nonzero(steps < 0))
        notes = list(self.notes)
        if backwards:
            notes.append(
                f"timestamps step back at {counted(backwards, 'place')}; the poses were sorted by "
                "timestamp"
            )
        ordered = self[order[first]]
        return dataclasses.replace(
            ordered,
            notes=tuple(notes),
            dropped=add_counts(self.dropped, {"duplicate_stamp": duplicates}),
            conflicts=(*self.conflicts, *self._said(conflicts, duplicates)),
        )

    def _said(self, conflicts: Conflicts, duplicates: int) -> list[str]:
        """Return the sentence about repeated timestamps with contradicting positions, if any."""
        if not conflicts.number:
            return []
        return [
            f"{self.name or 'the trajectory'} has "
            f"{counted(conflicts.number, 'repeated timestamp')} (of {duplicates}) with "
            f"different positions, up to {conflicts.largest_m:.3g} m apart; the first pose of a "
            "timestamp is used, remove the wrong rows"
        ]

    def require_usable(self) -> None:
        """Check that there are states and that all are finite.

        Raises:
            InputError: There is no state, or one is not finite; `from_columns` drops such rows.
        """
        name = self.name or "the trajectory"
        if not len(self):
            why = ", ".join(f"{count} {reason}" for reason, count in self.dropped.items())
            raise InputError(f"no usable pose in {name}" + (f" (dropped: {why})" if why else ""))
        if not judge_poses(self.positions)[0].all():
            raise InputError(
                f"{name} has positions that are not finite or beyond {LARGEST:g} m; remove these "
                "states"
            )
