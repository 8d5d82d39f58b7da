"""Reading of a folder with feature tracks, IMU, groundtruth and calibration (docs/tracks.md).

The layout of EuRoC is also supported: `mav0/imu0/data.csv`, `mav0/cam0/sensor.yaml`,
`mav0/state_groundtruth_estimate0/data.csv`, and the tracks in `mav0/cam0`.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from trajeval_ros.exceptions import InputError, reason_of
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.text.decimals import RowFormat, parse_rows
from trajeval_ros.io.text.head import COMMENT, read_head
from trajeval_ros.io.text.reader import read_text
from trajeval_ros.io.text.stamps import to_nanoseconds
from trajeval_ros.io.text.tokens import RowError
from trajeval_ros.io.tracks.camera_file import read_camera
from trajeval_ros.visual_inertial.sensor_recording import SensorRecording, one_instant_each

# In order of preference: names in this package's own format, then in EuRoC's.
_NAMES = {
    "tracks": ("tracks*.csv", "mav0/cam0/tracks*.csv"),
    "IMU samples": ("imu*.csv", "mav0/imu0/data.csv"),
    "groundtruth": ("groundtruth*.csv", "mav0/state_groundtruth_estimate0/data.csv"),
    "camera": ("cam*.yaml", "mav0/cam0/sensor.yaml"),
}
_LARGEST = 1 << 30  # bytes
_LARGEST_ID = 1 << 53  # larger whole numbers are not exact as float64


def read_tracks_folder(folder: Path) -> SensorRecording:
    """Read a recording from a folder.

    If the groundtruth has no velocities, its positions are differentiated. Biases are used only
    if the groundtruth has the biases of both sensors.

    Raises:
        InputError: A file is missing or not unique, can't be read, or has invalid content.
    """
    if not folder.is_dir():
        raise InputError(
            f"{folder} is not a folder; give a folder with tracks, IMU and groundtruth"
        )
    try:
        return _recording_in(folder)
    except OSError as error:
        raise InputError(f"{error.filename} can't be read: {reason_of(error)}") from error


def _recording_in(folder: Path) -> SensorRecording:
    paths = {what: _only(folder, what) for what in _NAMES}
    imu_path, tracks_path = paths["IMU samples"], paths["tracks"]
    imu_stamps, samples = _read_rows(imu_path, "stamp_ns,wx,wy,wz,ax,ay,az")
    if (np.diff(imu_stamps) <= 0).any():
        place = int(np.argmax(np.diff(imu_stamps) <= 0))
        raise InputError(
            f"{imu_path}: the timestamp after {imu_stamps[place]} ns does not increase; sort the "
            "samples and remove duplicates"
        )
    seen_stamps, tracks = _read_rows(tracks_path, "stamp_ns,track,u,v")
    image_stamps, image_of = one_instant_each(seen_stamps)
    track_of = _track_names(tracks_path, tracks[:, 0])
    _require_once(tracks_path, np.column_stack([image_of, track_of]), seen_stamps)
    notes = []
    joined = len(np.unique(seen_stamps)) - len(image_stamps)
    if joined:
        notes.append(f"track timestamps less than 1 us apart, merged into one image: {joined}")
    groundtruth, made_up = _groundtruth(paths["groundtruth"])
    return SensorRecording(
        name=folder.resolve().name,
        camera=read_camera(paths["camera"]),
        imu_stamps=imu_stamps,
        angular_velocities=samples[:, :3],
        accelerations=samples[:, 3:],
        image_stamps=image_stamps,
        image_of=image_of,
        track_of=track_of,
        pixels=tracks[:, 1:],
        groundtruth=groundtruth,
        notes=(*notes, *made_up),
    )


def _only(folder: Path, what: str) -> Path:
    """Return the only file of the folder with the content `what`, a key of `_NAMES`.

    Raises:
        InputError: No file or more than one file is found.
    """
    for pattern in _NAMES[what]:
        found = sorted(folder.glob(pattern))
        if len(found) == 1:
            return found[0]
        if found:
            raise InputError(
                f"{folder} has more than one file of {what} ({found[0].name}, {found[1].name}); "
                "keep only one"
            )
    raise InputError(
        f"{folder} has no file of {what}; add {' or '.join(_NAMES[what])} (docs/tracks.md)"
    )


def _read_rows(path: Path, names: str) -> tuple[Stamps, Floats]:
    """Return timestamps (N,) in nanoseconds and the other columns (N, C - 1) of a table.

    Args:
        path: The file.
        names: Names of its C columns, separated by commas.

    Raises:
        InputError: The file is too large, or a row is not C finite numbers.
    """
    columns = names.count(",") + 1
    if path.stat().st_size > _LARGEST:
        raise InputError(f"{path} is too large; use a part of the recording")
    start = read_head(path).start
    content = path.read_bytes()
    table = COMMENT.sub(b"", content[start:])
    try:
        rows = parse_rows(table, RowFormat(columns, 0, tuple(range(1, columns))))
    except RowError as error:
        line = content[:start].count(b"\n") + error.line + 1
        raise InputError(f"{path}, line {line}: {error.reason}; use the columns {names}") from None
    assert rows.stamps is not None
    usable = rows.timed & np.isfinite(rows.values).all(axis=1)
    if len(usable) < 2 or not usable.all():
        where = f"row {int(np.argmin(usable)) + 1} is not finite" if len(usable) > 1 else "empty"
        raise InputError(f"{path}: {where}; use the columns {names}")
    try:
        return to_nanoseconds(rows.stamps, unit_ns=1)[0], rows.values
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _track_names(path: Path, column: Floats) -> Stamps:
    if (column != np.rint(column)).any() or np.abs(column).max() > _LARGEST_ID:
        raise InputError(
            f"{path}: track ids (second column) must be whole numbers up to {_LARGEST_ID}"
        )
    return column.astype(np.int64)


def _require_once(path: Path, sightings: Stamps, stamps: Stamps) -> None:
    """Check that no track is in one image more than once.

    Args:
        path: The file, for messages.
        sightings: (O, 2), index of the image and id of the track.
        stamps: (O,), nanoseconds.

    Raises:
        InputError: A track is in one image more than once.
    """
    _, first, counts = np.unique(sightings, axis=0, return_index=True, return_counts=True)
    if counts.max() > 1:
        place = int(first[counts.argmax()])
        raise InputError(
            f"{path}: track {sightings[place, 1]} is {counts.max()} times in the image at "
            f"{stamps[place]} ns; keep one of them"
        )


def _groundtruth(path: Path) -> tuple[Trajectory, list[str]]:
    """Return the groundtruth with velocities, and notes about missing quantities.

    Raises:
        InputError: The file has fewer than 3 poses, no orientations or no timestamps, or has
            repeated timestamps.
    """
    read = read_text(path)
    if read.quaternions is None or not read.stamped or len(read) < 3:
        raise InputError(
            f"{path} needs timestamps, positions and orientations of at least 3 poses"
        )
    order = np.argsort(read.stamps, kind="stable")
    truth, notes = read[order], []
    if (np.diff(truth.stamps) == 0).any():
        raise InputError(f"{path} has repeated timestamps; remove the repeated rows")
    if truth.velocities is None:
        velocities = np.gradient(truth.positions, truth.seconds - truth.seconds[0], axis=0)
        truth = dataclasses.replace(truth, velocities=velocities)
        notes.append("no velocity in groundtruth: positions differentiated")
    if truth.gyroscope_biases is None or truth.accelerometer_biases is None:
        notes.append("no biases of both sensors in groundtruth: IMU used without correction")
        truth = dataclasses.replace(truth, gyroscope_biases=None, accelerometer_biases=None)
    return truth, notes
