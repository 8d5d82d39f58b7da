"""Editing of trajectories before they are saved or evaluated, in a fixed order."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from trajeval_ros.exceptions import InputError, SettingsError, TrajevalError, require_one_of
from trajeval_ros.geometry.arrays import Indices
from trajeval_ros.geometry.frame_axes import (
    AXES,
    between_own_axes,
    upright,
    with_body_axes,
    with_world_axes,
)
from trajeval_ros.geometry.gauge import Gauge, Similarity
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.pose_conventions import Conventions
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.trajectory_edits import (
    PLANES,
    TimeSpan,
    at_rate,
    by_motion,
    evenly,
    flattened,
    merged,
)
from trajeval_ros.metrics.alignment import Alignment
from trajeval_ros.metrics.association import associate
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.pair_alignment import align_pairs
from trajeval_ros.metrics.protocol import Protocol


@dataclass(frozen=True, eq=False)
class Editing:
    """The operations, in the order of these attributes; None or False skips one.

    Frames are changed before states are removed, so that an alignment uses all states, and motion
    filters measure distances in the frame of the result.
    """

    # How the trajectories are written, if their reader assumed something else.
    conventions: Conventions = field(default_factory=Conventions)
    time_offset_s: float = 0.0  # added to the timestamps
    hand_eye: HandEye | None = None  # pose of the reference's marker in the body
    # Period to keep; relative times count from the reference's first timestamp, or from the
    # trajectory's own without a reference.
    time_span: TimeSpan | None = None
    merge: bool = False  # join all trajectories to one
    world_axes: str | None = None  # convention of the fixed frame's axes, see `frame_axes`
    body_axes: str | None = None  # convention of the body's axes, see `frame_axes`
    right: Similarity | None = None  # pose of the new body in the present one: T <- T T_right
    # Pose of the present frame in the new one, with a scale: T <- T_left T.
    left: Similarity | None = None
    align: Protocol | None = None  # protocol of the alignment to the reference
    # Association with the reference; only states in pairs are kept.
    synchronise: AssociationRule | None = None
    plane: str | None = None  # one of `PLANES`, to project on
    # Least distance (m) and angle (rad) between states, see `by_motion`.
    motion: tuple[float, float] | None = None
    rate_hz: float | None = None  # largest number of states per second
    poses: int | None = None  # largest number of states, evenly spread

    def __post_init__(self) -> None:
        for axes in (self.world_axes, self.body_axes):
            if axes is not None:
                require_one_of(axes, AXES, "axes")
        if self.plane is not None:
            require_one_of(self.plane, PLANES, "plane")
        if self.right is not None and self.right.scale != 1.0:
            raise SettingsError(
                "a scale on the right has no effect on positions; remove it, or transform on "
                "the left"
            )
        if self.motion is not None and not (min(self.motion) >= 0.0 and max(self.motion) > 0.0):
            raise SettingsError("a motion filter needs a distance or an angle greater than zero")
        if self.rate_hz is not None and not 0.0 < self.rate_hz < np.inf:
            raise SettingsError(f"the rate must be greater than 0 Hz, not {self.rate_hz}")
        if self.poses is not None and self.poses < 1:
            raise SettingsError(f"the number of poses must be greater than 0, not {self.poses}")


@dataclass(frozen=True, eq=False)
class Edited:
    """An edited trajectory."""

    trajectory: Trajectory
    # The reference's states in the same rows after synchronisation; else None.
    reference: Trajectory | None = None
    alignment: Alignment | None = None  # the alignment to the reference; None without one


def edit(
    trajectories: Sequence[Trajectory], reference: Trajectory | None, editing: Editing
) -> list[Edited]:
    """Return the edited trajectories; the reference serves to align and to synchronise."""
    needs_reference = (editing.align, editing.synchronise, editing.hand_eye)
    if reference is None and any(item is not None for item in needs_reference):
        raise SettingsError(
            "alignment, synchronisation and the pose of a marker need a reference; give "
            "--reference SOURCE"
        )
    if reference is not None:
        reference = reference_of(reference, editing)
    parts = []
    for trajectory in trajectories:
        with _named(trajectory):
            trajectory = editing.conventions.corrected(trajectory)
            trajectory = _shifted(trajectory, editing.time_offset_s)
            if reference is not None and editing.hand_eye and reference.quaternions is None:
                trajectory = editing.hand_eye.of_marker(trajectory, 1.0)
            parts.append(_cut(trajectory.in_order(), reference, editing.time_span))
    if editing.merge:
        parts = [merged(parts)]
    results = []
    for trajectory in parts:
        with _named(trajectory):
            results.append(_edit(trajectory, reference, editing))
    return results


def _edit(trajectory: Trajectory, reference: Trajectory | None, editing: Editing) -> Edited:
    trajectory = _in_wanted_frames(trajectory, editing)
    alignment = partner = None
    if reference is not None and editing.align is not None:
        trajectory, alignment = aligned_to(reference, trajectory, editing.align)
    if reference is not None and editing.synchronise is not None:
        pairs = associate(reference, trajectory, editing.synchronise)
        trajectory, partner = pairs.estimate, pairs.groundtruth
    if editing.plane is not None:
        trajectory = flattened(trajectory, editing.plane)
        partner = None if partner is None else flattened(partner, editing.plane)
    rows = _kept(trajectory, editing)
    return Edited(trajectory[rows], None if partner is None else partner[rows], alignment)


def reference_of(reference: Trajectory, editing: Editing) -> Trajectory:
    """Return the reference in order of time, and of the body if its marker's pose is known.

    As in an evaluation, a reference without orientations stays: the trajectories move.
    """
    reference = reference.in_order()
    if editing.hand_eye is None or reference.quaternions is None:
        return reference
    return editing.hand_eye.of_body(reference)


def _shifted(trajectory: Trajectory, offset_s: float) -> Trajectory:
    if offset_s == 0.0:
        return trajectory
    if not trajectory.reading.stamped:
        raise InputError("no timestamps, which a time offset needs")
    offset_ns = round(offset_s * NANOSECONDS)
    return dataclasses.replace(trajectory, stamps=trajectory.stamps + offset_ns)


def _cut(
    trajectory: Trajectory, reference: Trajectory | None, span: TimeSpan | None
) -> Trajectory:
    if span is None:
        return trajectory
    counted_from = trajectory if reference is None else reference
    return span.cut(trajectory, int(counted_from.stamps[0]))


def _in_wanted_frames(trajectory: Trajectory, editing: Editing) -> Trajectory:
    if editing.world_axes is not None:
        trajectory = with_world_axes(trajectory, editing.world_axes)
    if editing.body_axes is not None:
        trajectory = with_body_axes(trajectory, editing.body_axes)
    if editing.right is not None:
        if trajectory.quaternions is None:
            raise InputError("no orientations, which a transformation on the right needs")
        pose = HandEye(editing.right.rotation_xyzw, editing.right.translation)
        trajectory = pose.inverse().of_body(trajectory)
    if editing.left is not None:
        trajectory = editing.left.trajectory(trajectory)
    return trajectory


def aligned_to(
    reference: Trajectory, trajectory: Trajectory, protocol: Protocol
) -> tuple[Trajectory, Alignment]:
    """Return all states in the reference's own frame, and the alignment."""
    groundtruth, estimate = reference, trajectory
    if protocol.is_upright:
        groundtruth, estimate = upright(groundtruth), upright(estimate)
    if protocol.gauge is Gauge.PLANAR:
        groundtruth, estimate = flattened(groundtruth, "xy"), flattened(estimate, "xy")
    pairs = associate(groundtruth, estimate, protocol.association)
    alignment = align_pairs(pairs, protocol)
    similarity = alignment.similarity
    if protocol.is_upright:
        similarity = between_own_axes(similarity, reference.up, trajectory.up)
    moved = dataclasses.replace(
        similarity.trajectory(trajectory), frame=reference.frame, up=reference.up
    )
    return moved, alignment


def _kept(trajectory: Trajectory, editing: Editing) -> Indices:
    rows = np.arange(len(trajectory))
    if editing.motion is not None:
        rows = by_motion(trajectory, *editing.motion)
    if editing.rate_hz is not None:
        if not trajectory.reading.stamped:
            raise InputError("no timestamps, which a rate needs")
        rows = rows[at_rate(trajectory.stamps[rows], editing.rate_hz)]
    if editing.poses is not None:
        rows = rows[evenly(len(rows), editing.poses)]
    return rows


@contextlib.contextmanager
def _named(trajectory: Trajectory) -> Iterator[None]:
    """Put the name of a trajectory before the message of an error."""
    try:
        yield
    except TrajevalError as error:
        if str(error).startswith(trajectory.name):
            raise
        raise type(error)(f"{trajectory.name}: {error}") from error
