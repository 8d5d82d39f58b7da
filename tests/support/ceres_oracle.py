"""The estimation problem in Ceres, by its Python bindings: the rules that the solver follows.

Residuals and their derivatives are this package's, which have their own tests; steps, damping,
scaling and stopping are those of Ceres with its default settings.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from visual_inertial_scenes import visual_errors

from trajeval_ros.geometry import lie, so3
from trajeval_ros.papers.problem import Problem
from trajeval_ros.papers.solver import GaugeHandling
from trajeval_ros.papers.state import State


@dataclass(frozen=True, eq=False)
class CeresSolution:
    """What Ceres found: the state, half the squared residuals, and the number of linear solves."""

    state: State
    cost: float
    iterations: int


def solve_with_ceres(
    ceres: Any, problem: Problem, start: State, handling: GaugeHandling, weight: float
) -> CeresSolution:
    """Minimise eq. (1) with Ceres."""
    count = problem.keyframes
    positions = [row.copy() for row in start.positions]
    # The first rotation is a vector, eq. (9), and all others quaternions.
    rotations = [np.zeros(3), *(row.copy() for row in lie.from_matrices(start.rotations)[1:])]
    velocities = [row.copy() for row in start.velocities]
    landmarks = [row.copy() for row in start.landmarks]
    blocks = [*positions, *rotations, *velocities, *landmarks]

    def state_of(values: list[np.ndarray]) -> State:
        first_turn = np.array(values[count])
        others = lie.to_matrix(lie.normalized(np.array(values[count + 1 : 2 * count])))
        return State(
            np.array(values[:count]),
            np.concatenate([(so3.exp(first_turn) @ start.rotations[0])[None], others]),
            np.array(values[2 * count : 3 * count]),
            np.array(values[3 * count :]),
            first_turn,
            start.rotations[0],
            start.positions[0],
        )

    sizes = [len(block) for block in blocks]
    rows = problem.pixels.size + 9 * (count - 1)
    root = np.sqrt(weight)

    class Residuals(ceres.CostFunction):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__()
            self.set_num_residuals(rows + 4)
            self.set_parameter_block_sizes(sizes)

        def Evaluate(self, values: Any, residuals: Any, jacobians: Any) -> bool:  # noqa: N802
            state = state_of(list(values))
            visual, inertial = problem.residuals(state)
            shift = np.append(state.positions[0] - start.positions[0], state.first_turn[2])
            residuals[:] = np.concatenate([visual.ravel(), inertial.ravel(), root * shift])
            if jacobians is not None:
                dense = _jacobian(problem, state, root)
                for place, block in enumerate(jacobians):
                    if block is not None:
                        own = dense[:, 3 * place : 3 * place + 3]
                        if sizes[place] == 4:
                            own = own @ _by_quaternion(np.array(values[place]))
                        block[:] = own.ravel() if block.ndim == 1 else own
            return True

    model = ceres.Problem()
    model.add_residual_block(Residuals(), None, blocks)
    for block in rotations[1:]:
        model.set_manifold(block, ceres.EigenQuaternionManifold())
    if handling is GaugeHandling.FIXATION:
        model.set_parameter_block_constant(positions[0])
        model.set_manifold(rotations[0], ceres.SubsetManifold(3, [2]))
    options, summary = ceres.SolverOptions(), ceres.SolverSummary()
    options.linear_solver_type = ceres.LinearSolverType.DENSE_QR
    options.minimizer_progress_to_stdout = False
    options.num_threads = 1
    ceres.solve(options, model, summary)
    iterations = summary.num_successful_steps + summary.num_unsuccessful_steps
    return CeresSolution(state_of(blocks), summary.final_cost, iterations)


def _jacobian(problem: Problem, state: State, root: float) -> np.ndarray:
    """Return the derivative by position, left rotation, velocity of all, and landmarks."""
    count, (_, by_point, rays) = problem.keyframes, visual_errors(problem, state)
    inertial = problem.inertial(state)
    rows, size = np.arange(len(by_point)), by_point.shape[1]
    visual = np.zeros((len(by_point), size, 3 * count + problem.landmarks, 3))
    by_turn = by_point @ so3.skew(rays)
    first = problem.visibility.keyframe_of == 0
    by_turn[first] = by_turn[first] @ so3.left_jacobian(state.first_turn)
    visual[rows, :, problem.visibility.keyframe_of] = -by_point
    visual[rows, :, count + problem.visibility.keyframe_of] = by_turn
    visual[rows, :, 3 * count + problem.visibility.landmark_of] = by_point
    moved = np.zeros((count - 1, 9, 3 * count + problem.landmarks, 3))
    item = np.arange(count - 1)
    for part in range(3):
        columns = slice(3 * part, 3 * part + 3)
        moved[item, :, part * count + item] = inertial.by_before[:, :, columns]
        moved[item, :, part * count + item + 1] = inertial.by_after[:, :, columns]
    prior = np.zeros((4, 3 * count + problem.landmarks, 3))
    prior[[0, 1, 2], 0, [0, 1, 2]] = prior[3, count, 2] = root
    parts = (
        visual.reshape(len(rows) * size, -1),
        moved.reshape(9 * (count - 1), -1),
        prior.reshape(4, -1),
    )
    return np.concatenate(parts)


def _by_quaternion(quaternion: np.ndarray) -> np.ndarray:
    """Return d rotation / d quaternion (3, 4), xyzw: twice the vector part of dq q*."""
    x, y, z, w = quaternion
    return 2.0 * np.array([[w, -z, y, -x], [z, w, -x, -y], [-y, x, w, -z]])
