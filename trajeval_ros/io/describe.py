"""Contents of a source: trajectories, their key figures and known systems, and a bag's TF tree.

Systems are recognised by the type, name and frames of a topic, as their sources state. A wrong
name is worse than none: frames that many systems share, such as `odom` and `base_link`, identify
none of them. Nothing is applied.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trajeval_ros.diagnosis.column_tests import is_named_groundtruth
from trajeval_ros.exceptions import InputError, reason_of
from trajeval_ros.formatting.remarks import Remark, note
from trajeval_ros.geometry.fixes import quality_of
from trajeval_ros.geometry.source_info import FORMATS
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.io.sources import Advance, parse_source, read_trajectory
from trajeval_ros.io.text.hints import NO_HINTS, TextHints

_COMMAND = re.compile(
    r"(?<![a-z])(goal|initial.?pose|clicked|set.?point|way.?points?|plan(ned|ner)?|target|desired"
    r"|command(ed)?|cmd)(?![a-z])",
    re.IGNORECASE,
)
LONG_GAP_S = 0.5  # association does not interpolate over longer gaps


@dataclass(frozen=True)
class TrajectorySummary:
    """Key figures of a trajectory."""

    source: str
    kind: str  # message type, or format of the file
    poses: int  # number of states
    columns: str = ""  # of a text file, as --columns takes them
    rate_hz: float = 0.0  # inverse of the median time step; 0 without time steps
    timed: bool = True  # whether the states have timestamps
    first_ns: int = 0  # earliest timestamp
    last_ns: int = 0  # latest timestamp
    path_length_m: float = 0.0
    mean_speed_mps: float = 0.0  # path length divided by the duration; 0 without timestamps
    # Largest speed between consecutive states; 0 without timestamps.
    largest_speed_mps: float = 0.0
    frame: str = ""  # fixed frame, "" if unknown
    child_frame: str = ""  # frame of the body, "" if unknown
    holds: tuple[str, ...] = ()  # quantities in addition to positions, such as "rotation"
    gaps: int = 0  # number of time steps longer than `LONG_GAP_S`
    longest_gap_s: float = 0.0  # longest time step, seconds
    fixed: bool = False  # whether the positions are GNSS fixes
    flat: bool = False  # whether all heights are equal
    # Likely role: "groundtruth", "estimate", "estimate or groundtruth" or "command".
    could_be: str = ""
    # Remarks of the reader, the quality of fixes, and the number of dropped rows by reason.
    remarks: tuple[Remark, ...] = ()

    system: KnownSystem | None = None  # the system that probably published it
    problem: str = ""  # reason why the trajectory can't be evaluated, "" if it can

    @property
    def messages(self) -> tuple[str, ...]:
        """The sentences of the remarks, except the format."""
        return tuple(remark.text for remark in self.remarks if remark.code not in FORMATS)

    @property
    def topic(self) -> str:
        """The topic of the source with its slash, or the name of the file."""
        return self.source.rpartition(":")[2] if ":" in self.source else Path(self.source).name


@dataclass(frozen=True)
class EdgeSummary:
    """A transform of the TF tree: the pose of the child frame in the parent frame."""

    topic: str
    parent: str
    child: str
    is_static: bool
    count: int
    rate_hz: float


@dataclass(frozen=True)
class Description:
    """Contents of a source."""

    path: Path  # the file or directory
    # Trajectories in the source, also those with a problem.
    trajectories: tuple[TrajectorySummary, ...]
    edges: tuple[EdgeSummary, ...] = ()  # transforms of the TF tree
    # (topic, type, number of messages, fields with poses) of the topics of other types.
    others: tuple[tuple[str, str, int, str], ...] = ()
    remarks: tuple[Remark, ...] = ()  # remarks of the reader of a bag


def describe(
    source: str,
    *,
    advance: Advance | None = None,
    hints: TextHints = NO_HINTS,
    read: dict[str, Trajectory] | None = None,
    covariances: bool = True,
) -> Description:
    """Return the contents of a SOURCE; for a bag without a topic, of all its topics.

    `advance`: progress callback, called with the amount done and the total. `hints`: columns and
    frame rate of a text file, as the user states them. `read`: receives the trajectories of a bag
    or file by their SOURCE. `covariances`: whether to read those of a bag.
    """
    read = {} if read is None else read
    parts = parse_source(source)
    if parts.is_bag and not parts.topic:
        try:
            return _describe_bag(source, parts.path, advance, read, covariances=covariances)
        except OSError as error:
            raise InputError(f"{parts.path} can't be read: {reason_of(error)}") from error
    if parts.is_log and not parts.topic:
        return _describe_log(source, parts.path, read)
    read[source] = trajectory = read_trajectory(source, advance=advance, hints=hints)
    return Description(parts.path, (summarize(source, trajectory),))


def _describe_log(source: str, path: Path, read: dict[str, Trajectory]) -> Description:
    """Return the topics with poses of a log of PX4, and put its trajectories into `read`."""
    from trajeval_ros.io.ulog import PoseLog

    log = PoseLog(path)
    topics = []
    for topic in log.topics:
        name = f"{source}:{topic}"
        try:
            read[name] = log.trajectory(topic)
            topics.append(summarize(name, read[name]))
        except InputError as error:
            topics.append(TrajectorySummary(name, "ULog", log.count(topic), problem=str(error)))
    return Description(path, tuple(topics), remarks=tuple(log.remarks))


def _describe_bag(
    source: str,
    path: Path,
    advance: Advance | None,
    read: dict[str, Trajectory],
    *,
    covariances: bool,
) -> Description:
    """Return the contents of all topics of a bag, and put its trajectories into `read`."""
    from trajeval_ros.io.bags.bag import Bag
    from trajeval_ros.io.bags.nested_poses import nested_poses
    from trajeval_ros.io.bags.topic_readers import (
        PoseReader,
        TransformReader,
        read_topics,
        tree_of,
        tree_topics,
    )
    from trajeval_ros.io.bags.topics import trajectory_of

    trajectories = []
    others = []
    edges: dict[tuple[str, str, str], EdgeSummary] = {}
    with Bag(path, advance) as bag:
        posed = {
            topic: PoseReader(bag, topic, covariances=covariances)
            for topic in bag.topics
            if topic.holds_poses and topic.count
        }
        transforms = {
            topic: TransformReader(topic) for topic in bag.topics if topic.holds_transforms
        }
        readers: list[PoseReader | TransformReader] = [*posed.values(), *transforms.values()]
        read_topics(bag, readers)
        for topic in bag.topics:
            name = f"{source}:{topic.name}"
            if topic in posed:
                try:
                    read[name] = trajectory_of(bag, posed[topic])
                    trajectories.append(summarize(name, read[name]))
                except InputError as error:
                    trajectories.append(
                        TrajectorySummary(name, topic.type, topic.count, problem=str(error))
                    )
            elif topic.holds_transforms and not topic.name.endswith("_static"):
                tree_edges = tree_of(
                    transforms[tree_topic] for tree_topic in tree_topics(bag, topic.name)
                )
                for key, edge in tree_edges.items():
                    rate_hz, count = _rate_hz(edge.stamps), len(edge.stamps)
                    edges[(topic.name, *key)] = EdgeSummary(
                        topic.name, *key, edge.is_static, count, rate_hz
                    )
            elif not topic.holds_transforms:
                inside = ", ".join(place.field or "itself" for place in nested_poses(topic.fields))
                others.append((topic.name, topic.type, topic.count, inside))
        remarks = bag.remarks([reader.reading for reader in readers])
    tree = sorted(edges.values(), key=lambda edge: (edge.topic, edge.is_static, edge.parent))
    return Description(path, tuple(trajectories), tuple(tree), tuple(others), remarks)


def summarize(source: str, trajectory: Trajectory) -> TrajectorySummary:
    """Return the key figures of a trajectory."""
    ordered = trajectory.in_order()
    steps = np.diff(ordered.stamps) / NANOSECONDS
    columns = {
        "rotation": trajectory.quaternions,
        "velocity": trajectory.velocities,
        "gyroscope bias": trajectory.gyroscope_biases,
        "accelerometer bias": trajectory.accelerometer_biases,
        "covariance": trajectory.covariances,
    }
    holds = tuple(name for name, column in columns.items() if column is not None)
    reading = ordered.reading
    remarks = list(reading.remarks)
    if reading.fixes is not None:
        remarks.append(note("fix_quality", quality_of(reading.fixes)))
    for reason, count in reading.dropped.items():
        remarks.append(note("dropped", f"{count} dropped: {reason.replace('_', ' ')}"))
    unstamped = not reading.stamped
    travelled = ordered.travelled
    speeds = np.zeros(0) if unstamped else np.diff(travelled) / steps
    still = unstamped or len(ordered) < 2
    kind = reading.format.removeprefix("ULog, ")
    topic = source.rpartition(":")[2]
    return TrajectorySummary(
        source=source,
        kind=reading.format,
        columns=reading.columns,
        system=recognised(kind, topic, ordered.frame, ordered.child_frame),
        poses=len(ordered),
        rate_hz=0.0 if unstamped else _rate_hz(ordered.stamps),
        timed=reading.stamped,
        first_ns=int(ordered.stamps[0]),
        last_ns=int(ordered.stamps[-1]),
        path_length_m=float(travelled[-1]),
        mean_speed_mps=0.0 if still else float(travelled[-1]) / ordered.duration_s,
        largest_speed_mps=float(speeds.max(initial=0.0)),
        frame=ordered.frame,
        child_frame=ordered.child_frame,
        holds=holds,
        gaps=0 if unstamped else int(np.count_nonzero(steps > LONG_GAP_S)),
        longest_gap_s=0.0 if unstamped else float(steps.max(initial=0.0)),
        fixed=reading.fixes is not None,
        flat=float(np.ptp(ordered.positions[:, 2])) == 0.0 < float(travelled[-1]),
        could_be=_could_be(source, trajectory),
        remarks=tuple(remarks),
    )


def _could_be(source: str, trajectory: Trajectory) -> str:
    """Return the likely role, from the name and from quantities that only estimators output."""
    if trajectory.reading.fixes is not None:
        return "groundtruth"
    # A topic, or a file and its folder. The path of a bag or log is not a name of its topics.
    separator = ":" if trajectory.reading.format.startswith("ULog") else ":/"
    _, colon, topic = source.rpartition(separator)
    is_topic = colon and not topic.startswith("/")
    name = topic if is_topic else "/".join(source.split("/")[-2:])
    if is_named_groundtruth(name) or is_named_groundtruth(trajectory.frame):
        return "groundtruth"
    if is_topic and _COMMAND.search(name):
        return "command"
    if trajectory.covariances is not None or (
        trajectory.velocities is not None and trajectory.gyroscope_biases is None
    ):
        return "estimate"
    return "estimate or groundtruth"


def _rate_hz(stamps: np.ndarray[tuple[int, ...], np.dtype[np.int64]]) -> float:
    """Return the inverse of the median step of timestamps (N,); 0 without a positive median."""
    steps = np.diff(stamps)
    return NANOSECONDS / float(np.median(steps)) if len(steps) and np.median(steps) > 0 else 0.0


class KnownSystem(NamedTuple):
    """A system, and how its topics are evaluated."""

    name: str
    topic: str  # regular expression of the end of the topic's name, "" for any
    frames: tuple[str | None, str | None]  # frame and child frame; None for any
    modality: str  # "" if it can have several
    trap: str  # what to expect
    options: str = ""  # further options of `trajeval evaluate`

    def matches(self, topic: str, frame: str, child: str) -> bool:
        """Return whether a topic can be of this system."""
        pairs = zip(self.frames, (frame, child), strict=True)
        return re.search(rf"(^|/){self.topic}$", topic) is not None and all(
            expected is None or expected == other for expected, other in pairs
        )


_ANY, _ISAAC, _VIO = (None, None), "visual_slam/tracking/", "stereo-inertial"
_OF_BODY = "rotation covariances are about the body's axes"
_OF_MESSAGES = "--covariance message --rotation-covariance-frame body"
_JUMPS, _REVISED = "poses can jump at loop closures", "the path is revised at loop closures"
_TWO, _FLAT = "two filters can publish on one topic", "height, roll and pitch have variance zero"
_CONVERTED = "converted to ROS axes"
# By message type: rows of `KnownSystem`; the first match applies.
_SYSTEMS: dict[str, tuple[tuple[Any, ...], ...]] = {
    "nav_msgs/msg/Odometry": (
        ("OpenVINS", "odomimu", ("global", "imu"), _VIO, _OF_BODY, _OF_MESSAGES),
        ("VINS-Fusion", ".*odometry", ("world", "world"), _VIO, "the twist is in the world"),
        ("FAST-LIO", "Odometry", ("camera_init", "body"), "lidar-inertial",
            "covariances have the rotation first"),
        # With or without an IMU: the other topics show it.
        ("LOAM", ".*", ("camera_init", "aft_mapped"), "",
            "the frame is of the first scan, not of a camera"),
        ("KISS-ICP", "kiss/odometry", ("odom_lidar", None), "lidar",
            "covariances are parameters"),
        ("Isaac ROS Visual SLAM", f"{_ISAAC}odometry", _ANY, _VIO,
            "covariances are the scatter of recent poses"),
        ("rtabmap", "rtabmap/odom", _ANY, "rgbd", "covariances are of the last registration"),
        ("robot_localization", "odometry/(filtered|local)", _ANY, "wheel", _TWO),
        ("robot_localization", "odometry/global", _ANY, "gnss-aided", _TWO),
        ("MOLA", "lidar_odometry/pose", ("map", ""), "lidar", "messages name no body"),
        ("ZED", r"zed\w*/zed_node/odom", _ANY, _VIO, _JUMPS),
    ),
    "geometry_msgs/msg/PoseWithCovarianceStamped": (
        ("OpenVINS", "poseimu", ("global", None), _VIO, _OF_BODY, _OF_MESSAGES),
        ("Isaac ROS Visual SLAM", f"{_ISAAC}vo_pose_covariance", _ANY, _VIO,
            "covariances are of the estimator", "--covariance message"),
        ("AMCL", "amcl_pose", ("map", None), "wheel", _FLAT),
        ("slam_toolbox", "pose", ("map", None), "wheel", _FLAT),
    ),
    "geometry_msgs/msg/PoseStamped": (
        ("Spectacular AI", "slam/odometry", ("world", None), _VIO,
            "the body is a camera with optical axes", "--hand-eye auto"),
        ("ZED", r"zed\w*/zed_node/pose", ("map", None), _VIO, _JUMPS),
    ),
    "nav_msgs/msg/Path": (
        ("Isaac ROS Visual SLAM", f"{_ISAAC}slam_path", _ANY, _VIO, _REVISED),
        ("rtabmap", "rtabmap/mapPath", _ANY, "rgbd", _REVISED),
    ),
    "px4_msgs/msg/VehicleOdometry": (
        ("PX4", ".*vehicle_(visual|mocap)_odometry", _ANY, _VIO, _CONVERTED),
        ("PX4", ".*", _ANY, "gnss-aided", _CONVERTED),
    ),
}  # fmt: skip


def recognised(message_type: str, topic: str, frame: str, child: str) -> KnownSystem | None:
    """Return the system that probably publishes a topic; None if no system fits."""
    candidates = (KnownSystem(*item) for item in _SYSTEMS.get(message_type, ()))
    return next(
        (candidate for candidate in candidates if candidate.matches(topic, frame, child)), None
    )
