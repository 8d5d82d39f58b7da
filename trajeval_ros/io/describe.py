"""Contents of a source: its trajectories, their key figures, and the TF tree of a bag."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trajeval_ros.exceptions import InputError, reason_of
from trajeval_ros.formatting.source_roles import is_named_groundtruth
from trajeval_ros.geometry.fixes import quality_of
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.io.sources import Advance, parse_source, read_trajectory
from trajeval_ros.io.text.hints import NO_HINTS, TextHints

LONG_GAP_S = 0.5  # association does not interpolate over longer gaps


@dataclass(frozen=True)
class TrajectorySummary:
    """Key figures of a trajectory.

    Attributes:
        source: SOURCE of the trajectory.
        kind: Message type, or format of the file.
        poses: Number of states.
        rate_hz: Inverse of the median time step; 0 without time steps.
        first_ns: Earliest timestamp.
        last_ns: Latest timestamp.
        path_length_m: Length of the path.
        mean_speed_mps: Path length divided by the duration; 0 without timestamps.
        largest_speed_mps: Largest speed between consecutive states; 0 without timestamps.
        frame: Fixed frame, "" if unknown.
        child_frame: Frame of the body, "" if unknown.
        holds: Quantities in addition to positions, such as "rotation".
        gaps: Number of time steps longer than `LONG_GAP_S`.
        longest_gap_s: Longest time step, seconds.
        could_be: Likely role: "groundtruth", "estimate" or "estimate or groundtruth".
        notes: Notes of the reader, and the number of dropped rows by reason.
        problem: Reason why the trajectory can't be evaluated, "" if it can.
    """

    source: str
    kind: str
    poses: int
    rate_hz: float = 0.0
    first_ns: int = 0
    last_ns: int = 0
    path_length_m: float = 0.0
    mean_speed_mps: float = 0.0
    largest_speed_mps: float = 0.0
    frame: str = ""
    child_frame: str = ""
    holds: tuple[str, ...] = ()
    gaps: int = 0
    longest_gap_s: float = 0.0
    could_be: str = ""
    notes: tuple[str, ...] = ()
    problem: str = ""


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
    """Contents of a source.

    Attributes:
        path: The file or directory.
        trajectories: Trajectories in the source, also those with a problem.
        edges: Transforms of the TF tree.
        others: (topic, type, number of messages) of the topics without poses.
        notes: Notes of the reader of a bag, damage included.
    """

    path: Path
    trajectories: tuple[TrajectorySummary, ...]
    edges: tuple[EdgeSummary, ...] = ()
    others: tuple[tuple[str, str, int], ...] = ()
    notes: tuple[str, ...] = ()


def describe(
    source: str, *, advance: Advance | None = None, hints: TextHints = NO_HINTS
) -> Description:
    """Return the contents of a SOURCE; for a bag without a topic, of all its topics.

    Args:
        source: As for `read_trajectory`, or a bag without a topic.
        advance: Progress callback, called with the amount done and the total.
        hints: Columns and frame rate of a text file, as the user states them.

    Raises:
        InputError: The source can't be read.
    """
    parts = parse_source(source)
    if parts.is_bag and not parts.topic:
        try:
            return _describe_bag(source, parts.path, advance)
        except OSError as error:
            raise InputError(f"{parts.path} can't be read: {reason_of(error)}") from error
    trajectory = read_trajectory(source, advance=advance, hints=hints)
    return Description(parts.path, (summarize(source, trajectory),))


def _describe_bag(source: str, path: Path, advance: Advance | None) -> Description:
    """Return the contents of all topics of a bag."""
    from trajeval_ros.io.bags.bag import Bag
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
            topic: PoseReader(topic, covariances=True)
            for topic in bag.topics
            if topic.holds_poses and topic.count
        }
        turned = {topic: TransformReader(topic) for topic in bag.topics if topic.holds_transforms}
        readers: list[PoseReader | TransformReader] = [*posed.values(), *turned.values()]
        read_topics(bag, readers)
        for topic in bag.topics:
            name = f"{source}:{topic.name}"
            if topic in posed:
                try:
                    trajectory = trajectory_of(bag, posed[topic])
                    trajectories.append(summarize(name, trajectory))
                except InputError as error:
                    trajectories.append(
                        TrajectorySummary(name, topic.type, topic.count, problem=str(error))
                    )
            elif topic.holds_transforms and not topic.name.endswith("_static"):
                own = tree_of(turned[each] for each in tree_topics(bag, topic.name))
                for (parent, child), edge in own.items():
                    edges[topic.name, parent, child] = EdgeSummary(
                        topic.name,
                        parent,
                        child,
                        edge.is_static,
                        len(edge.stamps),
                        _rate_hz(edge.stamps),
                    )
            elif not topic.holds_transforms:
                others.append((topic.name, topic.type, topic.count))
        notes, damage = bag.findings([each.reading for each in readers])
    tree = sorted(edges.values(), key=lambda edge: (edge.topic, edge.is_static, edge.parent))
    return Description(path, tuple(trajectories), tuple(tree), tuple(others), (*notes, *damage))


def summarize(source: str, trajectory: Trajectory) -> TrajectorySummary:
    """Return the key figures of a trajectory.

    Args:
        source: SOURCE of the trajectory.
        trajectory: As its reader returned it: the first note is the format.
    """
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
    about_fixes = () if ordered.fixes is None else (quality_of(ordered.fixes),)
    kind, *notes = (note.removeprefix("format: ") for note in ordered.notes)
    dropped = tuple(
        f"{count} dropped: {reason.replace('_', ' ')}" for reason, count in ordered.dropped.items()
    )
    unstamped = not trajectory.stamped
    travelled = ordered.travelled
    speeds = np.zeros(0) if unstamped else np.diff(travelled) / steps
    still = unstamped or len(ordered) < 2
    return TrajectorySummary(
        source=source,
        kind=kind,
        poses=len(ordered),
        rate_hz=0.0 if unstamped else _rate_hz(ordered.stamps),
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
        could_be=_could_be(source, trajectory),
        notes=(*notes, *about_fixes, *dropped),
    )


def _could_be(source: str, trajectory: Trajectory) -> str:
    """Return the likely role, from the name and from quantities that only estimators output."""
    if trajectory.fixes is not None:
        return "groundtruth"
    if is_named_groundtruth(source) or is_named_groundtruth(trajectory.frame):
        return "groundtruth"
    if trajectory.covariances is not None or (
        trajectory.velocities is not None and trajectory.gyroscope_biases is None
    ):
        return "estimate"
    return "estimate or groundtruth"


def _rate_hz(stamps: np.ndarray[tuple[int, ...], np.dtype[np.int64]]) -> float:
    """Return the inverse of the median step of timestamps (N,); 0 without a positive median."""
    steps = np.diff(stamps)
    return NANOSECONDS / float(np.median(steps)) if len(steps) and np.median(steps) > 0 else 0.0
