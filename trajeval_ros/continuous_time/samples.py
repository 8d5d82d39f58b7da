"""The samples of a continuous trajectory, their noise, and the names of its models."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry import lie, se3, so3
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory

# Candidates of `auto`, which compares them on held-out samples.
CANDIDATES = ("matern", "wnoa", "wnoj")
MODELS = (*CANDIDATES, "matern32", "matern52", "paper", "linear", "nearest", "auto")
# Some motion is rougher than Matern-5/2. The kernel is chosen by the samples, for positions and
# rotations separately. With 5/2 only, 95 % regions cover 75 % of poses on recordings at a few
# hertz. With 3/2 only, smooth flights are so uncertain that hardly a pose supports an error of 1
# cm.
DEFAULT_MODEL = "matern"
# Models without additional uncertainty between samples.
WITHOUT_UNCERTAINTY = ("linear", "nearest")
# Distance in time, absolute and relative to the median step, below which samples are merged. A
# Markov process cannot represent the acceleration between them.
_SAME_S, _SAME_SHARE = 1e-6, 1e-2
# Length of a gap in median steps.
GAP_STEPS = 3.0


@dataclass(frozen=True)
class Noise:
    """Standard deviations of groundtruth samples, which are given, not estimated.

    For samples seconds apart, maximum likelihood cannot distinguish noise from motion, and
    estimates zero noise.

    Attributes:
        position_m: Along every axis, metres.
        rotation_rad: About every axis, rad.

    Raises:
        SettingsError: A value is not positive.

    Example:
        >>> import math
        >>> from trajeval_ros import Noise
        >>> Noise(0.005, math.radians(1.0)).position_m
        0.005
    """

    position_m: float = 0.002
    rotation_rad: float = math.radians(0.1)

    def __post_init__(self) -> None:
        for name in ("position_m", "rotation_rad"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise SettingsError(
                    "the groundtruth noise must be greater than zero, not "
                    f"{getattr(self, name):g}; use 0.0005 m and 0.05 deg for motion capture, "
                    "0.02 m for RTK"
                )

    def per_axis(self, oriented: bool) -> tuple[float, ...]:
        """Return the standard deviations of positions and, if any, of rotations."""
        return (self.position_m, self.rotation_rad) if oriented else (self.position_m,)


@dataclass(frozen=True, eq=False)
class Samples:
    """N poses at distinct times, in order."""

    origin: int  # timestamp of time zero, nanoseconds; it preserves the precision of times
    times: Floats  # (N,), seconds
    poses: Floats  # (N, 4, 4); identity rotations without orientations
    oriented: bool  # whether there are orientations
    noise: Noise  # noise of the samples
    merged: int = 0  # number of samples that were merged with a neighbour

    @classmethod
    def of(cls, trajectory: Trajectory, noise: Noise) -> Samples:
        """Return a trajectory's samples; those closer than 1 % of the median step are merged."""
        trajectory = trajectory.in_order()
        if len(trajectory) < 2:
            raise InputError(
                f"{trajectory.name or 'the groundtruth'} has {counted(len(trajectory), 'pose')}, "
                "and association continuous needs at least two; use association nearest"
            )
        oriented = trajectory.quaternions is not None
        rotations = np.broadcast_to(np.eye(3), (len(trajectory), 3, 3))
        if trajectory.quaternions is not None:
            rotations = lie.to_matrix(trajectory.quaternions)
        samples = cls(
            origin=int(trajectory.stamps[0]),
            times=trajectory.seconds,
            poses=se3.poses(rotations, trajectory.positions),
            oriented=oriented,
            noise=noise,
        )
        return samples._merged()

    def __len__(self) -> int:
        return len(self.times)

    def __getitem__(self, rows: Indices | Booleans) -> Samples:
        return Samples(self.origin, self.times[rows], self.poses[rows], self.oriented, self.noise)

    @property
    def usual_step_s(self) -> float:
        """The median step, seconds."""
        return float(np.median(np.diff(self.times)))

    @property
    def gaps(self) -> Indices:
        """Indices of the samples before a gap."""
        return np.flatnonzero(np.diff(self.times) > GAP_STEPS * self.usual_step_s)

    def seconds(self, stamps: NDArray[np.int64]) -> Floats:
        """Return stamps (Q,), nanoseconds, as times in seconds."""
        seconds: Floats = (stamps - self.origin) / NANOSECONDS
        return seconds

    def step_turns(self) -> Floats:
        """Return the angles (N - 1,) between neighbours, rad."""
        rotations = se3.transposed(self.poses[:-1, :3, :3]) @ self.poses[1:, :3, :3]
        angles: Floats = np.linalg.norm(so3.log(rotations), axis=1)
        return angles

    def _merged(self) -> Samples:
        """Merge samples that are too close in time, by means of times, positions and rotations."""
        steps = np.diff(self.times)
        limit = max(_SAME_S, _SAME_SHARE * float(np.median(steps)))
        apart = np.concatenate([[True], steps >= limit])
        if apart.all():
            return self
        first = np.flatnonzero(apart)
        if len(first) < 2:
            raise InputError(
                f"all {len(self)} groundtruth poses are within {limit:.3g} s, which is too short "
                "for association continuous; use association nearest"
            )
        group = np.cumsum(apart) - 1
        counts = np.bincount(group)

        def means(columns: Floats) -> Floats:
            sums: Floats = np.add.reduceat(columns, first, axis=0)
            return sums / counts.reshape(-1, *([1] * (columns.ndim - 1)))

        base = self.poses[first, :3, :3]
        rotations = means(so3.log(se3.transposed(base[group]) @ self.poses[:, :3, :3]))
        poses = se3.poses(base @ so3.exp(rotations), means(self.poses[:, :3, 3]))
        return Samples(
            self.origin,
            means(self.times),
            poses,
            self.oriented,
            self.noise,
            merged=len(self) - len(first),
        )


@dataclass(frozen=True, eq=False)
class Belief:
    """Distribution of a body's pose at Q times."""

    poses: Floats  # (Q, 4, 4), the most likely poses
    # (Q, 6, 6), perturbations on the right, translation first: T Exp(xi), eq. (1). Rows of
    # rotations are zero without orientations.
    covariances: Floats
