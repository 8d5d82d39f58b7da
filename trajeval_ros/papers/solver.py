"""Levenberg-Marquardt by the rules of Ceres, with three ways to handle the gauge.

The rules are those of `levenberg_marquardt_strategy.cc` and `trust_region_minimizer.cc` with
their default settings. No library's solver is used, since the handling of the gauge is what is
studied (gauge paper, section III).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.papers.problem import NormalEquations, Problem
from trajeval_ros.papers.reduction import ReducedSystem, reduce_landmarks
from trajeval_ros.papers.state import MOTION_WIDTH, State

# The first position, and the z component of the first rotation's Dphi: eq. (10).
GAUGE_INDICES = np.array([0, 1, 2, 5])

_FIRST_RADIUS, _LARGEST_RADIUS, _SMALLEST_RADIUS = 1e4, 1e16, 1e-32
_SMALLEST_DIAGONAL, _LARGEST_DIAGONAL = 1e-6, 1e32
_LEAST_QUALITY = 1e-3
_MOST_ITERATIONS = 50
# Smaller relative changes of the cost are rounding.
_ROUNDING = 1e-12
_GRADIENT_TOLERANCE, _STEP_TOLERANCE = 1e-10, 1e-8


class GaugeHandling(Enum):
    """How the gauge freedom is handled (gauge paper, Table I)."""

    FIXATION = "fixation"
    PRIOR = "prior"
    FREE = "free"


@dataclass(frozen=True, eq=False)
class Trace:
    """Properties of the I accepted states and, first, of the initial state, (I + 1,)."""

    cost: Floats  # half the squared length of all residuals, the prior's included
    reprojection_px: Floats  # mean reprojection error
    position_m: Floats  # distance of the first position from its initial value
    yaw_deg: Floats  # absolute z component of the first rotation's Dphi


@dataclass(frozen=True, eq=False)
class SolverResult:
    """The result of the iterations."""

    state: State  # the estimate
    cost: float  # cost of the state
    iterations: int  # number of linear solves
    reason: str  # stopping rule: `function`, `step`, `gradient`, `iterations` or `radius`
    trace: Trace  # costs and gauge of the accepted states


def solve(
    problem: Problem,
    initial: State,
    handling: GaugeHandling,
    prior_weight: float = 1e5,
    function_tolerance: float = 1e-6,
    *,
    keep_last_step: bool = True,
) -> SolverResult:
    """Minimise eq. (1).

    Args:
        initial: Initial state; also the reference of gauge fixation and gauge prior.
        prior_weight: w of the gauge prior, eq. (11), for position (1/m^2) and yaw (1/rad^2).
        function_tolerance: Relative change of the cost below which the iterations stop.
        keep_last_step: Ceres discards the step with which it detects convergence. False does so,
            too, and reproduces the paper's differences between gauges. True is closer to the
            minimum.
    """
    descent = _Descent(problem, handling, prior_weight if handling is GaugeHandling.PRIOR else 0.0)
    state, here = initial, descent.at(initial)
    radius, shrink = _FIRST_RADIUS, 2.0
    scale = 1.0 / (1.0 + np.sqrt(here.curvature))
    trace = [descent.traced(state, here)]
    iterations, accepted, reason, reached = 0, 0, "", here.cost
    while not reason:
        if here.steepest(descent.free) <= _GRADIENT_TOLERANCE:
            reason = "gradient"
            break
        if iterations == _MOST_ITERATIONS:
            reason = "iterations"
            break
        iterations += 1
        scaled = np.clip(here.curvature * scale**2, _SMALLEST_DIAGONAL, _LARGEST_DIAGONAL)
        damping = scaled / scale**2 / radius
        step, gain = descent.step(here, damping)
        if gain <= 0.0:
            radius, shrink = radius / shrink, 2.0 * shrink
            continue
        candidate = state.moved(step)
        cost = descent.cost(candidate)
        change = here.cost - cost
        if accepted and np.linalg.norm(step) <= _STEP_TOLERANCE * (_size(state) + _STEP_TOLERANCE):
            reason = "step"
        elif abs(change) <= function_tolerance * here.cost:
            reason = "function"
        if reason:
            if keep_last_step and change >= -_ROUNDING * here.cost:
                state, reached = candidate, cost
            break
        if change <= _LEAST_QUALITY * gain:
            radius, shrink = radius / shrink, 2.0 * shrink
            reason = "radius" if radius < _SMALLEST_RADIUS else ""
            continue
        quality = change / gain
        radius = min(_LARGEST_RADIUS, radius / max(1.0 / 3.0, 1.0 - (2.0 * quality - 1.0) ** 3))
        shrink, accepted = 2.0, accepted + 1
        state, here, reached = candidate, descent.at(candidate), cost
        trace.append(descent.traced(state, here))
    columns = (np.array(column) for column in zip(*trace, strict=True))
    return SolverResult(state, reached, iterations, reason, Trace(*columns))


@dataclass(frozen=True, eq=False)
class _Linearised:
    """The normal equations at a state, including the gauge prior."""

    normal: NormalEquations
    cost: float
    prior: Floats  # (4,), gradient of the prior
    weight: float  # of the prior

    @property
    def curvature(self) -> Floats:
        """Diagonal of J^T J, (9N + 3K,)."""
        motion = np.diagonal(self.normal.diagonal, axis1=1, axis2=2).ravel()
        motion[GAUGE_INDICES] += self.weight
        landmarks = np.diagonal(self.normal.landmark, axis1=1, axis2=2)
        return np.concatenate([motion, landmarks.ravel()])

    @property
    def gradient(self) -> Floats:
        """J^T r, (9N + 3K,)."""
        motion = self.normal.motion_gradient.ravel().copy()
        motion[GAUGE_INDICES] += self.prior
        return np.concatenate([motion, self.normal.landmark_gradient.ravel()])

    def steepest(self, free: Booleans) -> float:
        """Return the largest component of the gradient along free parameters."""
        motion, landmarks = np.split(self.gradient, [len(free)])
        return float(max(np.abs(motion[free]).max(), np.abs(landmarks).max()))


class _Descent:
    """The computations that depend on the handling of the gauge."""

    def __init__(self, problem: Problem, handling: GaugeHandling, weight: float) -> None:
        self.problem, self.weight = problem, weight
        self.free = np.ones(MOTION_WIDTH * problem.keyframes, dtype=bool)
        if handling is GaugeHandling.FIXATION:
            self.free[GAUGE_INDICES] = False

    def at(self, state: State) -> _Linearised:
        normal = self.problem.normal_equations(state)
        residual = _from_reference(state)
        cost = normal.cost + 0.5 * self.weight * float(residual @ residual)
        return _Linearised(normal, cost, self.weight * residual, self.weight)

    def cost(self, state: State) -> float:
        residual = _from_reference(state)
        return self.problem.cost(state) + 0.5 * self.weight * float(residual @ residual)

    def traced(self, state: State, here: _Linearised) -> tuple[float, float, float, float]:
        shift = _from_reference(state)
        yaw_deg = float(np.degrees(np.abs(shift[3])))
        return here.cost, here.normal.reprojection_px, float(np.linalg.norm(shift[:3])), yaw_deg

    def step(self, here: _Linearised, damping: Floats) -> tuple[Floats, float]:
        """Return the damped step and the predicted decrease of the cost; 0 if there is no step."""
        motion_damping, landmark_damping = np.split(damping, [len(self.free)])
        try:
            reduced = reduce_landmarks(
                here.normal, motion_damping, landmark_damping.reshape(-1, 3)
            )
            motion = self._solved(reduced, here.prior)
        except np.linalg.LinAlgError:
            # With almost no damping the free gauge's matrix is singular: a decrease of 0 increases
            # damping.
            return np.zeros(len(damping)), 0.0
        step = np.concatenate([motion, reduced.landmarks_after(motion)])
        # -g d - d H d / 2 with (H + D) d = -g.
        gain = -0.5 * float(here.gradient @ step) + 0.5 * float((damping * step) @ step)
        return step, gain

    def _solved(self, reduced: ReducedSystem, prior: Floats) -> Floats:
        matrix, gradient = reduced.matrix, reduced.gradient.ravel()
        matrix.diagonal[GAUGE_INDICES] += self.weight
        gradient[GAUGE_INDICES] += prior
        if not self.free.all():
            matrix.hold(GAUGE_INDICES)
            gradient[GAUGE_INDICES] = 0.0
        return matrix.solved(-gradient)


def _from_reference(state: State) -> Floats:
    """Return the residual of the prior, eq. (11): shift (3,) and yaw of the first keyframe."""
    shift = state.positions[0] - state.reference_position
    return np.append(shift, state.first_turn[2])


def _size(state: State) -> float:
    """Return the norm of all parameters; a quaternion has norm 1."""
    parts = state.positions, state.velocities, state.landmarks
    return float(np.sqrt(sum(np.vdot(part, part) for part in parts) + len(state.positions)))
