"""Trajectories from text files: TUM, KITTI, EuRoC/ASL, OpenVINS, VINS-Mono and their kin."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import FileIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis
from trajeval_ros.io.checks import check_stamps, judge_rotations
from trajeval_ros.io.text.decimals import ParsedRows, RowError, parse_rows
from trajeval_ros.io.text.head import COMMENT, TextFormat, read_head, recognise_text
from trajeval_ros.io.text.layouts import Layout
from trajeval_ros.io.text.stamps import ExactNumbers, to_nanoseconds

Advance = Callable[[int, int], None]

# Bytes that are allocated and freed once: that tells glibc's malloc to keep so much for the next
# block, instead of giving each block's arrays back to the kernel, which costs as much as parsing.
_WORKING_MEMORY = 16 << 20
_SPARE_ROWS = 1000
_FRAMES = 10**8  # a sequence has fewer
_CAMERA = UpAxis("-y", "KITTI's camera axes")
_BLOCK = 1 << 19  # bytes that are parsed at once: their arrays stay in the processor's cache


def read_text(path: Path, advance: Advance | None = None) -> Trajectory:
    """Read a trajectory from a text file whose layout is recognised by its content.

    Args:
        path: An existing, readable file.
        advance: Called with the bytes done and all bytes, now and then.

    Raises:
        InputError: The file is no trajectory, with the line where that shows.
    """
    text = recognise_text(path)
    layout = text.layout
    columns = _read_columns(path, text, advance)
    groups = columns.groups
    positions, quaternions = _poses_of(groups)
    frames = _frames_of(path, layout, columns, len(positions))
    stamps, stamped, timing = _stamps_of(path, layout, columns, frames)
    if stamped:
        check_stamps(stamps, str(path))
    quaternions, judgement = judge_rotations(quaternions)
    notes = [f"format: {layout.name}", *filter(None, [layout.note]), *timing, *judgement]
    covariances = None
    if "rotation_covariance" in groups and quaternions is not None:
        covariances = _openvins_covariances(groups, quaternions)
        notes.append(
            "rotation covariances were turned from the body's axes (OpenVINS) to the fixed axes"
        )
    trajectory = Trajectory.from_columns(
        stamps,
        positions,
        quaternions,
        velocities=groups.get("velocity"),
        gyroscope_biases=groups.get("gyroscope_bias"),
        accelerometer_biases=groups.get("accelerometer_bias"),
        covariances=covariances,
        frames=frames,
        matrices=groups["matrix"].reshape(-1, 3, 4)[:, :, :3] if "matrix" in groups else None,
        up=_CAMERA if "matrix" in groups else Z_UP,
        name=path.stem,
        stamped=stamped,
        numbered=layout.indexed,
        dropped={"not_finite": columns.untimed},
        notes=tuple(notes),
    )
    if not len(trajectory):
        count = columns.untimed + len(stamps)
        raise InputError(
            f"{path}: none of its {count} rows is a pose (NaN, zero quaternions, or positions out "
            "of this world)"
        )
    return trajectory


def _poses_of(groups: dict[str, Floats]) -> tuple[Floats, Floats | None]:
    """Return positions (N, 3) and quaternions (N, 4), xyzw, NaN where there is no rotation."""
    if "matrix" not in groups:
        return groups["position"], groups.get("quaternion")
    matrices = groups["matrix"].reshape(-1, 3, 4)
    rotations = matrices[:, :, :3]
    valid = np.asarray(np.isfinite(rotations).all(axis=(1, 2)))
    valid[valid] = np.linalg.det(rotations[valid]) > 0.0
    quaternions = np.full((len(matrices), 4), np.nan)
    if valid.any():
        quaternions[valid] = lie.from_matrices(_nearest_rotations(rotations[valid]))
    return np.ascontiguousarray(matrices[:, :, 3]), quaternions


def _nearest_rotations(matrices: Floats) -> Floats:
    """Return the rotations nearest to (N, 3, 3) matrices of few digits.

    scipy's own repair of such matrices differs from version to version, by 5e-7 of the errors.
    """
    u, _, vt = np.linalg.svd(matrices)
    nearest: Floats = u @ vt
    return nearest


def _openvins_covariances(groups: dict[str, Floats], quaternions: Floats) -> Floats:
    """Return the covariances (N, 6, 6) of position and fixed-axis rotation.

    OpenVINS's error is local, R exp(e): in fixed axes its covariance C is R C R^T.
    """
    count = len(quaternions)
    usable = np.isfinite(quaternions).all(axis=1) & quaternions.any(axis=1)
    turns = np.tile(np.eye(3), (count, 1, 1))
    turns[usable] = lie.to_matrix(lie.normalized(quaternions[usable]))
    rows, columns = np.triu_indices(3)
    blocks = np.zeros((2, count, 3, 3))
    for block, group in zip(blocks, ("position_covariance", "rotation_covariance"), strict=True):
        block[:, rows, columns] = block[:, columns, rows] = groups[group]
    covariances = np.zeros((count, 6, 6))
    covariances[:, :3, :3] = blocks[0]
    covariances[:, 3:, 3:] = turns @ blocks[1] @ np.swapaxes(turns, 1, 2)
    return covariances


@dataclass(frozen=True)
class _Columns:
    """The columns of a file by their meaning.

    Attributes:
        stamps: N exact numbers, None if there is no time column.
        groups: (N, width) of each group in the layout.
        untimed: Number of rows that were left out because their stamp is not finite.
    """

    stamps: ExactNumbers | None
    groups: dict[str, Floats]
    untimed: int


def _read_columns(path: Path, text: TextFormat, advance: Advance | None) -> _Columns:
    """Read all rows of a file, block by block, into arrays that are large enough for all."""
    total = path.stat().st_size - text.start
    first = 0 if text.layout.time is None else text.layout.time + 1
    picks = {group: _pick(columns, first) for group, columns in text.layout.groups.items()}
    groups = {group: np.empty((0, len(columns))) for group, columns in text.layout.groups.items()}
    stamps: list[ExactNumbers] = []
    count = untimed = 0
    for end, rows in _parse_blocks(path, text, advance):
        values = rows.values
        if rows.stamps is not None:
            every = bool(rows.timed.all())
            stamps.append(rows.stamps if every else rows.stamps[rows.timed])
            values = values if every else values[rows.timed]
            untimed += len(rows.timed) - len(values)
        room = (count + len(values)) * total // (end - text.start) * 21 // 20 + _SPARE_ROWS
        for group, pick in picks.items():
            if len(groups[group]) < count + len(values):
                groups[group] = _enlarged(groups[group], count, room)
            groups[group][count : count + len(values)] = values[:, pick]
        count += len(values)
    return _Columns(
        ExactNumbers.concatenate(stamps) if stamps else None,
        {group: array[:count] for group, array in groups.items()},
        untimed,
    )


def _pick(columns: tuple[int, ...], first: int) -> slice | list[int]:
    """Return what picks the columns, counted from `first`; a slice if it can, since it is fast."""
    if columns == tuple(range(columns[0], columns[-1] + 1)):
        return slice(columns[0] - first, columns[-1] - first + 1)
    return [column - first for column in columns]


def _enlarged(array: Floats, count: int, room: int) -> Floats:
    """Return an array of `room` rows that begins with the `count` rows of another."""
    enlarged = np.empty((room, array.shape[1]))
    enlarged[:count] = array[:count]
    return enlarged


def _parse_blocks(
    path: Path, text: TextFormat, advance: Advance | None
) -> Iterator[tuple[int, ParsedRows]]:
    """Yield the rows of a file, a block of whole lines at a time, and where each block ends."""
    total = path.stat().st_size
    done = text.start
    np.empty(_WORKING_MEMORY, dtype=np.uint8)
    with path.open("rb", buffering=0) as file:
        file.seek(text.start)
        for block in _line_blocks(path, file):
            try:
                uncommented = COMMENT.sub(b"", block) if b"#" in block or b"%" in block else block
                rows = parse_rows(uncommented, text.columns, text.layout.time)
            except RowError as error:
                line = _lines_before(path, done) + error.line + 1
                raise InputError(
                    f"{path}, line {line}: {error.reason}; correct or remove the line"
                ) from None
            done += len(block)
            yield done, rows
            if advance is not None:
                advance(done, total)


def _line_blocks(path: Path, file: FileIO) -> Iterator[bytes]:
    """Yield the rest of a file in blocks of whole lines."""
    rest = b""
    while part := file.read(_BLOCK):
        end = part.rfind(b"\n") + 1
        if end:
            yield rest + part[:end]
            rest = part[end:]
        else:
            rest += part
        if len(rest) > _BLOCK:
            raise InputError(f"{path} is no trajectory: a line has more than {_BLOCK} bytes")
    if rest:
        yield rest


def _lines_before(path: Path, offset: int) -> int:
    """Return the number of lines that end before an offset in a file."""
    with path.open("rb") as file:
        return sum(
            file.read(min(_BLOCK, offset - at)).count(b"\n") for at in range(0, offset, _BLOCK)
        )


def _frames_of(path: Path, layout: Layout, rows: _Columns, count: int) -> NDArray[np.int64] | None:
    """Return the numbers (N,) of KITTI's frames; None where the rows have stamps."""
    if rows.stamps is None:
        return np.arange(count)
    if not layout.indexed:
        return None
    wrong = rows.stamps.negative | (rows.stamps.billionths > 0) | (rows.stamps.whole >= _FRAMES)
    if wrong.any():
        raise InputError(
            f"{path}: row {int(np.argmax(wrong)) + 1} has no number of a frame in its first "
            "column, as the first rows have; correct or remove the row"
        )
    return rows.stamps.whole.astype(np.int64)


def _stamps_of(
    path: Path, layout: Layout, rows: _Columns, frames: NDArray[np.int64] | None
) -> tuple[NDArray[np.int64], bool, list[str]]:
    """Return the stamps (N,), whether they are times, and what to tell about them."""
    if frames is None:
        assert rows.stamps is not None
        if not len(rows.stamps.whole):
            return np.zeros(0, dtype=np.int64), True, []
        try:
            stamps, in_nanoseconds = to_nanoseconds(rows.stamps, layout.in_nanoseconds)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        return stamps, True, ["stamps are in nanoseconds"] if in_nanoseconds else []
    count = len(frames)
    notes = []
    for times_path in (path.with_name(f"{path.stem}_times.txt"), path.with_name("times.txt")):
        if not times_path.is_file():
            continue
        times = _read_times(times_path)
        matches = frames.max(initial=0) < len(times) if layout.indexed else len(times) == count
        if matches:
            return times[frames], True, [f"stamps were taken from {times_path}"]
        notes.append(f"{times_path} was not used: it has {len(times)} rows for {count} poses")
    notes.append("there are no stamps: frames were counted, one second apart")
    return frames * NANOSECONDS, False, notes


def _read_times(path: Path) -> NDArray[np.int64]:
    """Return the stamps (N,) of a file with one time per line, nanoseconds."""
    head = read_head(path)
    if len(head.sample[0]) != 1:
        raise InputError(f"{path} has {len(head.sample[0])} columns, expected one time per line")
    text = TextFormat(Layout("times", 0, {}), 1, head.start)
    stamps = _read_columns(path, text, None).stamps
    assert stamps is not None
    return to_nanoseconds(stamps)[0]
