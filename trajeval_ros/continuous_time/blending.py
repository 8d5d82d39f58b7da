"""Continuous transition between two beliefs about a pose."""

from __future__ import annotations

from trajeval_ros.continuous_time.samples import Belief
from trajeval_ros.geometry import se3
from trajeval_ros.geometry.arrays import Floats


def blended(first: Belief, second: Belief, weight: Floats) -> Belief:
    """Return the moments of the mixture of two beliefs at Q times.

    The difference between the two is a part of the covariance. An average of precisions instead
    would be overconfident where they disagree.

    Args:
        first: Q poses.
        second: Q poses.
        weight: (Q,) of the second, in [0, 1].
    """
    w = weight[:, None]
    apart = se3.log(se3.inverse(first.poses) @ second.poses)
    poses = first.poses @ se3.exp(w * apart)

    def seen(belief: Belief, offset: Floats) -> Floats:
        carried = se3.inverse_left_jacobian(-offset)
        spread = offset[:, :, None] * offset[:, None, :]
        return se3.congruent(carried, belief.covariances) + spread

    covariances = (1.0 - w)[..., None] * seen(first, -w * apart)
    covariances += w[..., None] * seen(second, (1.0 - w) * apart)
    return Belief(poses, covariances)
