"""Equations (12), (13), (16), (17) and (21) to (28) of the probabilistic paper, to compare with.

The generalised absolute error to first order, and relative poses of stochastic groundtruth.

Residuals are linear in that of the first pose, so the integral over the alignment is a product of
Gaussians. The result is the generalised relative error, eq. (29), exactly and for errors of any
size: (eps_1, e) -> eps is linear with determinant 1. Three indices of the paper are put right: T_1
in (21), eps_1 in the display before (23), and the sign of the last term of (25).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.continuous_time.samples import Belief
from trajeval_ros.geometry import se3
from trajeval_ros.likelihood.relative_density import (
    LOG_2_PI,
    RelativeErrorDensity,
    decomposed,
    relative_poses,
    transports,
)

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FirstOrderAbsoluteError:
    """S_AE, and the Gaussian over alignments that it was taken from.

    Attributes:
        log_likelihood: Logarithm of S_AE, eq. (28), nats.
        mean: mu_s (6,), in the frame that was chosen.
        information: V_s^-1 (6, 6).
    """

    log_likelihood: float
    mean: Array
    information: Array


def relative_errors(poses: Array, estimate: Array) -> Array:
    """Return e_i (M - 1, 6) of groundtruth and estimated poses (M, 4, 4): eq. (16)."""
    return se3.log(se3.inverse(relative_poses(poses)) @ relative_poses(estimate))


def generalised_relative_error(belief: Belief, estimate: Array) -> RelativeErrorDensity:
    """Return P_RE of M poses, eq. (17), to the letter."""
    return decomposed(belief, relative_errors(belief.poses, estimate))


def first_residual(first: Array, gauge_twist: Array) -> Array:
    """Return eps_1 = Ad(T_1)^-1 xi_g (6,), eq. (21), where the estimate begins at T_1 (4, 4)."""
    return se3.times(se3.adjoint(se3.inverse(first)), gauge_twist)


def log_volume(first: Array) -> float:
    """Return log |d eps_1 / d xi_g|, eq. (22): 0, since adjoints have determinant 1."""
    return float(np.linalg.slogdet(se3.adjoint(se3.inverse(first)))[1])


def first_order_residuals(poses: Array, errors: Array, first: Array) -> Array:
    """Return eps_h (M, 6), eq. (23), linear in eps_1 and in relative errors.

    Args:
        poses: Of the groundtruth, (M, 4, 4).
        errors: e of eq. (16), (M - 1, 6).
        first: eps_1, (6,).
    """
    to_first = se3.adjoint(se3.inverse(poses[0]) @ poses)
    moved = first - gauge_means(poses, errors, poses[0])
    return np.asarray(np.linalg.solve(to_first, moved[..., None])[..., 0])


def log_density_in_gauge(means: Array, covariances: Array, twist: Array) -> Array:
    """Return log N(eps_h; 0, S_h) (M,) as Gaussians of one twist: the right side of eq. (24).

    Args:
        means: mu_h, (M, 6).
        covariances: V_h, (M, 6, 6).
        twist: eps_1, or that of another frame, (6,).
    """
    apart = twist - means
    squared = np.sum(apart * np.linalg.solve(covariances, apart[..., None])[..., 0], axis=1)
    density: Array = -0.5 * (squared + np.linalg.slogdet(covariances)[1]) - 3.0 * LOG_2_PI
    return density


def gauge_means(poses: Array, errors: Array, frame: Array) -> Array:
    """Return mu_h (M, 6), eq. (25), in a frame (4, 4); the paper's is the first pose.

    Args:
        poses: Of the groundtruth, (M, 4, 4).
        errors: e of eq. (16), (M - 1, 6).
        frame: Where the alignment's twist is.
    """
    carried = se3.times(se3.adjoint(se3.inverse(frame) @ poses[1:]), errors)
    return np.concatenate([np.zeros((1, 6)), -np.cumsum(carried, axis=0)])


def gauge_covariances(poses: Array, covariances: Array, frame: Array) -> Array:
    """Return V_h (M, 6, 6), eq. (26), in a frame (4, 4); the paper's is the first pose."""
    return se3.congruent(se3.adjoint(se3.inverse(frame) @ poses), covariances)


def gauge_informations(poses: Array, covariances: Array, frame: Array) -> Array:
    """Return V_h^-1 (M, 6, 6) without inverting V_h, whose lever arms cost digits."""
    back = se3.adjoint(se3.inverse(poses) @ frame)
    return se3.congruent(se3.transposed(back), np.asarray(np.linalg.inv(covariances)))


def centred(poses: Array) -> Array:
    """Return the frame (4, 4) in the middle of the poses' positions, with the world's axes."""
    return se3.poses(np.eye(3), poses[:, :3, 3].mean(axis=0))


def first_order_absolute_error(
    belief: Belief, estimate: Array, frame: Array | None = None
) -> FirstOrderAbsoluteError:
    """Return the first order of the absolute error, the integral over the alignment: eq. (27).

    Args:
        belief: M groundtruth poses, independent of each other.
        estimate: (M, 4, 4).
        frame: (4, 4), of the alignment's twist. The value doesn't depend on it; its digits do,
            and are best in the middle of the trajectory, the default.
    """
    poses, covariances = belief.poses, belief.covariances
    frame = centred(poses) if frame is None else frame
    return gaussian_product(
        gauge_means(poses, relative_errors(poses, estimate), frame),
        gauge_informations(poses, covariances, frame),
        float(np.linalg.slogdet(covariances)[1].sum()),
    )


def gaussian_product(
    means: Array, informations: Array, log_determinants: float
) -> FirstOrderAbsoluteError:
    """Return the scale S_AE of a product of Gaussians, and the Gaussian that it scales: eq. (28).

    Args:
        means: mu_h, (M, 6).
        informations: V_h^-1, (M, 6, 6).
        log_determinants: Sum of log |V_h|, which is that of log |S_h|.
    """
    total = informations.sum(axis=0)
    mean = np.linalg.solve(total, se3.times(informations, means).sum(axis=0))
    # About the common mean nothing large cancels.
    apart = means - mean
    squared = float(np.vdot(apart, se3.times(informations, apart)))
    determinants = log_determinants + float(np.linalg.slogdet(total)[1])
    value = -0.5 * (squared + determinants) - 3.0 * (len(means) - 1) * LOG_2_PI
    return FirstOrderAbsoluteError(value, mean, total)


def perturbed_steps(poses: Array, perturbations: Array) -> Array:
    """Return the relative poses of stochastic groundtruth: eq. (12), with its adjoint put right.

    Args:
        poses: (M, 4, 4).
        perturbations: xi_i, (M, 6).
    """
    steps: Array = relative_poses(poses) @ se3.exp(step_perturbations(poses, perturbations))
    return steps


def step_perturbations(poses: Array, perturbations: Array) -> Array:
    """Return xi_{i,i+1} (M - 1, 6), exactly: eq. (13); arguments as of `perturbed_steps`."""
    carried = se3.times(transports(poses), perturbations[:-1])
    return se3.log(se3.exp(-carried) @ se3.exp(perturbations[1:]))
