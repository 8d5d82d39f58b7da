"""Messages of PX4 (px4_msgs, uORB) as poses in ROS axes: east, north, up; forward, left, up.

PX4's world is north, east, down (NED), or forward, right, down with a free heading (FRD). Its body
is FRD. With M = [[0,1,0],[1,0,0],[0,0,-1]] and B = diag(1,-1,-1), poses become p' = W p and
R' = W R B, where W is M for NED and B for FRD. Both are rotations and their own inverse.
Sources: px4_msgs, release/1.13 to release/1.18.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import Remark, note
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices, Stamps
from trajeval_ros.geometry.interpolation import bracket_stamps, slerp
from trajeval_ros.geometry.valid_poses import reasons
from trajeval_ros.io.bags.blocks import Buffer
from trajeval_ros.io.bags.cdr import CdrPlan
from trajeval_ros.io.bags.cdr_columns import Columns
from trajeval_ros.io.bags.message_definitions import Fields, Repeated
from trajeval_ros.io.bags.pose_columns import PoseColumns

_PACKAGE = "px4_msgs/msg/"
ODOMETRY, VISUAL, LOCAL_POSITION, ATTITUDE, GPS = (
    f"{_PACKAGE}{name}"
    for name in (
        *("VehicleOdometry", "VehicleVisualOdometry", "VehicleLocalPosition"),
        *("VehicleAttitude", "SensorGps"),
    )
)
PX4_POSE_TYPES = (ODOMETRY, VISUAL, LOCAL_POSITION, GPS)

_M = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_B = np.diag([1.0, -1.0, -1.0])
_UNKNOWN, _NED, _FRD, _BODY = range(4)  # the codes of px4_msgs since 1.14
_FRAMES = {_NED: "map_enu", _FRD: "odom_flu"}
_CHILD = "base_link_flu"
_OLD_FRAMES = np.array([_NED, _FRD, _UNKNOWN, _BODY])  # the same of 1.13, by its codes
_UNIT = 1e-2  # largest deviation of a quaternion's length
_LARGEST_DELAY_US = 1_000_000  # from the measurement to its publication
_LARGEST_GAP_S = 0.1  # between the attitudes around a position
_LAST_US = (2**63 - 1) // 1000
_APPROXIMATED = 1  # covariance type of NavSatFix
_STATUS = np.array([-1, -1, -1, 0, 1, 2, 2, -1, 0])  # of NavSatFix, by PX4's fix_type

_TIMES: Fields = (("timestamp", "u8"), ("timestamp_sample", "u8"))
_GPS_ERRORS: Fields = (
    *(("s_variance_m_s", "f4"), ("c_variance_rad", "f4"), ("fix_type", "u1")),
    *(("eph", "f4"), ("epv", "f4")),
)
_GPS_OLD: Fields = (
    ("device_id", "u4"),
    *((name, "i4") for name in ("lat", "lon", "alt", "alt_ellipsoid")),
    *_GPS_ERRORS,
)
_GPS_NEW: Fields = (
    *(*_TIMES, ("device_id", "u4")),
    *(
        (name, "f8")
        for name in ("latitude_deg", "longitude_deg", "altitude_msl_m", "altitude_ellipsoid_m")
    ),
    *_GPS_ERRORS,
)
_LOCAL: Fields = (
    *_TIMES,
    *((name, "u1") for name in ("xy_valid", "z_valid", "v_xy_valid", "v_z_valid")),
    *(("x", "f4"), ("y", "f4"), ("z", "f4"), ("delta_xy", Repeated("f4", 2))),
    *(("xy_reset_counter", "u1"), ("delta_z", "f4"), ("z_reset_counter", "u1")),
    *(("vx", "f4"), ("vy", "f4"), ("vz", "f4")),
)
_ODOMETRY_OLD: Fields = (
    *(*_TIMES, ("local_frame", "u1"), ("x", "f4"), ("y", "f4"), ("z", "f4")),
    *(("q", Repeated("f4", 4)), ("q_offset", Repeated("f4", 4))),
    *(("pose_covariance", Repeated("f4", 21)), ("velocity_frame", "u1")),
    *(("vx", "f4"), ("vy", "f4"), ("vz", "f4"), ("rates", Repeated("f4", 3))),
    *(("velocity_covariance", Repeated("f4", 21)), ("reset_counter", "u1")),
)
_ODOMETRY: Fields = (
    *(*_TIMES, ("pose_frame", "u1"), ("position", Repeated("f4", 3))),
    *(("q", Repeated("f4", 4)), ("velocity_frame", "u1"), ("velocity", Repeated("f4", 3))),
    *(("angular_velocity", Repeated("f4", 3)), ("position_variance", Repeated("f4", 3))),
    *(("orientation_variance", Repeated("f4", 3)), ("velocity_variance", Repeated("f4", 3))),
    *(("reset_counter", "u1"), ("quality", "i1")),
)
_HEAD = 4  # bytes of CDR's encapsulation
# Fields by the size of a serialised message in bytes, of the releases 1.13 to 1.18. The fields
# after the last one that is needed differ, and are bytes here.
_SIZES: dict[str, dict[int, tuple[Fields, int]]] = {
    ODOMETRY: {265: (_ODOMETRY_OLD, 261), 118: (_ODOMETRY, 114)},
    VISUAL: {265: (_ODOMETRY_OLD, 261)},
    LOCAL_POSITION: dict.fromkeys((184, 188, 204, 220), (_LOCAL, 64)),
    ATTITUDE: {53: ((*_TIMES, ("q", Repeated("f4", 4))), 32)},
    GPS: {
        132: ((("timestamp", "u8"), *_GPS_OLD), 48),
        145: ((*_TIMES, *_GPS_OLD), 56),
        **dict.fromkeys((163, 167, 180), (_GPS_NEW, 76)),
    },
}
_SLACK = 3  # bytes; writers may fill up to a multiple of four


class Px4Plan:
    """How messages of a type are decoded: by the definition in the bag, else by their size."""

    def __init__(self, fields: Fields | None, message_type: str) -> None:
        self._type = message_type
        self._own = None if fields is None else CdrPlan(fields)

    def decode(self, payloads: Any) -> Columns:
        """Return the columns of serialised messages; those that can't be decoded are left out."""
        sizes = np.fromiter(map(len, payloads), np.int64, len(payloads))
        buffer = np.frombuffer(b"".join(payloads), dtype=np.uint8)
        return self.decode_at(buffer, np.cumsum(sizes) - sizes, sizes)

    def decode_at(self, buffer: Buffer, begins: Indices, sizes: Indices) -> Columns:
        """Return the columns of messages in a buffer; the most frequent size is the layout's."""
        if self._own is not None:
            return self._own.decode_at(buffer, begins, sizes)
        known = _SIZES[self._type]
        found = {
            size: np.flatnonzero((sizes >= size) & (sizes <= size + _SLACK)) for size in known
        }
        size = max(found, key=lambda each: len(found[each]))
        fields, end = known[size]
        rest = size - _HEAD - end
        plan = CdrPlan((*fields, ("rest", Repeated("u1", rest))) if rest else fields)
        rows = found[size]
        part = plan.decode_at(buffer, begins[rows], sizes[rows])
        return Columns(rows[part.rows], part.numbers, {}, {})


def expected_sizes(message_type: str) -> str:
    """Return why messages of a type that no layout fits can't be decoded."""
    sizes = ", ".join(map(str, sorted(_SIZES[message_type])))
    return (
        f"they have no definition, and {message_type} has {sizes} bytes in px4_msgs 1.13 to 1.18; "
        "use the branch of px4_msgs of the firmware: release/1.13 and release/1.14 differ"
    )


def poses_of_px4(
    columns: Columns, message_type: str, undecodable: int, *, covariance: bool = True
) -> PoseColumns:
    """Return decoded messages as poses in ROS axes; poses without a position are dropped.

    Messages of `ATTITUDE` become orientations at the origin, for `with_attitudes`.

    Raises:
        InputError: The messages lack a field that the type needs.
    """
    fields = _Fields(columns.numbers, len(columns.rows), message_type)
    if message_type == GPS:
        return _fixes(fields, columns.rows, undecodable)
    if message_type == ATTITUDE:
        found = fields.of("q", width=4)
        are_ned = np.ones(fields.count, dtype=bool)
        attitudes = fields.columns(
            columns.rows, undecodable, np.zeros((fields.count, 3)), _turned(found, are_ned)
        )
        return _usable(attitudes, np.where(are_ned, _NED, _FRD), no_orientation=~_is_unit(found))
    if message_type == LOCAL_POSITION:
        return _local_positions(fields, columns.rows, undecodable)
    return _odometry(fields, columns.rows, undecodable, covariance=covariance)


class _Fields:
    """The numbers of N messages, as doubles."""

    def __init__(self, numbers: Mapping[str, NDArray[Any]], count: int, where: str) -> None:
        self._numbers, self.count, self._where = numbers, count, where

    def __contains__(self, name: str) -> bool:
        return name in self._numbers

    def of(self, *names: str, width: int = 1) -> Floats:
        """Return fields of a width side by side, (N, k)."""
        missing = [name for name in names if name not in self._numbers]
        if missing:
            raise InputError(
                f"{self._where} has no field {missing[0]}; use px4_msgs of PX4 1.12 or later"
            )
        columns = [np.asarray(self._numbers[name], dtype=np.float64) for name in names]
        if any(column.size != self.count * width for column in columns):
            raise InputError(f"{self._where} has another layout than px4_msgs 1.12 to 1.18")
        return np.hstack([column.reshape(self.count, width) for column in columns])

    def codes(self, name: str) -> NDArray[np.int64]:
        """Return a field of whole numbers (N,); zeros if the type lacks it."""
        if name not in self._numbers:
            return np.zeros(self.count, dtype=np.int64)
        return np.asarray(self._numbers[name]).reshape(self.count).astype(np.int64)

    @property
    def stamps(self) -> Stamps:
        """Times of measurement (N,), ns: `timestamp_sample` if it is set and plausible.

        A field that is not set is 0, or the time of boot after the bridge has added its offset.
        """
        self.of("timestamp")
        published, measured = (
            np.clip(self.codes(name), 0, _LAST_US) for name in ("timestamp", "timestamp_sample")
        )
        delay = published - measured
        use = (measured > 0) & (delay >= 0) & (delay <= _LARGEST_DELAY_US)
        stamps: Stamps = np.where(use, measured, published) * 1000
        return stamps

    def columns(
        self, rows: Indices, undecodable: int, positions: Floats, turns: Floats | None = None
    ) -> PoseColumns:
        """Return the poses of all messages, without frames."""
        return PoseColumns(self.stamps, positions, turns, None, None, None, [], rows, undecodable)

    @property
    def resets(self) -> NDArray[np.int64]:
        """The reset counters (N,), several of them as one number."""
        names = ("reset_counter", "xy_reset_counter", "z_reset_counter", "heading_reset_counter")
        one = np.zeros(self.count, dtype=np.int64)
        for name in names:
            one = one * 256 + self.codes(name)
        return one


def _odometry(
    fields: _Fields, rows: Indices, undecodable: int, *, covariance: bool
) -> PoseColumns:
    old = "x" in fields
    if old:
        positions, velocities = fields.of("x", "y", "z"), fields.of("vx", "vy", "vz")
        frames, of_velocity = (
            _OLD_FRAMES[np.clip(fields.codes(name), 0, 3)]
            for name in ("local_frame", "velocity_frame")
        )
        frames[frames == _BODY] = _UNKNOWN
    else:
        positions, velocities = fields.of("position", width=3), fields.of("velocity", width=3)
        frames, of_velocity = fields.codes("pose_frame"), fields.codes("velocity_frame")
    quaternions = fields.of("q", width=4)
    turns = _turned(quaternions, frames == _NED)
    worlds = np.where((frames == _NED)[:, None, None], _M, _B)
    moved = np.einsum("nij,nj->ni", worlds, velocities)
    no_position = ~np.isfinite(positions).all(axis=1)
    no_orientation = ~no_position & ~_is_unit(quaternions)
    unknown = ~no_position & ~no_orientation & (frames != _NED) & (frames != _FRD)
    usable = ~(no_position | no_orientation | unknown)
    rotations = lie.to_matrix(np.where(usable[:, None], turns, [0.0, 0.0, 0.0, 1.0]))
    in_body = of_velocity == _BODY
    moved[in_body] = np.einsum("nij,nj->ni", rotations[in_body], velocities[in_body] @ _B)
    moved[~in_body & (of_velocity != frames)] = np.nan
    covariances = None
    if covariance:
        read = _old_covariances if old else _covariances
        covariances = read(fields, worlds, rotations)
    poses = fields.columns(
        rows, undecodable, np.einsum("nij,nj->ni", worlds, positions), turns
    ).replaced(
        velocities=moved,
        covariances=covariances,
        flags=np.column_stack([fields.resets, fields.codes("quality")]),
    )
    return _usable(
        poses,
        frames,
        no_position=no_position,
        no_orientation=no_orientation,
        unknown_frame=unknown,
    )


def _covariances(fields: _Fields, worlds: Floats, rotations: Floats) -> Floats:
    """Return the covariances (N, 6, 6) of variances: about the world's and the body's axes."""
    found = np.zeros((fields.count, 6, 6))
    for first, name, axes in (
        (0, "position_variance", worlds),
        (3, "orientation_variance", rotations),
    ):
        variances = fields.of(name, width=3)
        variances[~(variances > 0.0)] = np.nan
        part = slice(first, first + 3)
        found[:, part, part] = axes @ (variances[:, :, None] * np.swapaxes(axes, 1, 2))
    return found


def _old_covariances(fields: _Fields, worlds: Floats, rotations: Floats) -> Floats:  # noqa: ARG001
    """Return the covariances (N, 6, 6) of 1.13: the upper triangle about the world's axes."""
    found = np.zeros((fields.count, 6, 6))
    rows, columns = np.triu_indices(6)
    found[:, rows, columns] = found[:, columns, rows] = fields.of("pose_covariance", width=21)
    both = np.zeros_like(found)
    both[:, :3, :3] = both[:, 3:, 3:] = worlds
    turned: Floats = both @ found @ np.swapaxes(both, 1, 2)
    return turned


def _local_positions(fields: _Fields, rows: Indices, undecodable: int) -> PoseColumns:
    positions = fields.of("x", "y", "z")
    not_finite = ~np.isfinite(positions).all(axis=1)
    no_level, no_height = (
        ~not_finite & (fields.codes(f"{axis}_valid") == 0) for axis in ("xy", "z")
    )
    poses = fields.columns(rows, undecodable, positions @ _M).replaced(
        velocities=fields.of("vx", "vy", "vz") @ _M,
        flags=np.column_stack([fields.resets, np.zeros(fields.count, dtype=np.int64)]),
    )
    return _usable(
        poses,
        np.full(fields.count, _NED),
        no_position=not_finite,
        xy_valid_false=no_level,
        z_valid_false=no_height & ~no_level,
    )


def _fixes(fields: _Fields, rows: Indices, undecodable: int) -> PoseColumns:
    """Return GNSS fixes; heights are the ellipsoid's, eph is used per horizontal axis."""
    if "lat" in fields:
        places = fields.of("lat", "lon", "alt_ellipsoid") * [1e-7, 1e-7, 1e-3]
    else:
        places = fields.of("latitude_deg", "longitude_deg", "altitude_ellipsoid_m")
    sigmas = np.square(fields.of("eph", "eph", "epv"))
    status = _STATUS[np.clip(fields.codes("fix_type"), 0, len(_STATUS) - 1)]
    quality = np.zeros((fields.count, 11))
    quality[:, 0], quality[:, 1] = status, _APPROXIMATED
    quality[:, [2, 6, 10]] = sigmas
    frames = [(0, "", "")] if fields.count else []
    return fields.columns(rows, undecodable, places).replaced(fix_quality=quality, frames=frames)


def _usable(
    columns: PoseColumns, frames: NDArray[np.int64], **faults: NDArray[np.bool_] | np.bool_
) -> PoseColumns:
    """Return the poses (N) without a fault, in frames by code (N,); the others are counted."""
    usable = ~np.logical_or.reduce(list(faults.values()))
    frames = frames[usable]
    firsts = np.flatnonzero(np.diff(frames, prepend=_UNKNOWN)).tolist()
    return columns.rows_of(usable).replaced(
        frames=[(row, _FRAMES[int(frames[row])], _CHILD) for row in firsts],
        dropped={name: int(np.count_nonzero(bad)) for name, bad in faults.items()},
    )


def _turned(quaternions: Floats, are_ned: Booleans) -> Floats:
    """Return quaternions (N, 4), wxyz of FRD in NED or FRD, as xyzw of FLU in ENU or FLU."""
    w, x, y, z = quaternions.T
    ned = np.sqrt(0.5) * np.stack([x + y, x - y, w - z, w + z], axis=1)
    return np.where(are_ned[:, None], ned, np.stack([x, -y, -z, w], axis=1))


def _is_unit(quaternions: Floats) -> Booleans:
    unit: Booleans = np.abs(np.linalg.norm(quaternions, axis=1) - 1.0) < _UNIT
    return unit


def why_none(dropped: Mapping[str, int]) -> str:
    """Return why no message has a pose, from the numbers of dropped messages by reason."""
    total = sum(dropped.values())
    for name, axis in (("xy", "horizontal"), ("z", "vertical")):
        if dropped.get(f"{name}_valid_false") == total:
            return (
                f"{name}_valid is false in all {total} messages: the estimator had no {axis} "
                "position"
            )
    return reasons({reason: count for reason, count in dropped.items() if count})


def about_px4(columns: PoseColumns) -> Iterator[Remark]:
    """Yield the notes on converted poses."""
    if columns.fix_quality is None:
        world = "NED" if columns.frames[0][1] == _FRAMES[_NED] else "FRD"
        yield note("converted_axes", f"converted from {world} and a body in FRD to ROS axes")
    failed = 0 if columns.flags is None else int(np.count_nonzero(columns.flags[:, 1] < 0))
    if failed:
        yield note("failed_quality", f"{counted(failed, 'message')} with quality -1 (failed)")


def attitude_name(name: str) -> str:
    """Return the name of the attitude's topic that belongs to a topic of local positions."""
    return name.replace("local_position", "attitude").removesuffix("_v1")


def with_attitudes(columns: PoseColumns, attitudes: PoseColumns) -> PoseColumns:
    """Return positions with orientations interpolated between attitudes at most 0.1 s apart."""
    times, firsts = np.unique(attitudes.stamps, return_index=True)
    assert attitudes.quaternions is not None
    if not len(times):
        return columns
    bracket = bracket_stamps(times, columns.stamps, _LARGEST_GAP_S)
    turns = slerp(attitudes.quaternions[firsts], bracket.start, bracket.end, bracket.fraction)
    return columns.replaced(quaternions=turns).picked(bracket.usable, "no_attitude_within_0.1_s")


def majority_frame(columns: PoseColumns) -> PoseColumns:
    """Return the poses of the more frequent of NED and FRD; the others are dropped."""
    if len(columns.frames) < 2:
        return columns
    rows = [row for row, *_ in columns.frames]
    are_ned = [frame == _FRAMES[_NED] for _, frame, _ in columns.frames]
    ned = np.repeat(are_ned, np.diff([*rows, len(columns.stamps)]))
    return columns.picked(ned if 2 * np.count_nonzero(ned) >= len(ned) else ~ned, "other_frame")
