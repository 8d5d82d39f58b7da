"""The estimation problem in GTSAM: another optimiser, other derivatives, other elimination.

Projection factors are GTSAM's own. The IMU's factor states eq. (1) anew on GTSAM's poses, with the
same preintegrated measurements and numeric derivatives; so does the gauge prior, eq. (11).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from trajeval_ros.papers.problem import Problem
from trajeval_ros.papers.state import State

_STEP = 1e-5


@dataclass(frozen=True, eq=False)
class GtsamSolution:
    """What GTSAM found.

    Attributes:
        initial_cost: Half the squared residuals where it began.
        cost: The same at the end.
        positions: (N, 3).
        velocities: (N, 3).
        rotations: (N, 3, 3).
        landmarks: (K, 3).
        marginals: (N, 9, 9), covariance of position, left rotation, velocity; zero between
            velocity and the others.
    """

    initial_cost: float
    cost: float
    positions: np.ndarray
    velocities: np.ndarray
    rotations: np.ndarray
    landmarks: np.ndarray
    marginals: np.ndarray


class GtsamProblem:
    """A factor graph of a problem with the prior of eq. (11), and where it begins."""

    def __init__(self, gtsam: Any, problem: Problem, start: State, weight: float) -> None:
        """Build graph and initial values."""
        self.gtsam = gtsam
        self.keys = gtsam.symbol_shorthand
        self.count, self.landmarks = problem.keyframes, problem.landmarks
        self.graph, self.values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for place in range(self.count):
            pose = gtsam.Pose3(gtsam.Rot3(start.rotations[place]), start.positions[place])
            self.values.insert(self.keys.X(place), pose)
            self.values.insert(self.keys.V(place), start.velocities[place])
        for place, landmark in enumerate(start.landmarks):
            self.values.insert(self.keys.L(place), landmark)
        self._see(problem)
        for place in range(self.count - 1):
            self._sense(problem, place)
        self._hold(start, weight)

    def optimize(self) -> Any:
        """Return GTSAM's values at the minimum."""
        parameters = self.gtsam.LevenbergMarquardtParams()
        parameters.setRelativeErrorTol(1e-15)
        parameters.setAbsoluteErrorTol(1e-15)
        parameters.setMaxIterations(100)
        return self.gtsam.LevenbergMarquardtOptimizer(
            self.graph, self.values, parameters
        ).optimize()

    def solved(self) -> GtsamSolution:
        """Return the minimum and its marginal covariances."""
        result = self.optimize()
        marginals = self.gtsam.Marginals(self.graph, result)
        poses = [result.atPose3(self.keys.X(place)) for place in range(self.count)]
        rotations = np.array([pose.rotation().matrix() for pose in poses])
        covariances = np.zeros((self.count, 9, 9))
        for place, rotation in enumerate(rotations):
            # GTSAM perturbs on the right, rotation first.
            rotation_step = np.kron([[0.0, 1.0], [1.0, 0.0]], rotation)
            own = marginals.marginalCovariance(self.keys.X(place))
            covariances[place, :6, :6] = rotation_step @ own @ rotation_step.T
            covariances[place, 6:, 6:] = marginals.marginalCovariance(self.keys.V(place))
        return GtsamSolution(
            self.graph.error(self.values),
            self.graph.error(result),
            np.array([pose.translation() for pose in poses]),
            np.array([result.atVector(self.keys.V(place)) for place in range(self.count)]),
            rotations,
            np.array([result.atPoint3(self.keys.L(place)) for place in range(self.landmarks)]),
            covariances,
        )

    def _see(self, problem: Problem) -> None:
        gtsam, camera = self.gtsam, problem.camera
        intrinsics = gtsam.Cal3_S2(camera.focal_px, camera.focal_px, 0.0, *camera.centre)
        noise = gtsam.noiseModel.Isotropic.Sigma(2, camera.noise_px)
        mount = gtsam.Pose3(gtsam.Rot3(problem.camera_in_body), np.zeros(3))
        sightings = zip(
            problem.pixels,
            problem.visibility.keyframe_of,
            problem.visibility.landmark_of,
            strict=True,
        )
        for pixel, keyframe, landmark in sightings:
            self.graph.add(
                gtsam.GenericProjectionFactorCal3_S2(
                    pixel,
                    noise,
                    self.keys.X(int(keyframe)),
                    self.keys.L(int(landmark)),
                    intrinsics,
                    mount,
                )
            )

    def _sense(self, problem: Problem, place: int) -> None:
        measured, keys = problem.preintegrated, self.keys
        duration_s = measured.durations_s[place]
        rotated, gained, moved = (
            item[place] for item in (measured.rotations, measured.velocities, measured.positions)
        )

        def errors(values: list[Any]) -> np.ndarray:
            earlier, velocity, later, after = values
            into = earlier.rotation().matrix().T
            fall = problem.gravity * duration_s
            rotation = rotated.T @ into @ later.rotation().matrix()
            shift = later.translation() - earlier.translation()
            return np.concatenate(
                [
                    self.gtsam.Rot3.Logmap(self.gtsam.Rot3(rotation)),
                    into @ (after - velocity - fall) - gained,
                    into @ (shift - (velocity + fall / 2.0) * duration_s) - moved,
                ]
            )

        noise = self.gtsam.noiseModel.Gaussian.Covariance(measured.covariances[place])
        names = [keys.X(place), keys.V(place), keys.X(place + 1), keys.V(place + 1)]
        self._add(noise, names, [False, True, False, True], errors)

    def _hold(self, start: State, weight: float) -> None:
        rotation, position = start.rotations[0], start.positions[0]

        def errors(values: list[Any]) -> np.ndarray:
            (pose,) = values
            rotation_step = self.gtsam.Rot3(pose.rotation().matrix() @ rotation.T)
            return np.append(
                pose.translation() - position, self.gtsam.Rot3.Logmap(rotation_step)[2]
            )

        noise = self.gtsam.noiseModel.Isotropic.Precision(4, weight)
        self._add(noise, [self.keys.X(0)], [False], errors)

    def _add(
        self,
        noise: Any,
        names: list[int],
        are_vectors: list[bool],
        errors: Callable[[list[Any]], np.ndarray],
    ) -> None:
        def factor(_: Any, values: Any, jacobians: list[np.ndarray] | None) -> np.ndarray:
            result = [
                values.atVector(name) if is_vector else values.atPose3(name)
                for name, is_vector in zip(names, are_vectors, strict=True)
            ]
            if jacobians is not None:
                for place, is_vector in enumerate(are_vectors):
                    jacobians[place] = _derivative(errors, result, place, is_vector=is_vector)
            return errors(result)

        self.graph.add(self.gtsam.CustomFactor(noise, names, factor))


def _derivative(
    errors: Callable[[list[Any]], np.ndarray], values: list[Any], place: int, *, is_vector: bool
) -> np.ndarray:
    """Return d errors / d value by central differences."""

    def moved(step: np.ndarray) -> list[Any]:
        changed = values[place] + step if is_vector else values[place].retract(step)
        return [*values[:place], changed, *values[place + 1 :]]

    columns = [
        (errors(moved(step)) - errors(moved(-step))) / (2.0 * _STEP)
        for step in _STEP * np.eye(3 if is_vector else 6)
    ]
    return np.asfortranarray(np.stack(columns, axis=1))
