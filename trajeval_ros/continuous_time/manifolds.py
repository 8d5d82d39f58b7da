"""Manifolds of Markov processes: positions in R^3, or rotations in SO(3).

A local variable g is 0 at a knot T and Log(T^-1 T') at the next. Its first two derivatives follow
from the next knot's rate w and acceleration a (Barfoot, State Estimation for Robotics, sec. 11):

    g' = J_r^-1(g) w,    g'' = d(J_r^-1(g) w)/dg g' + J_r^-1(g) a
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from trajeval_ros.geometry import se3, so3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.so3 import skew

# Coefficient of the inverse Jacobian's quadratic term, as a series in the squared angle.
_SERIES = np.polynomial.Polynomial(
    [1 / 12, 1 / 720, 1 / 30240, 1 / 1209600, 1 / 47900160, 691 / 1307674368000, 1 / 74724249600]
)
_SERIES_1, _SERIES_2 = _SERIES.deriv(), _SERIES.deriv(2)
_SMALL = 0.5


@dataclass(frozen=True, eq=False)
class LocalVariable:
    """The derivatives of a local variable, and their Jacobian."""

    values: Floats  # (N, m, d): g and its derivatives, as many as the process has
    jacobian: Floats  # (N, m, d, m, d): of `values` by g, w, a


class Manifold(Protocol):
    """Operations of a process on its states."""

    def between(self, first: Floats, second: Floats) -> Floats:
        """Return Log(first^-1 second), (N, d)."""

    def plus(self, states: Floats, steps: Floats) -> Floats:
        """Return states perturbed by steps (N, d) on the right."""

    def inverse_jacobians(self, steps: Floats) -> tuple[Floats, Floats]:
        """Return J_r^-1 and J_l^-1 (N, d, d)."""

    def local(self, steps: Floats, rates: Floats) -> LocalVariable:
        """Return the local variable at steps g (N, d) with rates (N, m - 1, d)."""


class Positions:
    """R^3; all operations are linear."""

    def between(self, first: Floats, second: Floats) -> Floats:
        """Return the differences (N, 3)."""
        return second - first

    def plus(self, states: Floats, steps: Floats) -> Floats:
        """Return the sums (N, 3)."""
        return states + steps

    def inverse_jacobians(self, steps: Floats) -> tuple[Floats, Floats]:
        """Return identities (N, 3, 3)."""
        identities = np.broadcast_to(np.eye(3), (*steps.shape, 3))
        return identities, identities

    def local(self, steps: Floats, rates: Floats) -> LocalVariable:
        """Return the arguments, since the manifold is linear."""
        values = np.concatenate([steps[:, None], rates], axis=1)
        count, order = values.shape[:2]
        jacobian = np.eye(3 * order).reshape(order, 3, order, 3)
        return LocalVariable(values, np.broadcast_to(jacobian, (count, order, 3, order, 3)))


class Rotations:
    """SO(3)."""

    def between(self, first: Floats, second: Floats) -> Floats:
        """Return the rotation vectors (N, 3) from first to second (N, 3, 3)."""
        return so3.log(se3.transposed(first) @ second)

    def plus(self, states: Floats, steps: Floats) -> Floats:
        """Return rotations (N, 3, 3) perturbed by rotation vectors (N, 3) on the right."""
        rotated: Floats = states @ so3.exp(steps)
        return rotated

    def inverse_jacobians(self, steps: Floats) -> tuple[Floats, Floats]:
        """Return J_r^-1 and J_l^-1 (N, 3, 3); one is the transpose of the other."""
        left = so3.inverse_left_jacobian(steps)
        return se3.transposed(left), left

    def local(self, steps: Floats, rates: Floats) -> LocalVariable:
        """Return the local variable and its exact derivatives, up to the second."""
        count, order = len(steps), rates.shape[1] + 1
        values = np.zeros((count, order, 3))
        jacobian = np.zeros((count, order, 3, order, 3))
        values[:, 0] = steps
        jacobian[:, 0, :, 0] = np.eye(3)
        if order == 1:
            return LocalVariable(values, jacobian)
        inverse, _ = self.inverse_jacobians(steps)
        values[:, 1] = rate = se3.times(inverse, rates[:, 0])
        by_step = _derivative(steps, rates[:, 0])
        jacobian[:, 1, :, 0], jacobian[:, 1, :, 1] = by_step, inverse
        if order == 3:
            values[:, 2] = se3.times(by_step, rate) + se3.times(inverse, rates[:, 1])
            curved = _second_derivative(steps, rates[:, 0], rate)
            jacobian[:, 2, :, 0] = curved + by_step @ by_step + _derivative(steps, rates[:, 1])
            jacobian[:, 2, :, 1] = _along(steps, rate) + by_step @ inverse
            jacobian[:, 2, :, 2] = inverse
        return LocalVariable(values, jacobian)


def _factors(steps: Floats) -> tuple[Floats, Floats, Floats]:
    """Return k(s) of J_r^-1 = 1 + [g]/2 + k [g]^2, s = g.g, and its derivatives, (N, 1, 1)."""
    s = np.sum(steps * steps, axis=-1)[..., None, None]
    small = s < _SMALL
    squared = np.where(small, 1.0, s)
    x = np.sqrt(squared) / 2.0
    cotangent, cosecant2 = 1.0 / np.tan(x), 1.0 / np.sin(x) ** 2
    slope = (cotangent / x - cosecant2) / 8.0
    bend = (2.0 * cosecant2 * cotangent - cosecant2 / x - cotangent / x**2) / (64.0 * x)
    k = (1.0 - x * cotangent) / squared
    k1 = -(slope + k) / squared
    k2 = -(bend + 2.0 * k1) / squared
    return (
        np.where(small, _SERIES(s), k),
        np.where(small, _SERIES_1(s), k1),
        np.where(small, _SERIES_2(s), k2),
    )


def _derivative(g: Floats, w: Floats) -> Floats:
    """Return d(J_r^-1(g) w)/dg, (N, 3, 3)."""
    k, k1, _ = _factors(g)
    gw = np.cross(g, w)
    derivative: Floats = (
        -0.5 * skew(w)
        - k * (skew(gw) + skew(g) @ skew(w))
        + 2.0 * k1 * np.cross(g, gw)[:, :, None] * g[:, None, :]
    )
    return derivative


def _along(g: Floats, u: Floats) -> Floats:
    """Return the derivative of J_r^-1(g) in the direction u, (N, 3, 3)."""
    k, k1, _ = _factors(g)
    cross, other = skew(g), skew(u)
    inner = np.sum(g * u, axis=-1)[:, None, None]
    change: Floats = 0.5 * other + k * (other @ cross + cross @ other)
    change += 2.0 * k1 * inner * (cross @ cross)
    return change


def _second_derivative(g: Floats, w: Floats, u: Floats) -> Floats:
    """Return d(d(J_r^-1(g) w)/dg u)/dg for constant u, (N, 3, 3)."""
    k, k1, k2 = _factors(g)
    gw, uw = np.cross(g, w), np.cross(u, w)
    ggw = np.cross(g, gw)[:, :, None]
    inner = np.sum(g * u, axis=-1)[:, None, None]
    mixed = (np.cross(u, gw) + np.cross(g, uw))[:, :, None]
    row = g[:, None, :]
    second: Floats = (
        -k * (skew(u) @ skew(w) + skew(uw))
        + 2.0 * k1 * (mixed * row + ggw * u[:, None, :])
        - 2.0 * k1 * inner * (skew(gw) + skew(g) @ skew(w))
        + 4.0 * k2 * inner * ggw * row
    )
    return second
