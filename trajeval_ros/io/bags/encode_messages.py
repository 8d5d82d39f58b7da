"""Poses, alignments and paths as CDR messages, for all states of a trajectory at once.

The names of frames are constant. Therefore all messages have one layout, and a message is one row
of bytes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.fixes import Fixes
from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.online.error_topics import ALIGNED_PATH, GROUNDTRUTH_PATH
from trajeval_ros.online.pairing import PairedStates

Messages = NDArray[np.uint8]
_POSE_SIZE = 56  # bytes: position and quaternion
_GPS = 1  # of the services in sensor_msgs/NavSatStatus
_ENCAPSULATION = np.array([0, 1, 0, 0], dtype=np.uint8)  # little-endian CDR


class _MessageLayout:
    """The positions of a message's fields. Alignment counts from the end of the encapsulation."""

    def __init__(self) -> None:
        self._end = 4
        self._fields: dict[str, tuple[np.dtype[np.void], int]] = {}
        self._texts: dict[str, bytes] = {}

    def add(self, name: str, kind: str, shape: tuple[int, ...] = (), alignment: int = 4) -> None:
        """Add numbers of one kind."""
        start = 4 - (-(self._end - 4) // alignment * alignment)
        field = np.dtype((kind, shape))
        self._fields[name] = field, start
        self._end = start + field.itemsize

    def add_text(self, name: str, text: str) -> None:
        """Add a string, the same in all messages."""
        letters = text.encode() + b"\0"
        self.add(f"{name} length", "<u4")
        self.add(name, "u1", (len(letters),), alignment=1)
        self._texts[name] = letters

    def messages(self, count: int) -> tuple[Messages, NDArray[np.void]]:
        """Return messages (count, size) whose numbers are zeros, and a view of their fields."""
        rows = np.zeros((count, self._end), dtype=np.uint8)
        rows[:, :4] = _ENCAPSULATION
        names, fields = list(self._fields), list(self._fields.values())
        kind = np.dtype(
            {
                "names": names,
                "formats": [field for field, _ in fields],
                "offsets": [start for _, start in fields],
                "itemsize": self._end,
            }
        )
        view = rows.view(kind)[:, 0]
        for name, letters in self._texts.items():
            view[f"{name} length"] = len(letters)
            view[name] = np.frombuffer(letters, dtype=np.uint8)
        return rows, view


def encode_stamped(stamps: Stamps, numbers: Floats, frame: str) -> Messages:
    """Return messages (N, size) of a header and numbers (N, k).

    Poses (N, 7), position and quaternion xyzw, give geometry_msgs/PoseStamped; vectors (N, 3) give
    geometry_msgs/Vector3Stamped.
    """
    layout = _with_header(frame)
    layout.add("numbers", "<f8", numbers.shape[1:], alignment=8)
    rows, fields = layout.messages(len(stamps))
    fields["stamp"], fields["numbers"] = _times(stamps), numbers
    return rows


def encode_odometry(
    stamps: Stamps,
    poses: Floats,
    covariances: Floats,
    body_velocities: Floats,
    frames: tuple[str, str],
) -> Messages:
    """Return nav_msgs/Odometry (N, size) without angular velocities.

    `stamps`: (N,). `poses`: (N, 7), position and quaternion xyzw. `covariances`: (N, 36) of the
    poses. `body_velocities`: (N, 3) in the body. `frames`: of the fixed frame and of the body.
    """
    layout = _with_header(frames[0])
    layout.add_text("child", frames[1])
    for name, size in (("pose", 7), ("covariance", 36), ("linear", 3), ("rest", 3 + 36)):
        layout.add(name, "<f8", (size,), alignment=8)
    rows, fields = layout.messages(len(stamps))
    fields["stamp"], fields["pose"] = _times(stamps), poses
    fields["covariance"], fields["linear"] = covariances, body_velocities
    return rows


def encode_fixes(stamps: Stamps, fixes: Fixes, frame: str) -> Messages:
    """Return sensor_msgs/NavSatFix (N, size) of N fixes of an antenna's frame."""
    layout = _with_header(frame)
    layout.add("status", "i1", alignment=1)
    layout.add("service", "<u2", alignment=2)
    layout.add("place", "<f8", (3,), alignment=8)
    layout.add("covariance", "<f8", (9,), alignment=8)
    layout.add("type", "u1", alignment=1)
    rows, fields = layout.messages(len(stamps))
    fields["stamp"], fields["status"], fields["place"] = _times(stamps), fixes.status, fixes.places
    fields["service"] = _GPS
    fields["covariance"] = fixes.covariances.reshape(-1, 9)
    fields["type"] = fixes.covariance_types
    return rows


def encode_transforms(stamps: Stamps, poses: Floats, frames: tuple[str, str]) -> Messages:
    """Return tf2_msgs/TFMessage (N, size) with one transform per message, of poses (N, 7).

    `stamps`: (N,). `poses`: of the child in the parent.
    """
    layout = _MessageLayout()
    layout.add("count", "<u4")
    rows, fields = _transforms(stamps, poses, frames, layout)
    fields["count"] = 1
    return rows


def encode_numbers(numbers: Floats) -> Messages:
    """Return std_msgs/Float64 (N, size) of numbers (N,)."""
    layout = _MessageLayout()
    layout.add("data", "<f8", alignment=8)
    rows, fields = layout.messages(len(numbers))
    fields["data"] = numbers
    return rows


def _transforms(
    stamps: Stamps, poses: Floats, frames: tuple[str, str], before: _MessageLayout
) -> tuple[Messages, NDArray[np.void]]:
    layout = _with_header(frames[0], before)
    layout.add_text("child", frames[1])
    layout.add("pose", "<f8", (7,), alignment=8)
    rows, fields = layout.messages(len(stamps))
    fields["stamp"], fields["pose"] = _times(stamps), poses
    return rows, fields


def encode_imu(stamps: Stamps, rates: Floats, accelerations: Floats, frame: str) -> Messages:
    """Return sensor_msgs/Imu (N, size) without orientations: their covariance starts with -1.

    `stamps`: (N,). `rates`: (N, 3), rad/s. `accelerations`: (N, 3), m/s^2.
    """
    layout = _with_header(frame)
    for name, size in (
        ("orientation", 4),
        ("orientation covariance", 9),
        ("rate", 3),
        ("rate covariance", 9),
        ("acceleration", 3),
        ("acceleration covariance", 9),
    ):
        layout.add(name, "<f8", (size,), alignment=8)
    rows, fields = layout.messages(len(stamps))
    fields["stamp"], fields["rate"], fields["acceleration"] = _times(stamps), rates, accelerations
    fields["orientation"][:, 3] = 1.0
    fields["orientation covariance"][:, 0] = -1.0
    return rows


def _with_header(frame: str, before: _MessageLayout | None = None) -> _MessageLayout:
    layout = before or _MessageLayout()
    layout.add("stamp", "<i4", (2,))
    layout.add_text("frame", frame)
    return layout


def _times(stamps: Stamps) -> NDArray[np.int64]:
    """Return seconds and nanoseconds (N, 2)."""
    return np.stack(np.divmod(stamps, NANOSECONDS), axis=1)


def encode_path(stamps: Stamps, positions: Floats, quaternions: Floats, frame: str) -> bytes:
    """Return a nav_msgs/Path in little-endian CDR, stamped as its last pose.

    `stamps`: (N,) nanoseconds. `positions`: (N, 3), metres. `quaternions`: (N, 4), xyzw.
    """
    name = frame.encode() + b"\0"
    header = np.dtype([("stamp", "<i4", 2), ("length", "<u4"), ("name", f"S{len(name)}")])
    count = len(stamps)
    # Alignment counts from the end of the encapsulation. A pose ends at a multiple of eight bytes.
    # Therefore all poses after the first one have the same layout.
    first = _aligned(header.itemsize, 4) + 4
    numbers = _aligned(first + header.itemsize, 8)
    stride = _aligned(header.itemsize, 8) + _POSE_SIZE
    payload = bytearray(4 + (numbers + _POSE_SIZE + (count - 1) * stride if count else first))
    body = memoryview(payload)[4:]
    payload[:4] = b"\0\1\0\0"
    np.ndarray((), "<u4", body, first - 4)[...] = count
    headers = [np.ndarray(1, header, body)]
    if count:
        headers += [
            np.ndarray(1, header, body, first),
            np.ndarray(count - 1, header, body, numbers + _POSE_SIZE, (stride,)),
        ]
        poses = np.ndarray((count, 7), "<f8", body, numbers, (stride, 8))
        poses[:, :3], poses[:, 3:] = positions, quaternions
    of_each = (stamps[-1:], stamps[:1], stamps[1:])
    for fields, times in zip(headers, of_each, strict=False):
        fields["stamp"] = np.stack(np.divmod(times, NANOSECONDS), axis=-1) if count else 0
        fields["length"], fields["name"] = len(name), name
    return bytes(payload)


def _aligned(offset: int, alignment: int) -> int:
    return -(-offset // alignment) * alignment


def encode_alignment(alignment: Similarity, stamps: Stamps, frames: tuple[str, str]) -> bytes:
    """Return geometry_msgs/TransformStamped at a timestamp (1,), without the scale."""
    pose = np.concatenate([alignment.translation, alignment.rotation_xyzw])
    return bytes(_transforms(stamps, pose[None], frames, _MessageLayout())[0])


def encode_paths(pairs: PairedStates, alignment: Similarity, frame: str) -> dict[str, bytes]:
    """Return by topic the nav_msgs/Path of the aligned estimate and of the groundtruth."""
    groundtruth, estimate = pairs.groundtruth, pairs.estimate
    positions = alignment.positions(estimate.positions)
    quaternions = alignment.quaternions(estimate.known_quaternions)
    return {
        ALIGNED_PATH: encode_path(pairs.stamps, positions, quaternions, frame),
        GROUNDTRUTH_PATH: encode_path(
            pairs.stamps, groundtruth.positions, groundtruth.known_quaternions, frame
        ),
    }
