"""Detection of covariances that an estimator does not compute."""

from __future__ import annotations

from trajeval_ros.geometry.arrays import Floats

_FEWEST_CONSTANT = 10  # equal covariances


def constant_covariances(covariances: Floats) -> str:
    """Return that covariances (N, 6, 6) are constant, so no estimates; empty if they vary.

    The first pose can have another one.
    """
    if len(covariances) <= _FEWEST_CONSTANT or (covariances[1:] != covariances[1]).any():
        return ""
    variances = covariances[1].diagonal()
    return (
        f"all are equal ({variances[:3].mean():.3g} m^2, {variances[3:].mean():.3g} rad^2): a "
        "constant that the estimator publishes as a placeholder"
    )
