"""Continuous groundtruth by one of several models."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.continuous_time.kernels import MATERN_32, MATERN_52, SQUARED_EXPONENTIAL
from trajeval_ros.continuous_time.manifolds import Positions, Rotations
from trajeval_ros.continuous_time.markov import Interpolator, Process
from trajeval_ros.continuous_time.piecewise_gp import MOST_TURN_RAD, PiecewiseGP, TwoScaleGP
from trajeval_ros.continuous_time.samples import (
    CANDIDATES,
    DEFAULT_MODEL,
    MODELS,
    Belief,
    Noise,
    Samples,
)
from trajeval_ros.exceptions import InputError, require_one_of
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry import lie, se3
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.covariance_frames import body_from_world_positions
from trajeval_ros.geometry.interpolation import mix, slerp, steps_at
from trajeval_ros.geometry.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class LinearInterpolation:
    """Linear positions and slerp, with the covariance of a sample everywhere."""

    samples: Samples

    def at(self, times: Floats) -> Belief:
        """Return the belief at times (Q,), seconds, within those of the samples."""
        poses = self.samples.poses
        start, fraction = steps_at(self.samples.times, times)
        between = (start, start + 1, fraction)
        rotations = lie.to_matrix(slerp(lie.from_matrices(poses[:, :3, :3]), *between))
        positions = mix(poses[:, :3, 3], *between)
        covariances = sample_covariances(self.samples, len(times))
        return Belief(se3.poses(rotations, positions), covariances)


@dataclass(frozen=True, eq=False)
class NearestSample:
    """The nearest sample in time, with its covariance."""

    samples: Samples

    def at(self, times: Floats) -> Belief:
        """Return the belief at times (Q,), seconds, within those of the samples."""
        start, fraction = steps_at(self.samples.times, times)
        nearest = start + (fraction > 0.5)
        return Belief(self.samples.poses[nearest], sample_covariances(self.samples, len(times)))


def sample_covariances(samples: Samples, count: int) -> Floats:
    """Return the covariance of a sample `count` times, (count, 6, 6)."""
    noise = samples.noise
    rotation = noise.rotation_rad if samples.oriented else 0.0
    variances = np.square([noise.position_m] * 3 + [rotation] * 3)
    return np.tile(np.diag(variances), (count, 1, 1))


_HOLD_OUT_EVERY = 4
_MOST_HELD_OUT = 3000
_FEW = 10
# Order of the Markov prior that replaces models without correlations: WNOA.
_ORDER = 2


class PoseModel(Protocol):
    """A fitted model."""

    def at(self, times: Floats) -> Belief:
        """Return the belief at times (Q,), seconds, within those of the samples."""


@dataclass(frozen=True, eq=False)
class MarkovPoses:
    """Positions and rotations as independent Markov processes."""

    positions: Interpolator  # in the world
    rotations: Interpolator | None  # None if the groundtruth has no orientations

    @classmethod
    def fit(cls, samples: Samples, order: int) -> MarkovPoses:
        """Fit both processes; `order` is 2 for white noise on acceleration, 3 on jerk."""
        measured, noise = samples.poses[:, :3, 3], samples.noise.position_m
        positions = Process.fit(Positions(), order, samples.times, measured, noise)
        rotations = None
        if samples.oriented:
            measured, noise = samples.poses[:, :3, :3], samples.noise.rotation_rad
            process = Process.fit(Rotations(), order, samples.times, measured, noise)
            rotations = process.interpolator()
        return cls(positions.interpolator(), rotations)

    def at(self, times: Floats) -> Belief:
        """Return the belief at times (Q,), seconds, within those of the samples."""
        positions, spread = self.positions.at(times)
        covariances = np.zeros((len(times), 6, 6))
        rotations = np.broadcast_to(np.eye(3), (len(times), 3, 3))
        if self.rotations is not None:
            rotations, covariances[:, 3:, 3:] = self.rotations.at(times)
        covariances[:, :3, :3] = body_from_world_positions(spread, rotations)
        return Belief(se3.poses(rotations, positions), covariances)


_FITS: dict[str, Callable[[Samples], PoseModel]] = {
    "matern": lambda samples: TwoScaleGP.fit(samples, (MATERN_32, MATERN_52)),
    "matern32": lambda samples: TwoScaleGP.fit(samples, (MATERN_32,)),
    "matern52": lambda samples: TwoScaleGP.fit(samples, (MATERN_52,)),
    "paper": lambda samples: PiecewiseGP.fit(samples, (SQUARED_EXPONENTIAL,), joint=True),
    "wnoa": lambda samples: MarkovPoses.fit(samples, 2),
    "wnoj": lambda samples: MarkovPoses.fit(samples, 3),
    "linear": LinearInterpolation,
    "nearest": NearestSample,
}


@dataclass(frozen=True, eq=False)
class ContinuousTrajectory:
    """Groundtruth at any time.

    Attributes:
        model: Name of the model; for `auto`, of the chosen one.
        samples: The samples of the fit.
        poses: The fitted model.
        statements: Remarks about its validity, one sentence each.

    Example:
        >>> from trajeval_ros import Noise, fit_trajectory, simulate
        >>> slow = simulate(seed=1, duration_s=30.0).groundtruth[::100]
        >>> continuous = fit_trajectory(slow, "wnoa", Noise(position_m=0.005, rotation_rad=0.01))
        >>> bool(continuous.covers(slow.stamps).all())
        True
    """

    model: str
    samples: Samples
    poses: PoseModel
    statements: tuple[str, ...]

    def covers(self, stamps: NDArray[np.int64]) -> Booleans:
        """Return which stamps (Q,), nanoseconds, are within the time span of the samples."""
        times = self.samples.seconds(stamps)
        inside: Booleans = (times >= self.samples.times[0]) & (times <= self.samples.times[-1])
        return inside

    def at(self, stamps: NDArray[np.int64]) -> Belief:
        """Return the belief at stamps (Q,), nanoseconds.

        Raises:
            InputError: A stamp is outside the time span of the samples; there is no extrapolation.
        """
        covered = self.covers(stamps)
        if not covered.all():
            raise InputError(
                f"{np.count_nonzero(~covered)} of {counted(len(stamps), 'timestamp')} are "
                "outside the time span of the groundtruth"
            )
        return self.poses.at(self.samples.seconds(stamps))

    @cached_property
    def markov(self) -> MarkovPoses:
        """The model with all correlations: itself, or white noise on acceleration."""
        if isinstance(self.poses, MarkovPoses):
            return self.poses
        return MarkovPoses.fit(self.samples, _ORDER)


@lru_cache(maxsize=1)
def fit_trajectory(
    groundtruth: Trajectory, model: str = DEFAULT_MODEL, noise: Noise | None = None
) -> ContinuousTrajectory:
    """Fit a model to groundtruth, once for all estimates that are compared with it.

    Args:
        groundtruth: The samples; repeated timestamps are dropped, nearly equal ones merged.
        model: One of `MODELS`. `auto` chooses between `matern` and the Markov priors by the
            likelihood of held-out samples.
        noise: Noise of the samples; by default 2 mm and 0.1 deg.

    Raises:
        SettingsError: The model is unknown.
        InputError: There are fewer than two samples.

    Example:
        >>> from trajeval_ros import Noise, fit_trajectory, simulate
        >>> slow = simulate(seed=1, duration_s=30.0).groundtruth[::100]
        >>> continuous = fit_trajectory(slow, "wnoa", Noise(position_m=0.005, rotation_rad=0.01))
        >>> belief = continuous.at(slow.stamps[:-1] + 50_000_000)
        >>> belief.poses.shape == (len(slow) - 1, 4, 4)
        True
    """
    require_one_of(model, MODELS, "continuous model")
    samples = Samples.of(groundtruth, noise or Noise())
    if model == "auto":
        model = _most_predictive(samples)
    return ContinuousTrajectory(model, samples, _FITS[model](samples), _statements(samples))


def _most_predictive(samples: Samples) -> str:
    """Return the candidate with the largest likelihood of held-out samples."""
    if len(samples) < 2 * _HOLD_OUT_EVERY:
        return CANDIDATES[0]
    skip = max(0, (len(samples) - _MOST_HELD_OUT) // 2)
    middle = samples[np.arange(skip, min(skip + _MOST_HELD_OUT, len(samples)))]
    # Held-out samples must lie between the kept ones.
    held = np.zeros(len(middle), dtype=bool)
    held[2 : len(middle) - 1 : _HOLD_OUT_EVERY] = True
    kept, groundtruth = middle[~held], middle.poses[held]

    def cost(model: str) -> float:
        belief = _FITS[model](kept).at(middle.times[held])
        axes = 6 if samples.oriented else 3
        noise = NearestSample(kept).at(middle.times[held]).covariances
        spread = (belief.covariances + noise)[:, :axes, :axes]
        missed = se3.log(se3.inverse(belief.poses) @ groundtruth)[:, :axes]
        surprise = np.einsum(
            "ni,ni->n", missed, np.linalg.solve(spread, missed[..., None])[..., 0]
        )
        return float(np.sum(surprise + np.linalg.slogdet(spread)[1]))

    return min(CANDIDATES, key=cost)


def _statements(samples: Samples) -> tuple[str, ...]:
    """Return remarks about the validity of the groundtruth."""
    statements = []
    if samples.merged:
        statements.append(
            f"{counted(samples.merged, 'groundtruth pose')} merged with a neighbour closer than "
            "1 % of the median step"
        )
    if len(samples) < _FEW:
        statements.append(
            f"{len(samples)} groundtruth samples are too few to estimate the motion between "
            "them; all uncertainties are rough"
        )
    spread = samples.poses[:, :3, 3].std(axis=0).max()
    angles = samples.step_turns()
    if spread < samples.noise.position_m and angles.max() < 2.0 * samples.noise.rotation_rad:
        statements.append(
            f"the groundtruth moves less than its noise of {samples.noise.position_m:g} m, so "
            "the motion between samples can't be estimated"
        )
    wild = np.count_nonzero(angles > MOST_TURN_RAD)
    if wild:
        statements.append(
            f"consecutive groundtruth poses differ by more than {np.degrees(MOST_TURN_RAD):.0f} "
            f"deg at {counted(int(wild), 'place')}; the rotation between them is ambiguous, and "
            "rotation errors there are unreliable"
        )
    return tuple(statements)
