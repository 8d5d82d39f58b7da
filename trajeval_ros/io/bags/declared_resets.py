"""Resets that an estimator declares by a counter, as PX4 does: its pose jumps there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import Remark, note
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.source_info import DeclaredReset
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.io.bags.pose_columns import PoseColumns

_MOST = 5  # resets that the note lists


def declared_resets(columns: PoseColumns) -> tuple[DeclaredReset, ...]:
    """Return the resets of poses whose counter differs from that of the pose before.

    A counter of one byte wraps, so every difference counts. The step is the position less the one
    before carried on by its velocity, if that is known.
    """
    if columns.flags is None:
        return ()
    after = 1 + np.flatnonzero(np.diff(columns.flags[:, 0]))
    before = after - 1
    steps = columns.positions[after] - columns.positions[before]
    if columns.velocities is not None:
        seconds = (columns.stamps[after] - columns.stamps[before]) / NANOSECONDS
        steps -= np.nan_to_num(columns.velocities[before]) * seconds[:, None]
    angles_deg = np.zeros(len(after))
    if columns.quaternions is not None:
        first, last = columns.quaternions[before], columns.quaternions[after]
        angles_deg = np.degrees(lie.angle(lie.multiply(lie.conjugate(first), last)))
    rows = columns.stamps[after], np.linalg.norm(steps, axis=1), angles_deg
    return tuple(map(DeclaredReset, *(row.tolist() for row in rows)))


def about_resets(resets: Sequence[DeclaredReset], first: int | None) -> Iterator[Remark]:
    """Yield the note on declared resets; `first` is the first timestamp, nanoseconds."""
    if not resets or first is None:
        return
    listed = [
        f"at {(reset.stamp_ns - first) / NANOSECONDS:.2f} s {reset.position_m:.2f} m "
        f"and {reset.rotation_deg:.1f} deg"
        for reset in resets[:_MOST]
    ]
    more = f", and {len(resets) - _MOST} more" if len(resets) > _MOST else ""
    yield note(
        "declared_resets",
        f"{counted(len(resets), 'reset')} declared by the estimator: {', '.join(listed)}{more}; "
        f"to evaluate what follows, use --start @{resets[-1].stamp_ns / NANOSECONDS:.3f}",
    )
