"""Trajectories as columns: stamps, positions, quaternions and optional quantities."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import note, warning
from trajeval_ros.geometry.array_input import (
    columns_of_frame,
    numbers,
    require_shape,
    split_matrices,
    stamps_of,
)
from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps, at_rows
from trajeval_ros.geometry.interpolation import Bracket, bracket_stamps, mix, slerp
from trajeval_ros.geometry.source_info import NOT_READ, SourceInfo, require_column
from trajeval_ros.geometry.travelled import travelled_distance
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis
from trajeval_ros.geometry.valid_poses import LARGEST, at_length_one, conflicts_of, valid_mask

if TYPE_CHECKING:
    import pandas
    from scipy.spatial.transform import Rotation

NANOSECONDS = 1_000_000_000
_UNIT = 1e-9  # largest error of the mean squared length of unit quaternions
# Shape of a row by column.
_COLUMNS: dict[str, tuple[int, ...]] = {
    "stamps": (),
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

    `from_columns` makes one from raw numbers and drops invalid poses. Columns are stored as
    contiguous arrays: `numpy.take` copies a strided array completely for every block of rows.

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
        frame: Name of the fixed frame, "" if unknown.
        child_frame: Name of the body's frame, "" if unknown.
        up: The axis of the frame that points up, and its origin; z by default (REP-103).
        name: Its name in tables.
        reading: How it was read: source, remarks, counts, and data of special sources by row.

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
    frame: str = ""
    child_frame: str = ""
    up: UpAxis = Z_UP
    name: str = ""
    reading: SourceInfo = NOT_READ

    def __post_init__(self) -> None:
        """Check types and shapes of the columns.

        Raises:
            TypeError: The stamps are not int64, or a column is no array.
            ValueError: A column has a wrong shape, or quaternions are not of length 1.
        """
        count = len(self.stamps)
        for name, row_shape in _COLUMNS.items():
            column = getattr(self, name)
            if column is not None:
                require_column(name, column, (count, *row_shape))
                if not column.flags.c_contiguous:
                    object.__setattr__(self, name, np.ascontiguousarray(column))
        self.reading.require_rows(count)
        if self.stamps.dtype != np.int64:
            raise TypeError(f"timestamps must be int64 nanoseconds, not {self.stamps.dtype}")
        if self.quaternions is not None:
            # A check of the mean is cheap and detects NaN, zeros and rows without normalisation.
            # The dot product of BLAS may start threads, which spin until the next call.
            excess = float(np.einsum("ni,ni->", self.quaternions, self.quaternions)) - count
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
        reading: SourceInfo = NOT_READ,
        **columns: object,
    ) -> Trajectory:
        """Make a trajectory from raw numbers; invalid poses are dropped and counted.

        Args:
            stamps: (N,) int64, nanoseconds.
            positions: (N, 3), metres.
            quaternions: (N, 4), xyzw, of any length except zero; None without orientations.
            reading: How the N rows were read.
            **columns: Other attributes of `Trajectory`.

        Rows with a position or quaternion that is not finite, or too large to be squared, are
        dropped as `not_finite`. Quaternions of (nearly) zero length are dropped as
        `zero_quaternion`: see `valid_mask`. If a velocity or bias is not finite, that column is
        dropped with a remark. Covariances that are not finite are kept; their users check them.
        """
        position_rows = np.asarray(positions, dtype=np.float64)
        require_shape(position_rows, "positions", (len(stamps), 3))
        quaternion_rows: Floats | None = None
        if quaternions is not None:
            quaternion_rows = np.asarray(quaternions, dtype=np.float64)
            require_shape(quaternion_rows, "quaternions", (len(stamps), 4))
        finite, nonzero = valid_mask(position_rows, quaternion_rows)
        keep = finite & nonzero
        dropped = {
            "not_finite": int(np.count_nonzero(~finite)),
            "zero_quaternion": int(np.count_nonzero(finite & ~nonzero)),
        }
        if not keep.all():
            stamps, position_rows = stamps[keep], position_rows[keep]
            quaternion_rows = None if quaternion_rows is None else quaternion_rows[keep]
            reading = reading[keep]
            columns = {
                name: value[keep] if isinstance(value, np.ndarray) else value
                for name, value in columns.items()
            }
        if quaternion_rows is not None:
            quaternion_rows = at_length_one(quaternion_rows)
        columns["reading"] = reading.with_dropped(dropped)
        trajectory = cls(stamps, position_rows, quaternion_rows, **columns)  # type: ignore[arg-type]
        return trajectory._with_finite_columns()

    @classmethod
    def from_positions(
        cls,
        positions: ArrayLike,
        quaternions: ArrayLike | None = None,
        *,
        seconds: ArrayLike | None = None,
        stamps: ArrayLike | None = None,
        wxyz: bool = False,
        **columns: object,
    ) -> Trajectory:
        """Make a trajectory from arrays; invalid poses are dropped as by `from_columns`.

        Args:
            positions: (N, 3), metres.
            quaternions: (N, 4), of any length except zero; None without orientations.
            seconds: (N,), times in seconds. Without times, rows are paired by their index.
            stamps: (N,), integer nanoseconds, instead of `seconds`.
            wxyz: Whether w is the first number of a quaternion; by default it is the last.
            **columns: Other attributes of `Trajectory`, such as `name`.

        Raises:
            InputError: A shape or a unit is wrong.

        Example:
            >>> from trajeval_ros import Trajectory
            >>> Trajectory.from_positions([[0, 0, 0], [2, 0, 0]], seconds=[0.0, 0.5], name="vio")
            <Trajectory vio, 2 poses, 0.5 s, 2.0 m>
        """
        places = numbers(positions, "positions")
        require_shape(places, "positions", (None, 3))
        rotations = None if quaternions is None else numbers(quaternions, "quaternions")
        if rotations is not None:
            require_shape(rotations, "quaternions", (len(places), 4))
            rotations = np.roll(rotations, -1, axis=1) if wxyz else rotations
        times = stamps_of(seconds, stamps, len(places))
        reading = NOT_READ
        if times is None:
            rows = np.arange(len(places))
            times, reading = rows * NANOSECONDS, SourceInfo(stamped=False, frame_numbers=rows)
        return cls.from_columns(times, places, rotations, reading, **columns)

    @classmethod
    def from_matrices(
        cls,
        matrices: ArrayLike,
        *,
        seconds: ArrayLike | None = None,
        stamps: ArrayLike | None = None,
        **columns: Any,
    ) -> Trajectory:
        """Make a trajectory from pose matrices [R t], of the body in the fixed frame.

        Args:
            matrices: (N, 4, 4) or (N, 3, 4), metres.
            seconds: (N,), times in seconds. Without times, rows are paired by their index.
            stamps: (N,), integer nanoseconds, instead of `seconds`.
            **columns: Other attributes of `Trajectory`, such as `name`.

        Raises:
            InputError: A shape or a unit is wrong, or a matrix is not a pose.

        Example:
            >>> import numpy as np
            >>> from trajeval_ros import Trajectory
            >>> Trajectory.from_matrices(np.tile(np.eye(4), (3, 1, 1)), seconds=[0.0, 0.1, 0.2])
            <Trajectory unnamed, 3 poses, 0.2 s, 0.0 m>
        """
        places, rotations = split_matrices(matrices)
        return cls.from_positions(places, rotations, seconds=seconds, stamps=stamps, **columns)

    @classmethod
    def from_pandas(cls, frame: pandas.DataFrame, **columns: Any) -> Trajectory:
        """Make a trajectory from a table with columns x, y, z and, optionally, qx, qy, qz, qw.

        Args:
            frame: The table. Times are in a column `seconds`, `stamps`, `time`, `timestamp` or
                `t`, otherwise in the index: float seconds, integer nanoseconds, or dates.
            **columns: Other attributes of `Trajectory`, such as `name`.

        Raises:
            InputError: A column is missing, or has a wrong unit.
        """
        given: dict[str, Any] = {**columns_of_frame(frame), **columns}
        return cls.from_positions(**given)

    def _with_finite_columns(self) -> Trajectory:
        """Return the trajectory without columns that are not finite, with a remark."""
        bad = [
            name
            for name in ("velocities", "gyroscope_biases", "accelerometer_biases")
            if (column := getattr(self, name)) is not None
            and not (np.abs(column) <= LARGEST).all()
        ]
        if not bad:
            return self
        sentence = f"{' and '.join(bad).replace('_', ' ')} dropped: some values are not finite"
        columns: dict[str, Any] = dict.fromkeys(bad)
        reading = self.reading.remarked(note("column_dropped", sentence))
        return dataclasses.replace(self, **columns, reading=reading)

    def __len__(self) -> int:
        """Return the number of states."""
        return len(self.stamps)

    def __repr__(self) -> str:
        """Return a summary in one line, without arrays."""
        parts = [self.name or "unnamed", counted(len(self), "pose")]
        if self.reading.stamped:
            parts.append(f"{self.duration_s:.1f} s")
        parts.append(f"{self.path_length_m:.1f} m")
        if self.frame or self.child_frame:
            parts.append(f"{self.child_frame or '?'} in {self.frame or '?'}")
        return f"<Trajectory {', '.join(parts)}>"

    def __getitem__(self, rows: slice | NDArray[np.int64] | Booleans) -> Trajectory:
        """Return the states of a slice, a mask or an array of indices."""
        if isinstance(rows, np.ndarray) and len(rows) == len(self):
            everything = rows if rows.dtype == bool else rows == np.arange(len(self))
            if everything.all():
                return self
        return at_rows(self, _COLUMNS, rows, reading=self.reading[rows])

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
        reading = self.reading
        if reading.fixes is not None:
            return "gnss"
        has_rotations = self.quaternions is not None or reading.has_identity_rotations
        return "poses" if has_rotations else "points"

    @property
    def known_quaternions(self) -> Floats:
        """Quaternions (N, 4), xyzw; the identity without orientations."""
        if self.quaternions is not None:
            return self.quaternions
        return np.tile([0.0, 0.0, 0.0, 1.0], (len(self), 1))

    @property
    def rotations(self) -> Rotation | None:
        """The orientations as a scipy `Rotation` of N; imports `scipy.spatial`."""
        if self.quaternions is None:
            return None
        from scipy.spatial.transform import Rotation

        # The quaternions are unit already; normalisation would change last digits.
        return Rotation(self.quaternions, normalize=False)

    def in_order(self) -> Trajectory:
        """Return the states by stamp, the first of equal stamps, with remarks and counts."""
        steps = np.diff(self.stamps)
        if (steps > 0).all():
            return self
        order = np.argsort(self.stamps, kind="stable")
        first = np.concatenate([[True], np.diff(self.stamps[order]) > 0])
        conflicts = conflicts_of(self.stamps[order], self.positions[order])
        duplicates = int(np.count_nonzero(~first))
        backwards = int(np.count_nonzero(steps < 0))
        remarks = []
        if backwards:
            sentence = (
                f"timestamps step back at {counted(backwards, 'place')}; the poses were sorted by "
                "timestamp"
            )
            remarks.append(note("sorted", sentence))
        if conflicts.number:
            sentence = (
                f"{self.name or 'the trajectory'} has "
                f"{counted(conflicts.number, 'repeated timestamp')} (of {duplicates}) with "
                f"different positions, up to {conflicts.largest_m:.3g} m apart; the first pose of "
                "a timestamp is used, remove the wrong rows"
            )
            remarks.append(warning("conflicting_states", sentence))
        ordered = self[order[first]]
        reading = ordered.reading.with_dropped({"duplicate_stamp": duplicates})
        return dataclasses.replace(ordered, reading=reading.remarked(*remarks))

    def at(self, stamps: Stamps, max_gap_s: float) -> tuple[Trajectory, Bracket]:
        """Interpolate states in order of time: linearly, orientations by slerp.

        Covariances, frame numbers, matrices and fixes are of single states and are left out.

        Args:
            stamps: (N,) int64, nanoseconds.
            max_gap_s: Longest step between two states that is interpolated.

        Returns:
            The states at all usable stamps, and the position of all N stamps between the states;
            its `usable` marks stamps at a state or between two states without a gap.

        Example:
            >>> import numpy as np
            >>> from trajeval_ros import Trajectory
            >>> stamps = np.array([0, 1_000_000_000])
            >>> path = Trajectory.from_columns(stamps, [[0, 0, 0], [2, 0, 0]])
            >>> states, bracket = path.at(np.array([250_000_000, 3_000_000_000]), max_gap_s=1.0)
            >>> states.positions, bracket.usable
            (array([[0.5, 0. , 0. ]]), array([ True, False]))
        """
        bracket = bracket_stamps(self.stamps, stamps, max_gap_s)
        rows = np.flatnonzero(bracket.usable)
        start, end, fraction = bracket.start, bracket.end, bracket.fraction
        if len(rows) < len(stamps):
            stamps, start, end, fraction = stamps[rows], start[rows], end[rows], fraction[rows]
        mixed: dict[str, Any] = {
            name: None if column is None else mix(column, start, end, fraction)
            for name in ("positions", "velocities", "gyroscope_biases", "accelerometer_biases")
            for column in (getattr(self, name),)
        }
        rotated = None
        if self.quaternions is not None:
            rotated = slerp(self.quaternions, start, end, fraction)
        return self.moved_to(stamps, quaternions=rotated, **mixed), bracket

    def moved_to(self, stamps: Stamps, **states: Any) -> Trajectory:
        """Return the trajectory with computed states (columns by name) at N other stamps."""
        columns: dict[str, Any] = {**dict.fromkeys(_COLUMNS), **states, "stamps": stamps}
        return dataclasses.replace(self, **columns, reading=self.reading.without())

    def require_usable(self) -> None:
        """Check that there are states and that all are finite.

        Raises:
            InputError: There is no state, or one is not finite; `from_columns` drops such rows.
        """
        name = self.name or "the trajectory"
        if not len(self):
            dropped = self.reading.dropped
            why = ", ".join(f"{count} {reason}" for reason, count in dropped.items())
            raise InputError(f"no usable pose in {name}" + (f" (dropped: {why})" if why else ""))
        if not valid_mask(self.positions)[0].all():
            raise InputError(
                f"{name} has positions that are not finite or beyond {LARGEST:g} m; remove these "
                "states"
            )
