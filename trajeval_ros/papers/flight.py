"""Simulated visual-inertial odometry: a flight, its true states, and runs with known covariance.

A run is solved, or sampled from the estimator's Gaussian. For sampling, the normal equations are
linearised at the true states. Their solution is linear in the noise. The true states plus a sample
of the solution's Gaussian is, to first order, the result of an estimator, and its covariance is
exact. A sample costs a matrix product, with a time proportional to the length of the run.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.sparse

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry import lie, so3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.banded_matrices import BandedGaussian
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.papers.reduction import information_of
from trajeval_ros.papers.scene import Scene, SensorProfile, make_scene
from trajeval_ros.papers.solver import GAUGE_INDICES, GaugeHandling, solve
from trajeval_ros.papers.state import State
from trajeval_ros.simulation.drifting_odometry import EPOCH_S, SHORTEST_S, simulate
from trajeval_ros.simulation.motion import recorded

_FARTHEST_OFFSET_M = 5.0
_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class SampledEstimate:
    """An estimate in its own frame, with its information."""

    state: State  # estimated keyframes
    # (9N, 9N), rank 9N - 4, of left perturbations in the estimate's frame
    information: scipy.sparse.csr_matrix
    marginals: Floats  # (N, 9, 9), covariances of the keyframes in the gauge of the first one

    def elsewhere(self, generator: np.random.Generator) -> SampledEstimate:
        """Return the run in a frame with random yaw and translation."""
        yaw = generator.uniform(-np.pi, np.pi)
        rotation = so3.exp(yaw * np.array([0.0, 0.0, 1.0]))
        shift = generator.uniform(-_FARTHEST_OFFSET_M, _FARTHEST_OFFSET_M, 3)
        blocks = scipy.sparse.kron(scipy.sparse.eye(self.information.shape[0] // 3), rotation)
        wide = np.kron(np.eye(3), rotation)
        return SampledEstimate(
            self.state.transformed(rotation, shift),
            (blocks @ self.information @ blocks.T).tocsr(),
            wide @ self.marginals @ wide.T,
        )


def solved(scene: Scene, generator: np.random.Generator) -> SampledEstimate:
    """Return the estimate from one set of noisy measurements, in the free gauge."""
    problem, start = scene.measured(generator), scene.disturbed(generator)
    state = solve(problem, start, GaugeHandling.FREE, function_tolerance=_TOLERANCE).state
    # With the state as its own reference, the first rotation is perturbed on the left like all
    # others.
    state = state.referred_to(state.rotations[0], state.positions[0])
    information = information_of(problem, state)
    run = SampledEstimate(state, information, _FixedGaugeGaussian(information).marginals())
    return run.elsewhere(generator)


class Sampler:
    """Draws runs of a scene."""

    def __init__(self, scene: Scene) -> None:
        """Linearise at the true states."""
        self._groundtruth = scene.groundtruth
        self._information = information_of(scene.noise_free(), scene.groundtruth)
        self._held = _FixedGaugeGaussian(self._information)
        self._marginals = self._held.marginals()

    def draw(self, generator: np.random.Generator) -> SampledEstimate:
        """Return one run; its landmarks are the true ones in its frame."""
        step = np.concatenate(
            [self._held.sampled(generator), np.zeros(self._groundtruth.landmarks.size)]
        )
        run = SampledEstimate(self._groundtruth.moved(step), self._information, self._marginals)
        return run.elsewhere(generator)


class _FixedGaugeGaussian:
    """The motion's Gaussian with position and yaw of the first keyframe fixed: eq. (10)."""

    def __init__(self, information: scipy.sparse.csr_matrix) -> None:
        self._size = information.shape[0]
        self._kept = np.setdiff1d(np.arange(self._size), GAUGE_INDICES)
        self._gaussian = BandedGaussian(information[self._kept][:, self._kept].tocsr())

    def sampled(self, generator: np.random.Generator) -> Floats:
        """Return a perturbation (9N,)."""
        step = np.zeros(self._size)
        step[self._kept] = self._gaussian.sampled(generator.standard_normal(len(self._kept)))
        return step

    def marginals(self) -> Floats:
        """Return the covariances of single keyframes, (N, 9, 9)."""
        blocks = np.zeros((self._size // 9, 9, 9))
        # Roll, pitch and velocity of the first keyframe are not fixed.
        first = self._kept[:5]
        blocks[0][np.ix_(first, first)] = self._gaussian.marginals(np.array([0]), 5)[0]
        blocks[1:] = self._gaussian.marginals(np.arange(5, len(self._kept), 9), 9)
        return blocks


KEYFRAME_RATE_HZ = 10.0
# Half an hour takes 3.4 GB, which grows with the length, and 142 s, most of them for the spline,
# which grow with its square.
LONGEST_S = 1800.0
# With more keyframes, solving with a dense Schur complement takes minutes; sampling takes seconds.
MOST_SOLVED = 101
_LANDMARKS_PER_KEYFRAME = 10
_TRACK = 10


@dataclass(frozen=True, eq=False)
class Odometry:
    """One run as an odometry publishes it."""

    # Keyframes with velocity and pose covariance, in frame `odom`; the covariances are in the
    # gauge of the first keyframe.
    estimate: Trajectory
    information: scipy.sparse.csr_matrix  # (9N, 9N) of all keyframes, rank 9N - 4


@dataclass(frozen=True, eq=False)
class Flight:
    """A flight with its sensors."""

    groundtruth: Trajectory  # 200 states a second, with velocity, in frame `world`
    scene: Scene  # its keyframes, 10 a second, and measurements
    # True if runs are solved, False if they are sampled from the estimator's Gaussian.
    is_solved: bool

    def runs(self, seed: int, count: int) -> Iterator[Odometry]:
        """Yield `count` runs that differ in noise and frame."""
        sampler = None if self.is_solved else Sampler(self.scene)
        for number in range(count):
            generator = np.random.default_rng([seed, number])
            run = solved(self.scene, generator) if sampler is None else sampler.draw(generator)
            yield Odometry(self._published(run), run.information)

    def _published(self, run: SampledEstimate) -> Trajectory:
        return _trajectory(
            run.state, self.scene.times_s, "odom", "odometry", run.marginals[:, :6, :6].copy()
        )


def fly(seed: int, duration_s: float, profile: SensorProfile) -> Flight:
    """Return the flight of `simulate` with a camera and an IMU.

    The seed chooses the flight and the landmarks. The duration is 5 s to half an hour.
    """
    if not SHORTEST_S <= duration_s <= LONGEST_S:
        raise SettingsError(
            f"a simulated flight takes {SHORTEST_S:g} to {LONGEST_S:g} s, not {duration_s:g}; "
            "use the drift model for longer flights, since memory grows with the length"
        )
    keyframes = round(duration_s * KEYFRAME_RATE_HZ) + 1
    if not profile.is_exact and keyframes > MOST_SOLVED:
        longest = (MOST_SOLVED - 1) / KEYFRAME_RATE_HZ
        raise SettingsError(
            f"an overconfident run of {duration_s:g} s takes too long to solve; use --duration "
            f"{longest:g} or less"
        )
    # The spline is poorly determined at its end: simulate slightly more than is evaluated.
    flown = simulate(seed, duration_s + 1.0).groundtruth
    motion = recorded(flown, 0.5, (keyframes - 1) / KEYFRAME_RATE_HZ + 0.02)
    scene = make_scene(
        motion,
        "random",
        profile,
        seed,
        keyframes=keyframes,
        landmarks=_LANDMARKS_PER_KEYFRAME * keyframes,
        track=_TRACK,
    )
    times = np.arange(len(scene.flown.positions)) * (
        scene.times_s[-1] / (len(scene.flown.positions) - 1)
    )
    groundtruth = _trajectory(scene.flown, times, "world", "groundtruth", None)
    return Flight(groundtruth, scene, keyframes <= MOST_SOLVED)


def _trajectory(
    state: State, times: Floats, frame: str, name: str, covariances: Floats | None
) -> Trajectory:
    return Trajectory(
        stamps=EPOCH_S * NANOSECONDS + np.rint(times * NANOSECONDS).astype(np.int64),
        positions=state.positions,
        quaternions=lie.from_matrices(state.rotations),
        velocities=state.velocities,
        covariances=covariances,
        frame=frame,
        child_frame="base_link",
        name=name,
    )
