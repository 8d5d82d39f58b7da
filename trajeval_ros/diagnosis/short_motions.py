"""Short motions of both sides in the axes of their bodies: drift in them is small.

They start and end at poses of the estimate, because interpolation of a sparse estimate cuts its
curves. The groundtruth is interpolated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.diagnosis.input_pair import SAMPLE, TimedPoses
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory_edits import evenly

MOTION_S = 1.5  # duration: noise matters in shorter motions, and drift in longer ones
DERIVATIVE_S = 0.05  # half the interval of a numerical derivative by the time offset


@dataclass(frozen=True, eq=False)
class PoseEnds:
    """Poses at the starts and the ends of N motions."""

    positions: Floats  # (2, N, 3)
    quaternions: Floats | None = None  # (2, N, 4), xyzw; None without orientations

    @property
    def displacements(self) -> Floats:
        """Displacements (N, 3) in the world."""
        return np.asarray(self.positions[1] - self.positions[0])

    def body_motions(self) -> tuple[Floats, Floats]:
        """Return rotation vectors and displacements (N, 3) in the axes of the body at the start.

        Without orientations, rotations are zero and displacements are in the axes of the world.
        """
        if self.quaternions is None:
            return np.zeros_like(self.displacements), self.displacements
        to_body = lie.conjugate(self.quaternions[0])
        rotations = lie.rotation_vector(lie.multiply(to_body, self.quaternions[1]))
        return rotations, lie.rotate(to_body, self.displacements)


@dataclass(frozen=True, eq=False)
class ShortMotions:
    """N motions of both sides at the same times."""

    seconds: Floats  # (N,) from the middle of the run
    # The groundtruth now, and `DERIVATIVE_S` later and earlier for derivatives by the time offset.
    around: tuple[PoseEnds, ...]
    estimate: PoseEnds
    duration_s: float  # of a motion

    def __len__(self) -> int:
        return len(self.seconds)

    @property
    def groundtruth(self) -> PoseEnds:
        """The groundtruth at the times of the estimate."""
        return self.around[0]

    @property
    def has_orientations(self) -> bool:
        """Whether both sides have orientations."""
        return self.groundtruth.quaternions is not None

    @property
    def independent(self) -> float:
        """The number of motions that do not overlap."""
        span_s = float(np.ptp(self.seconds)) if len(self) else 0.0
        return min(float(len(self)), span_s / self.duration_s + 1.0)

    @classmethod
    def between(
        cls,
        groundtruth: TimedPoses,
        estimate: TimedPoses,
        longest_step_s: float,
        offset_s: float = 0.0,
        rate: float = 0.0,
    ) -> ShortMotions:
        """Return evenly sampled motions, of poses in order.

        The groundtruth is interpolated at t + offset + rate (t - middle of the run), across at
        most `longest_step_s`.
        """
        times = estimate.seconds
        duration_s = max(MOTION_S, 2.0 * estimate.usual_step_s)
        middle_s = 0.5 * (times[0] + times[-1])
        mapped = times + offset_s + rate * (times - middle_s)
        first, last = np.searchsorted(mapped, groundtruth.seconds[[0, -1]])
        count = max(int(last - first), 0)
        start = first + evenly(count, min(count, SAMPLE))
        end = np.searchsorted(times, times[start] + 0.999 * duration_s)
        start, end = start[end < last], end[end < last]
        fits = times[end] - times[start] < 2.0 * duration_s + 0.2
        rows = np.stack([start[fits], end[fits]])
        at = np.stack([mapped[rows] + late_s for late_s in (0.0, DERIVATIVE_S, -DERIVATIVE_S)])
        poses = groundtruth.at(at.ravel(), longest_step_s)
        known = poses.known.reshape(at.shape)[0].all(axis=0)
        rows, columns, quaternions = rows[:, known], [poses.positions], None
        if poses.quaternions is not None and estimate.quaternions is not None:
            columns, quaternions = [*columns, poses.quaternions], estimate.quaternions[rows]
        by_time = [item.reshape(*at.shape, item.shape[-1])[:, :, known] for item in columns]
        around = tuple(PoseEnds(*(column[k] for column in by_time)) for k in range(len(at)))
        seconds = times[rows].mean(axis=0) - middle_s
        return cls(seconds, around, PoseEnds(estimate.positions[rows], quaternions), duration_s)
