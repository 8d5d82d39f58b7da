"""Messages of PX4 (px4_msgs, uORB) as poses in ROS axes: east, north, up; forward, left, up.

PX4's world is north, east, down (NED), or forward, right, down with a free heading (FRD). Its body
is FRD. With M = [[0,1,0],[1,0,0],[0,0,-1]] and B = diag(1,-1,-1), poses become p' = W p and
R' = W R B, where W is M for NED and B for FRD. Both are rotations and their own inverse.
Sources: px4_msgs, release/1.13 to release/1.18.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

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

ODOMETRY, VISUAL, LOCAL_POSITION, ATTITUDE, GPS = (
    f"px4_msgs/msg/{name}"
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
_OLD_FRAMES = np.array([_NED, _FRD, _UNKNOWN, _BODY])  # the same of 1.13, by its codes
_UNIT = 1e-2  # largest deviation of a quaternion's length
_LARGEST_DELAY_US = 1_000_000  # from the measurement to its publication
_LARGEST_GAP_S = 0.1  # between the attitudes around a position
_LAST_US = (2**63 - 1) // 1000
_APPROXIMATED = 1  # covariance type of NavSatFix
_STATUS = np.array([-1, -1, -1, 0, 1, 2, 2, -1, 0])  # of NavSatFix, by PX4's fix_type

# Names, types and lengths of the fields up to the last one that is needed.
_TIMES = "timestamp:u8 timestamp_sample:u8 "
_GPS_ERRORS = "s_variance_m_s:f4 c_variance_rad:f4 fix_type:u1 eph:f4 epv:f4"
_GPS_OLD = "device_id:u4 lat:i4 lon:i4 alt:i4 alt_ellipsoid:i4 " + _GPS_ERRORS
_GPS_NEW = (
    f"{_TIMES}device_id:u4 latitude_deg:f8 longitude_deg:f8 altitude_msl_m:f8 "
    f"altitude_ellipsoid_m:f8 {_GPS_ERRORS}"
)
_LOCAL = (
    f"{_TIMES}xy_valid:u1 z_valid:u1 v_xy_valid:u1 v_z_valid:u1 x:f4 y:f4 z:f4 delta_xy:f4*2 "
    "xy_reset_counter:u1 delta_z:f4 z_reset_counter:u1 vx:f4 vy:f4 vz:f4"
)
_ODOMETRY_OLD = (
    f"{_TIMES}local_frame:u1 x:f4 y:f4 z:f4 q:f4*4 q_offset:f4*4 pose_covariance:f4*21 "
    "velocity_frame:u1 vx:f4 vy:f4 vz:f4 rates:f4*3 velocity_covariance:f4*21 reset_counter:u1"
)
_ODOMETRY = (
    f"{_TIMES}pose_frame:u1 position:f4*3 q:f4*4 velocity_frame:u1 velocity:f4*3 "
    "angular_velocity:f4*3 position_variance:f4*3 orientation_variance:f4*3 "
    "velocity_variance:f4*3 reset_counter:u1 quality:i1"
)
_HEAD = 4  # bytes of CDR's encapsulation
# Fields, and the byte that they end at, by the size of a serialised message, 1.13 to 1.18.
_SIZES: dict[str, dict[int, tuple[str, int]]] = {
    ODOMETRY: {265: (_ODOMETRY_OLD, 261), 118: (_ODOMETRY, 114)},
    VISUAL: {265: (_ODOMETRY_OLD, 261)},
    LOCAL_POSITION: dict.fromkeys((184, 188, 204, 220), (_LOCAL, 64)),
    ATTITUDE: {53: (f"{_TIMES}q:f4*4", 32)},
    GPS: {
        132: (f"timestamp:u8 {_GPS_OLD}", 48),
        145: (_TIMES + _GPS_OLD, 56),
        **dict.fromkeys((163, 167, 180), (_GPS_NEW, 76)),
    },
}
_SLACK = 3  # bytes; writers may fill up to a multiple of four


class Px4Plan(CdrPlan):
    """How messages of a type without a definition are decoded: by their size."""

    def __init__(self, message_type: str) -> None:
        self._sizes = _SIZES[message_type]

    def decode_at(self, buffer: Buffer, begins: Indices, sizes: Indices) -> Columns:
        """Return the columns of messages in a buffer; the most frequent size is the layout's."""
        rows_of_size = {
            size: np.flatnonzero((sizes >= size) & (sizes <= size + _SLACK))
            for size in self._sizes
        }
        size = max(rows_of_size, key=lambda item: len(rows_of_size[item]))
        layout, end = self._sizes[size]
        rest = size - _HEAD - end
        rows = rows_of_size[size]
        plan = CdrPlan(_fields(f"{layout} rest:u1*{rest}" if rest else layout))
        part = plan.decode_at(buffer, begins[rows], sizes[rows])
        return Columns(rows[part.rows], part.numbers, {}, {})


def _fields(layout: str) -> Fields:
    parts = (word.replace("*", ":").split(":") for word in layout.split())
    return tuple(
        (name, Repeated(kind, int(length[0])) if length else kind) for name, kind, *length in parts
    )


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
    fields = _Numbers(columns, message_type)
    origin, are_ned = np.zeros((fields.count, 3)), np.full(fields.count, _NED)
    poses = PoseColumns(
        fields.stamps, origin, None, None, None, None, [], columns.rows, undecodable
    )
    if message_type == GPS:
        return _fixes(fields, poses)
    if message_type == ATTITUDE:
        quaternions = fields.of("q", 4)
        poses = poses.replaced(quaternions=_rotated(quaternions, are_ned == _NED))
        return _usable(poses, are_ned, no_orientation=~_is_unit(quaternions))
    counters = [fields.codes(f"{item}reset_counter") for item in ("", "xy_", "z_", "heading_")]
    resets = np.array([1 << 24, 1 << 16, 1 << 8, 1]) @ counters
    poses = poses.replaced(flags=np.column_stack([resets, fields.codes("quality")]))
    if message_type != LOCAL_POSITION:
        return _odometry(fields, poses, covariance=covariance)
    positions = fields.of("x y z", 3)
    no_position = ~np.isfinite(positions).all(axis=1)
    no_level, no_height = (
        ~no_position & (fields.codes(f"{axis}_valid") == 0) for axis in ("xy", "z")
    )
    return _usable(
        poses.replaced(positions=positions @ _M, velocities=fields.of("vx vy vz", 3) @ _M),
        are_ned,
        no_position=no_position,
        xy_valid_false=no_level,
        z_valid_false=no_height & ~no_level,
    )


class _Numbers:
    """The numbers of N messages, as doubles."""

    def __init__(self, columns: Columns, where: str) -> None:
        self.has, self.count, self._where = columns.numbers, len(columns.rows), where

    def of(self, names: str, width: int) -> Floats:
        """Return fields side by side, (N, width)."""
        fields = names.split()
        for name in fields:
            if name not in self.has:
                raise InputError(
                    f"{self._where} has no field {name}; use px4_msgs of PX4 1.12 or later"
                )
        item = width // len(fields)
        if any(self.has[name].size != self.count * item for name in fields):
            raise InputError(f"{self._where} has another layout than px4_msgs 1.12 to 1.18")
        parts = [self.has[name].reshape(self.count, item) for name in fields]
        return np.hstack(parts).astype(np.float64)

    def codes(self, name: str) -> NDArray[np.int64]:
        """Return a field of whole numbers (N,); zeros if the type lacks it."""
        if name not in self.has:
            return np.zeros(self.count, dtype=np.int64)
        return self.has[name].reshape(self.count).astype(np.int64)

    @property
    def stamps(self) -> Stamps:
        """Times of measurement (N,), ns: `timestamp_sample` if it is set and plausible.

        A field that is not set is 0, or the time of boot after the bridge has added its offset.
        """
        self.of("timestamp", 1)
        published, measured = (
            np.clip(self.codes(name), 0, _LAST_US) for name in ("timestamp", "timestamp_sample")
        )
        delay = published - measured
        use = (measured > 0) & (delay >= 0) & (delay <= _LARGEST_DELAY_US)
        stamps: Stamps = np.where(use, measured, published) * 1000
        return stamps


def _odometry(fields: _Numbers, poses: PoseColumns, *, covariance: bool) -> PoseColumns:
    old = "x" in fields.has
    names = ("x y z", "vx vy vz", "local_frame") if old else ("position", "velocity", "pose_frame")
    positions, velocities, quaternions = (
        fields.of(name, width) for name, width in ((names[0], 3), (names[1], 3), ("q", 4))
    )
    frames, of_velocity = fields.codes(names[2]), fields.codes("velocity_frame")
    if old:
        frames, of_velocity = (
            _OLD_FRAMES[np.clip(codes, 0, 3)] for codes in (frames, of_velocity)
        )
    no_position = ~np.isfinite(positions).all(axis=1)
    no_orientation = ~no_position & ~_is_unit(quaternions)
    unknown = ~no_position & ~no_orientation & (frames != _NED) & (frames != _FRD)
    usable = ~(no_position | no_orientation | unknown)
    turns = _rotated(quaternions, frames == _NED)
    rotations = lie.to_matrix(np.where(usable[:, None], turns, [0.0, 0.0, 0.0, 1.0]))
    worlds = np.where((frames == _NED)[:, None, None], _M, _B)
    in_body = of_velocity == _BODY
    axes = np.where(in_body[:, None, None], rotations @ _B, worlds)
    moved = np.einsum("nij,nj->ni", axes, velocities)
    moved[~in_body & (of_velocity != frames)] = np.nan
    poses = poses.replaced(
        positions=np.einsum("nij,nj->ni", worlds, positions),
        quaternions=turns,
        velocities=moved,
        covariances=_covariances(fields, worlds, rotations) if covariance else None,
    )
    faults = {"no_position": no_position, "no_orientation": no_orientation}
    return _usable(poses, frames, **faults, unknown_frame=unknown)


def _covariances(fields: _Numbers, worlds: Floats, rotations: Floats) -> Floats:
    """Return the covariances (N, 6, 6) about the fixed axes; unknown blocks are NaN.

    The upper triangle of 1.13 is about the world's axes. Later variances of orientations are about
    the body's.
    """
    covariances, turns = np.zeros((fields.count, 6, 6)), np.stack([worlds, worlds], axis=1)
    if "pose_covariance" in fields.has:
        rows, columns = np.triu_indices(6)
        covariances[:, rows, columns] = covariances[:, columns, rows] = fields.of(
            "pose_covariance", 21
        )
    else:
        turns[:, 1] = rotations
        variances = fields.of("position_variance orientation_variance", 6)
        covariances[:, range(6), range(6)] = np.where(variances > 0.0, variances, np.nan)
    blocks = covariances.reshape(-1, 2, 3, 2, 3)
    rotated: Floats = np.einsum("naij,najbk,nblk->naibl", turns, blocks, turns, optimize=True)
    return rotated.reshape(-1, 6, 6)


def _fixes(fields: _Numbers, poses: PoseColumns) -> PoseColumns:
    """Return GNSS fixes; heights are the ellipsoid's, eph is used per horizontal axis."""
    if "lat" in fields.has:
        places = fields.of("lat lon alt_ellipsoid", 3) * [1e-7, 1e-7, 1e-3]
    else:
        places = fields.of("latitude_deg longitude_deg altitude_ellipsoid_m", 3)
    quality = np.zeros((fields.count, 11))
    quality[:, 0] = _STATUS[np.clip(fields.codes("fix_type"), 0, len(_STATUS) - 1)]
    quality[:, 1] = _APPROXIMATED
    quality[:, [2, 6, 10]] = np.square(fields.of("eph eph epv", 3))
    frames = [(0, "", "")] if fields.count else []
    return poses.replaced(positions=places, fix_quality=quality, frames=frames)


def _usable(
    columns: PoseColumns, frames: NDArray[np.int64], **faults: NDArray[np.bool_] | np.bool_
) -> PoseColumns:
    """Return the poses (N) without a fault, in frames by code (N,); the others are counted."""
    usable = ~np.logical_or.reduce(list(faults.values()))
    frames = frames[usable]
    firsts = np.flatnonzero(np.diff(frames, prepend=_UNKNOWN)).tolist()
    return columns.rows_of(usable).replaced(
        frames=[(row, _FRAMES[int(frames[row])], "base_link_flu") for row in firsts],
        dropped={name: int(np.count_nonzero(bad)) for name, bad in faults.items()},
    )


def _rotated(quaternions: Floats, are_ned: Booleans) -> Floats:
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
    if columns.covariances is not None:
        unknown = np.isnan(columns.covariances.diagonal(axis1=1, axis2=2)[:, [0, 3]])
        notes = [
            f"{counted(int(lacks.sum()), 'message')} without variances of the {what}"
            for lacks, what in zip(unknown.T, ("position", "orientation"), strict=True)
            if lacks.any()
        ]
        if notes and not unknown.all():
            text = f"covariances are incomplete: {', '.join(notes)}"
            yield note("incomplete_covariances", text)
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
    rotations = slerp(attitudes.quaternions[firsts], bracket.start, bracket.end, bracket.fraction)
    return columns.replaced(quaternions=rotations).picked(
        bracket.usable, "no_attitude_within_0.1_s"
    )


def majority_frame(columns: PoseColumns) -> PoseColumns:
    """Return the poses of the more frequent of NED and FRD; the others are dropped."""
    if len(columns.frames) < 2:
        return columns
    rows = [row for row, *_ in columns.frames]
    are_ned = [frame == _FRAMES[_NED] for _, frame, _ in columns.frames]
    ned = np.repeat(are_ned, np.diff([*rows, len(columns.stamps)]))
    return columns.picked(ned if 2 * np.count_nonzero(ned) >= len(ned) else ~ned, "other_frame")
