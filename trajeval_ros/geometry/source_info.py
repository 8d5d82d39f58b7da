"""How a trajectory was read: its source, remarks, counts, and data of special sources by row."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import Level, Remark
from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps, at_rows
from trajeval_ros.geometry.valid_poses import add_counts

if TYPE_CHECKING:
    from trajeval_ros.geometry.fixes import Fixes

LOG, PUBLISH = "log", "publish"  # clocks of a bag: of the recorder, and of the publisher
# Code of the warning about what a file does not say of its columns, and what is assumed.
ASSUMED_COLUMNS = "assumed_columns"
# Codes of the remark that names the format of a source, also if the user named its columns.
FORMAT, NAMED_COLUMNS = FORMATS = "format", "named_columns"
# Code of the warning that frame numbers start at 1, and that 0 or 1 may be the first frame.
FRAMES_FROM_1 = "frames_from_1"
# Code of the remarks on sources and sensors that the user did not name.
ASSUMED = "assumed"
# Shape of a row by name of the data by row; None for data that are no array.
_ROWS: dict[str, tuple[int, ...] | None] = {
    "frame_numbers": (),
    "matrices": (3, 3),
    "fixes": None,
    "receive_times": None,
}


@dataclass(frozen=True, eq=False)
class ReceiveTimes:
    """When the N messages of poses were received."""

    times: Stamps  # (N,) int64, nanoseconds
    # What the times are: `log` or `publish` times of a bag, `column` of a text file, or `node`
    # for those of a live run.
    by: str = "column"
    # Median and maximum of log time minus publish time, seconds: transport and recording; None if
    # a bag does not have both.
    recording_s: tuple[float, float] | None = None
    body_rates: Floats | None = None  # (N, 3), rad/s, in the body; None if not read
    # (N,) int64, nanoseconds, receive times of the newest corrections, such as map to odom; None
    # if poses are not corrected.
    corrected: Stamps | None = None

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self.times)

    def __getitem__(self, rows: Any) -> ReceiveTimes:
        """Return those of a slice, a mask or an array of indices."""
        return at_rows(self, ("times", "body_rates", "corrected"), rows)

    @classmethod
    def of_bag(cls, logged: Stamps, published: Stamps, clock: str = "") -> ReceiveTimes:
        """Return the publish times where they differ from the log times, or the requested ones.

        A recorder that is late delays its log times only. `logged`, `published`: (N,),
        nanoseconds. `clock`: `LOG`, `PUBLISH`, or empty for the default.
        """
        differs = bool((published != logged).any() and (published > 0).all())
        if not differs or clock == LOG:
            return cls(logged, LOG)
        later_s = (logged - published) / 1e9
        recording_s = float(np.median(later_s)), float(later_s.max())
        return cls(published, PUBLISH, recording_s)


class DeclaredReset(NamedTuple):
    """A jump of the pose that the estimator declares."""

    stamp_ns: int  # timestamp of the first pose after it, nanoseconds
    position_m: float  # step of the position that the velocity does not explain
    rotation_deg: float  # turn between the poses before and after it


@dataclass(frozen=True, eq=False)
class SourceInfo:
    """How the N states of a trajectory were read; immutable."""

    source: str = ""  # the source, as the user names it; "" if there is none
    columns: str = ""  # names of the columns of a text file, as --columns takes them
    # False if the file has no timestamps; stamps then count rows, one second apart.
    stamped: bool = True
    # Whether the file has the numbers in `frame_numbers`; otherwise they count its rows.
    numbered: bool = False
    # Whether a topic's orientations were dropped because all are the identity. A live run cannot
    # detect this before the last message.
    has_identity_rotations: bool = False
    dropped: Mapping[str, int] = field(default_factory=dict)  # number of dropped rows, by reason
    # What was detected or corrected (notes), contradictions between states (warnings) and
    # unreadable parts of the source (errors).
    remarks: tuple[Remark, ...] = ()
    resets: tuple[DeclaredReset, ...] = ()  # resets that the estimator declares
    # The N GNSS fixes of the positions, with their datum; None for other sources.
    fixes: Fixes | None = None
    # (N,) int64, numbers in an image sequence (KITTI), or None.
    frame_numbers: NDArray[np.int64] | None = None
    # (N, 3, 3), rotation matrices exactly as in KITTI's file, or None. With few digits they are
    # not quite the rotations of `Trajectory.quaternions`.
    matrices: Floats | None = None
    # The receive times of the N messages; None if unknown.
    receive_times: ReceiveTimes | None = None
    # A `Trajectory` (its module needs this one) in order of receive time, if poses were revised
    # afterwards: the last pose of each path, or transforms under the newest correction; or None.
    as_received: Any = None

    @property
    def format(self) -> str:
        """The format of the source; "" if unknown."""
        formats = (remark.text for remark in self.remarks if remark.code in FORMATS)
        return next(formats, "").removeprefix("format: ")

    def require_rows(self, count: int) -> None:
        """Check that the data by row are of `count` states.

        Raises:
            TypeError: A column is no array.
            ValueError: A column has a wrong shape, or the number of fixes is wrong.
        """
        for name, row_shape in _ROWS.items():
            column = getattr(self, name)
            if column is None:
                continue
            if row_shape is not None:
                require_column(name, column, (count, *row_shape))
            elif len(column) != count:
                raise ValueError(
                    f"{len(column)} {name} for {counted(count, 'timestamp')}; give one per "
                    "timestamp"
                )

    def __getitem__(self, rows: slice | NDArray[np.int64] | Booleans) -> SourceInfo:
        """Return the reading with the data of a slice, a mask or an array of indices."""
        return at_rows(self, _ROWS, rows)

    def without(self, *names: str) -> SourceInfo:
        """Return the reading without some data by row; without names, without all of them."""
        gone: dict[str, Any] = {
            name: None for name in names or _ROWS if getattr(self, name) is not None
        }
        return dataclasses.replace(self, **gone) if gone else self

    def remarked(self, *remarks: Remark) -> SourceInfo:
        """Return the reading with further remarks."""
        if not remarks:
            return self
        return dataclasses.replace(self, remarks=(*self.remarks, *remarks))

    def with_dropped(self, counts: Mapping[str, int]) -> SourceInfo:
        """Return the reading with further dropped rows, by reason."""
        return dataclasses.replace(self, dropped=add_counts(self.dropped, counts))

    def messages(self, level: Level) -> tuple[str, ...]:
        """Return the sentences of the remarks of a level."""
        return tuple(remark.text for remark in self.remarks if remark.level is level)


def require_column(name: str, column: object, shape: tuple[int, ...]) -> None:
    """Check that a column is an array of a shape.

    Raises:
        TypeError: It is no array.
        ValueError: It has another shape.
    """
    if not isinstance(column, np.ndarray):
        raise TypeError(f"{name} must be a numpy array, not {type(column).__name__}")
    if column.shape != shape:
        raise ValueError(f"{name} has shape {column.shape}, expected {shape}")


NOT_READ = SourceInfo()
