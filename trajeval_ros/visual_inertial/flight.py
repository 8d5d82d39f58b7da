"""Simulated visual-inertial odometry: a flight, its true states, and runs of an estimator."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.sparse

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.visual_inertial.drifting_odometry import EPOCH_S, SHORTEST_S, simulate
from trajeval_ros.visual_inertial.motion import recorded
from trajeval_ros.visual_inertial.sampler import SampledEstimate, Sampler, solved
from trajeval_ros.visual_inertial.scene import Scene, SensorProfile, make_scene
from trajeval_ros.visual_inertial.state import State

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
    """One run as an odometry publishes it.

    Attributes:
        estimate: Keyframes with velocity and pose covariance, in frame `odom`; the covariances
            are in the gauge of the first keyframe.
        information: (9N, 9N) of all keyframes, rank 9N - 4.
    """

    estimate: Trajectory
    information: scipy.sparse.csr_matrix


@dataclass(frozen=True, eq=False)
class Flight:
    """A flight with its sensors.

    Attributes:
        groundtruth: 200 states a second, with velocity, in frame `world`.
        scene: Its keyframes, 10 a second, and measurements.
        is_solved: True if runs are solved, False if they are sampled from the estimator's
            Gaussian.
    """

    groundtruth: Trajectory
    scene: Scene
    is_solved: bool

    def runs(self, seed: int, count: int) -> Iterator[Odometry]:
        """Yield `count` runs that differ in noise and frame.

        Raises:
            DegenerateGeometryError: More than the gauge's four directions are undetermined.
        """
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
    """Return the flight of `simulation.simulate` with a camera and an IMU.

    Args:
        seed: Chooses the flight and the landmarks.
        duration_s: Duration, 5 s to half an hour.
        profile: Sensors.

    Raises:
        SettingsError: A flight too short, too long for memory, or too long to be solved if the
            profile requires it.
        DegenerateGeometryError: Too few landmarks are observed by several keyframes.
    """
    if not SHORTEST_S <= duration_s <= LONGEST_S:
        raise SettingsError(
            f"a simulated flight takes {SHORTEST_S:g} to {LONGEST_S:g} s, not {duration_s:g}; "
            "use the drift model for longer flights, since memory grows with the length"
        )
    keyframes = round(duration_s * KEYFRAME_RATE_HZ) + 1
    if not profile.honest and keyframes > MOST_SOLVED:
        longest = (MOST_SOLVED - 1) / KEYFRAME_RATE_HZ
        raise SettingsError(
            f"an overconfident run of {duration_s:g} s takes too long to solve; use --duration "
            f"{longest:g} or less"
        )
    # The spline is poorly determined at its end: simulate slightly more than is evaluated.
    truth = simulate(seed, duration_s + 1.0).groundtruth
    motion = recorded(truth, 0.5, (keyframes - 1) / KEYFRAME_RATE_HZ + 0.02)
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
