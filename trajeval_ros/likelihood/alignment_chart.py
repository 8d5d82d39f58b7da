"""Elements of a gauge's group as matrices, and coordinates around an element.

An element is [[s R, t], [0, 1]] (4, 4): p -> s R p + t, R_i -> R R_i. The chart perturbs on the
left about a fixed centre c: p -> c + e^lam Exp(phi)(p - c) + tau, delta = (tau, phi, lam). The
right Haar measure, which is invariant to changes of the estimate's frame, has density 1 at 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry import se3, so3
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.gauge import Gauge


def scales(elements: Floats) -> Floats:
    """Return the scales (...) of elements (..., 4, 4)."""
    return np.asarray(np.linalg.norm(elements[..., 0, :3], axis=-1))


def act(elements: Floats, poses: Floats) -> Floats:
    """Return poses transformed by elements, arrays (..., 4, 4) that broadcast."""
    moved = elements @ poses
    moved[..., :3, :3] /= scales(elements)[..., None, None]
    return moved


@dataclass(frozen=True, eq=False)
class Chart:
    """Coordinates delta of a gauge's elements."""

    gauge: Gauge  # determines which of tau, phi and lam exist; for `yaw`, phi is about z only
    centre: Floats  # c, (3,), metres: the groundtruth's centre, for numerical precision

    def __post_init__(self) -> None:
        if self.gauge is Gauge.PLANAR:
            raise SettingsError("gauge planar is not supported for likelihoods; use yaw")

    @property
    def axes(self) -> Floats:
        """The axes (0, 1 or 3, 3) of phi."""
        if self.gauge.has_so3:
            return np.eye(3)
        return np.eye(3)[2:] if self.gauge.yaw_only else np.zeros((0, 3))

    @property
    def turns(self) -> slice:
        """Indices of phi in delta."""
        start = 3 if self.gauge.has_translation else 0
        return slice(start, start + len(self.axes))

    @property
    def dimension(self) -> int:
        """Length of delta: 0, 3, 4, 6 or 7."""
        return int(self.turns.stop) + int(self.gauge.has_scale)

    def elements(self, deltas: Floats) -> Floats:
        """Return the elements (K, 4, 4) at coordinates (K, d)."""
        count = len(deltas)
        linear = so3.exp(deltas[:, self.turns] @ self.axes)
        if self.gauge.has_scale:
            linear = np.exp(deltas[:, -1])[:, None, None] * linear
        shift = deltas[:, :3] if self.gauge.has_translation else np.zeros((count, 3))
        return se3.poses(linear, self.centre + shift - linear @ self.centre)

    def twists(self, positions: Floats) -> Floats:
        """Return the derivatives of poses at positions (M, 3) by delta, left twists (M, 6, d)."""
        moves = np.zeros((len(positions), 6, self.dimension))
        if self.gauge.has_translation:
            moves[:, :3, :3] = np.eye(3)
        moves[:, :3, self.turns] = so3.skew(self.centre) @ self.axes.T
        moves[:, 3:, self.turns] = self.axes.T
        if self.gauge.has_scale:
            moves[:, :3, -1] = positions - self.centre
        return moves

    def log_measure(self, deltas: Floats) -> Floats:
        """Return the logarithm (K,) of the right Haar measure's density at (K, d).

        It is uniform in yaw, translation and log scale, but not in rotation vectors of SO(3).
        """
        if not self.gauge.has_so3:
            return np.zeros(len(deltas))
        return se3.log_determinant(deltas[:, self.turns])

    def within(self, deltas: Floats) -> Booleans:
        """Return which coordinates (K, d) rotate by at most pi, where rotations are unique."""
        angles = np.linalg.norm(deltas[:, self.turns], axis=1)
        inside: Booleans = angles <= np.pi
        return inside
