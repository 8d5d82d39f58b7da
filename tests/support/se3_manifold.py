"""SE(3) as what a Markov process moves on; the product moves positions and rotations apart."""

from __future__ import annotations

from math import factorial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import bernoulli

from trajeval_ros.continuous_time.manifolds import LocalVariable
from trajeval_ros.geometry import se3, so3

Array = NDArray[np.float64]

# J_r^-1(g) = sum (-1)^n B_n / n! ad(g)^n: at half a radian the last term is below 1e-40.
_COEFFICIENTS = [(-1) ** n * b / factorial(n) for n, b in enumerate(bernoulli(36))]
# Derivatives by a step along the imaginary axis lose no digits, however short it is.
_STEP = 1e-30


def _basis() -> Array:
    """Return ad of the six unit twists, (6, 6, 6)."""
    translation, rotation = so3.skew(np.eye(6)[:, :3]), so3.skew(np.eye(6)[:, 3:])
    nothing = np.zeros_like(rotation)
    return np.block([[rotation, translation], [nothing, rotation]])


_BASIS = _basis()


class Poses:
    """SE(3), twists of translation first."""

    def between(self, first: Array, second: Array) -> Array:
        """Return the twists (N, 6) from first to second (N, 4, 4)."""
        return se3.log(se3.inverse(first) @ second)

    def plus(self, states: Array, steps: Array) -> Array:
        """Return the poses (N, 4, 4) moved by twists (N, 6) in the body."""
        moved: Array = states @ se3.exp(steps)
        return moved

    def inverse_jacobians(self, steps: Array) -> tuple[Array, Array]:
        """Return J_r^-1 and J_l^-1 (N, 6, 6)."""
        return se3.inverse_left_jacobian(-steps), se3.inverse_left_jacobian(steps)

    def local(self, steps: Array, rates: Array) -> LocalVariable:
        """Return the local variable and its derivatives, up to the second one."""
        given = np.concatenate([steps[:, None], rates], axis=1)
        jacobian = np.zeros((*given.shape, *given.shape[1:]))
        for row, column in np.ndindex(given.shape[1:]):
            moved = given.astype(complex)
            moved[:, row, column] += 1j * _STEP
            jacobian[..., row, column] = _derivatives(moved).imag / _STEP
        return LocalVariable(_derivatives(given), jacobian)


def _derivatives(given: NDArray[Any]) -> NDArray[Any]:
    """Return g, g', g'' of g, w, a (N, m, 6), real or complex."""
    values = [given[:, 0]]
    adjoint = np.einsum("nk,kij->nij", given[:, 0], _BASIS)
    inverse = _series(adjoint)
    if given.shape[1] > 1:
        values.append(se3.times(inverse, given[:, 1]))
    if given.shape[1] > 2:
        # f([[A, A'], [0, A]]) holds the derivative of f(A) in its corner.
        change = np.einsum("nk,kij->nij", values[1], _BASIS)
        both = np.block([[adjoint, change], [np.zeros_like(adjoint), adjoint]])
        turning = _series(both)[:, :6, 6:]
        values.append(se3.times(turning, given[:, 1]) + se3.times(inverse, given[:, 2]))
    return np.stack(values, axis=1)


def _series(adjoint: NDArray[Any]) -> NDArray[Any]:
    """Return J_r^-1 of ad(g), by Horner's rule."""
    total = np.zeros_like(adjoint)
    for coefficient in reversed(_COEFFICIENTS):
        total = total @ adjoint + coefficient * np.eye(adjoint.shape[-1])
    return total
