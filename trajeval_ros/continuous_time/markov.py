"""Markov priors with white noise on acceleration (WNOA) or jerk (WNOJ), exactly sparse.

Barfoot, Tong and Sarkka, RSS 2014; Dong, Boots and Dellaert, 2017. One process covers the whole
trajectory. It is continuous by construction and has the joint covariance of any times. Positions
and rotations are independent processes. The cost is O(N).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from trajeval_ros.continuous_time import white_noise
from trajeval_ros.continuous_time.manifolds import Manifold
from trajeval_ros.geometry import lie, se3
from trajeval_ros.geometry.arrays import Floats, Indices, at_rows
from trajeval_ros.geometry.banded_matrices import Factor

_MOST_KNOTS = 1500
_MOST_ITERATIONS = 10
_CONVERGED = 1e-8
_IMPOSSIBLE = 1e25
_STILL_S, _STILL_STEPS = 2.0, 10
_MOST_ABOVE_ROUGH = 1e5


@dataclass(frozen=True, eq=False)
class Process:
    """N knots of a Markov process at their most likely states."""

    manifold: Manifold  # manifold of the states
    order: int  # m: 2 for WNOA, 3 for WNOJ (1, Brownian motion, is linear interpolation)
    times: Floats  # (N,), seconds, increasing
    measured: Floats  # (N, ...), samples
    information: Floats  # (N, d), inverse variances of the samples; zero for a knot without one
    density: Floats  # (d,), power spectral density of the noise
    states: Floats  # (N, ...), the most likely states
    rates: Floats  # (N, m - 1, d), velocities and accelerations; in the body for rotations

    @classmethod
    def fit(
        cls, manifold: Manifold, order: int, times: Floats, measured: Floats, noise: float
    ) -> Process:
        """Estimate the density by maximum likelihood, and the most likely states.

        Times (N,), seconds, are distinct and in order. The order m is reduced if there are not
        more samples. The noise is the standard deviation of the samples along all axes.
        """
        start = cls.unsolved(manifold, order, times, measured, noise)
        likely = start._most_likely_density(noise)
        return replace(start, density=np.full_like(start.density, likely))._solved_with_digits()

    @classmethod
    def unsolved(
        cls, manifold: Manifold, order: int, times: Floats, measured: Floats, noise: float
    ) -> Process:
        """Return the process with density 1, states as measured and rates by differences.

        The arguments are those of `fit`.
        """
        order = min(order, len(times) - 1)
        velocity, acceleration = _differences(manifold, times, measured)
        rates = np.stack([velocity, acceleration], axis=1)[:, : order - 1]
        return cls(
            manifold,
            order,
            times,
            measured,
            np.full(velocity.shape, noise**-2),
            np.ones(velocity.shape[1]),
            measured,
            rates,
        )

    @property
    def dimension(self) -> int:
        """Dimension d of the manifold."""
        return int(self.information.shape[1])

    def solved(self, iterations: int = _MOST_ITERATIONS, tolerance: float = _CONVERGED) -> Process:
        """Return the process at its mode, by Gauss-Newton."""
        process, dimension = self, self.dimension
        for _ in range(iterations):
            diagonal, lower, slope, cost = process._normal_equations()
            step = Factor.of(diagonal, lower).solve(slope)
            process = replace(
                process,
                states=process.manifold.plus(process.states, step[:, :dimension]),
                rates=process.rates + step[:, dimension:].reshape(process.rates.shape),
            )
            if 0.5 * np.vdot(step, slope) < tolerance * max(1.0, 1e-6 * cost):
                break
        return process

    def _solved_with_digits(self) -> Process:
        """Return the process at its mode; the density is increased if the matrix is singular."""
        try:
            return self.solved()
        except np.linalg.LinAlgError:
            return replace(self, density=10.0 * self.density)._solved_with_digits()

    def log_likelihood(self) -> float:
        """Return log p of the samples at the mode; exact in R^3, else by Laplace's method."""
        diagonal, lower, _, cost = self._normal_equations()
        steps = np.diff(self.times)
        motion = len(steps) * self.order * np.log(self.density).sum()
        spread = np.linalg.slogdet(white_noise.covariance(self.order, steps))[1]
        motion += self.dimension * spread.sum()
        known = self.information > 0.0
        noise = -np.log(self.information[known]).sum()
        determinant = Factor.of(diagonal, lower).log_determinant
        freedom = np.count_nonzero(known) - self.dimension * self.order
        return float(
            -cost - 0.5 * (determinant + motion + noise) - 0.5 * freedom * np.log(2.0 * np.pi)
        )

    def carried(self, knots: Indices, since: Floats) -> Floats:
        """Return the derivatives (Q, d, d m) of states a time (Q,) after knots by the knots' own.

        Without noise, the state is T Exp(x), x = t T' + t^2 T'' / 2. Perturbations on the right
        become J_r(x) (J_l^-1(x) dT + t dT' + t^2 dT'' / 2). Times, seconds, may be negative.
        """
        dimension = self.dimension
        phi = white_noise.transition(self.order, since)[:, 0]
        moved = np.einsum("qk,qkd->qd", phi[:, 1:], self.rates[knots])
        right, left = self.manifold.inverse_jacobians(moved)
        by_knot = np.einsum("qk,de->qdke", phi, np.eye(dimension)).reshape(
            len(since), dimension, -1
        )
        by_knot[:, :, :dimension] = left
        derivatives: Floats = np.linalg.solve(right, by_knot)
        return derivatives

    def factor(self) -> Factor:
        """Return the factor of the information of all knots (N d m, N d m)."""
        diagonal, lower, _, _ = self._normal_equations()
        return Factor.of(diagonal, lower)

    def interpolator(self) -> Interpolator:
        """Return the interpolation between the knots."""
        return Interpolator(self, *self.factor().inverse_blocks())

    def _normal_equations(self) -> tuple[Floats, Floats, Floats, float]:
        """Return the information's blocks, minus the cost's gradient (N, d m), and the cost."""
        size, dimension = self.dimension * self.order, self.dimension
        this, following, lower, slope_this, slope_following, costs = lie.by_blocks(
            self._between,
            self.states[:-1],
            self.states[1:],
            self.rates[:-1],
            self.rates[1:],
            np.diff(self.times),
        )
        diagonal = np.zeros((len(self.times), size, size))
        diagonal[:-1] = this
        diagonal[1:] += following
        slope = np.zeros((len(self.times), size))
        slope[:-1] = slope_this
        slope[1:] += slope_following

        missed = self.manifold.between(self.measured, self.states)
        jacobian, _ = self.manifold.inverse_jacobians(missed)
        weighted = se3.transposed(self.information[..., None] * jacobian)
        diagonal[:, :dimension, :dimension] += weighted @ jacobian
        slope[:, :dimension] -= se3.times(weighted, missed)
        cost = float(costs.sum()) + 0.5 * float(np.sum(self.information * np.square(missed)))
        return diagonal, lower, slope, cost

    def _between(
        self, first: Floats, second: Floats, rates: Floats, next_rates: Floats, steps: Floats
    ) -> tuple[Floats, ...]:
        """Return the terms of K steps: blocks of both knots, between them, gradients, and cost.

        The rates (K, m - 1, d) are at the starts and ends of the steps (K,), seconds.
        """
        size, dimension = self.dimension * self.order, self.dimension
        local = self.manifold.local(self.manifold.between(first, second), next_rates)
        phi = white_noise.transition(self.order, steps)
        start = np.concatenate([np.zeros((len(steps), 1, dimension)), rates], axis=1)
        residual = (local.values - phi @ start).reshape(-1, size)
        by_next = local.jacobian.copy()
        by_step = local.jacobian[:, :, :, 0, :]
        right, left = self.manifold.inverse_jacobians(local.values[:, 0])
        by_next[:, :, :, 0, :] = by_step @ right[:, None]
        by_next = by_next.reshape(-1, size, size)
        # A step of this knot takes J_l^-1 from g; its rates act through Phi.
        by_this = -white_noise.spread_over_axes(phi, np.ones(dimension))
        by_this[:, :, :dimension] = -(by_step @ left[:, None]).reshape(-1, size, dimension)
        weight = white_noise.spread_over_axes(
            white_noise.information(self.order, steps), 1.0 / self.density
        )
        weighted_this, weighted_next = weight @ by_this, weight @ by_next
        return (
            se3.transposed(by_this) @ weighted_this,
            se3.transposed(by_next) @ weighted_next,
            se3.transposed(by_next) @ weighted_this,
            -se3.times(se3.transposed(weighted_this), residual),
            -se3.times(se3.transposed(weighted_next), residual),
            0.5 * np.sum(residual * se3.times(weight, residual), axis=1),
        )

    def _most_likely_density(self, noise: float) -> float:
        """Return the density with the largest likelihood of the middle 1500 samples."""
        skip = max(0, (len(self.times) - _MOST_KNOTS) // 2)
        middle = slice(skip, skip + _MOST_KNOTS)
        columns = "times", "measured", "information", "states", "rates"
        warm = [at_rows(self, columns, middle)]

        def cost(log_density: float) -> float:
            try:
                density = np.full_like(self.density, np.exp(log_density))
                process = replace(warm[0], density=density).solved(4, 1e-3)
                value = -process.log_likelihood()
            except np.linalg.LinAlgError:
                return _IMPOSSIBLE
            warm[0] = process
            return value

        steps = np.diff(warm[0].times)
        if self.order == 1:
            jumps = self.manifold.between(warm[0].states[:-1], warm[0].states[1:])
        else:
            jumps = np.diff(warm[0].rates[:, -1], axis=0)
        rough = float(np.median(np.square(jumps).mean(axis=1) / steps))
        # The least density moves a state by the noise within a few seconds.
        span = min(float(steps.sum()), max(_STILL_S, _STILL_STEPS * float(np.median(steps))))
        least = noise**2 / span ** (2 * self.order - 1)
        most = max(rough, least) * _MOST_ABOVE_ROUGH
        optimum = minimize_scalar(
            cost,
            bounds=(np.log(least), np.log(most)),
            method="bounded",
            options={"maxiter": 30, "xatol": 3e-3},
        )
        return float(np.exp(optimum.x))


@dataclass(frozen=True, eq=False)
class Interpolator:
    """A process with the covariances of its knots."""

    process: Process  # the process at its mode
    marginals: Floats  # (N, d m, d m), covariances of the knots
    between: Floats  # (N - 1, d m, d m), covariances between consecutive knots

    def at(self, times: Floats) -> tuple[Floats, Floats]:
        """Return states (Q, ...) and right covariances (Q, d, d) at times within the knots."""
        states, covariances = lie.by_blocks(self._at, times)
        return states, covariances

    def _at(self, times: Floats) -> tuple[Floats, Floats]:
        """Interpolate one block of times (Q,)."""
        process, order, dimension = self.process, self.process.order, self.process.dimension
        last = len(process.times) - 2
        knot = np.clip(np.searchsorted(process.times, times, side="right") - 1, 0, last)
        step, since = np.diff(process.times)[knot], times - process.times[knot]
        by_first, by_second, spread = white_noise.interpolation(order, step, since)

        manifold, rates = process.manifold, process.rates
        here = process.states[knot]
        gap = manifold.between(here, process.states[knot + 1])
        second = manifold.local(gap, rates[knot + 1])
        first = manifold.local(np.zeros_like(gap), rates[knot])
        variable = np.einsum("qm,qmi->qi", by_first, first.values)
        variable += np.einsum("qm,qmi->qi", by_second, second.values)
        # The chart is fixed at the first knot, so that a knot affects its own end only.
        ahead = second.jacobian.copy()
        jacobian, _ = manifold.inverse_jacobians(gap)
        ahead[:, :, :, 0, :] = ahead[:, :, :, 0, :] @ jacobian[:, None]
        shape = (-1, dimension, dimension * order)
        a = np.einsum("qm,qmijk->qijk", by_first, first.jacobian).reshape(shape)
        b = np.einsum("qm,qmijk->qijk", by_second, ahead).reshape(shape)
        mixed = a @ self.between[knot] @ se3.transposed(b)
        covariance = se3.congruent(a, self.marginals[knot]) + se3.congruent(
            b, self.marginals[knot + 1]
        )
        covariance += mixed + se3.transposed(mixed)
        covariance += spread[:, None, None] * np.diag(process.density)
        carried = np.linalg.inv(manifold.inverse_jacobians(variable)[0])
        return manifold.plus(here, variable), se3.congruent(carried, covariance)


def _differences(manifold: Manifold, times: Floats, states: Floats) -> tuple[Floats, Floats]:
    """Return initial velocities and accelerations (N, d), by finite differences."""
    steps = np.diff(times)
    between = manifold.between(states[:-1], states[1:]) / steps[:, None]
    velocity = np.concatenate([between[:1], between])
    if len(steps) > 1:
        share = (steps[1:] / (steps[1:] + steps[:-1]))[:, None]
        velocity[1:-1] = between[:-1] * share + between[1:] * (1.0 - share)
    return velocity, np.gradient(velocity, times, axis=0)
