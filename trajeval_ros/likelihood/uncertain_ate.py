"""The position ATE against groundtruth that is known better here than there.

Inside a dropout the groundtruth's mean is off by more than a good estimate is. A plain rmse then
measures the groundtruth. Two rmses don't: of all poses, weighted by what is known of them, and of
the well-supported ones alone, with the share that they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.continuous_time.samples import Samples
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.likelihood.ate_interval import ate_interval
from trajeval_ros.metrics.weighted_alignment import weighted_errors

# A pose is well supported where its groundtruth is better known than half of the error, or about
# as well as a sample is.
_SHARE_OF_ERROR, _SAMPLE_SIGMAS = 0.5, 1.5 * 3.0**0.5


@dataclass(frozen=True, eq=False)
class UncertainAte:
    """Position errors, metres, of N poses.

    Attributes:
        weighted_m: Root of the mean square, each weighted by its information.
        supported_m: Of the well-supported poses; None where there is none.
        supported: (N,), which they are.
        interval_m: Of the ATE that exact groundtruth would give, on the safe side of 95 %: see
            `ate_interval`. None where too few poses are well supported.
    """

    weighted_m: float
    supported_m: float | None
    supported: Booleans
    interval_m: tuple[float, float] | None

    @property
    def supported_share(self) -> float:
        """Share of the poses that are well supported."""
        return float(np.mean(self.supported))


def uncertain_ate(
    times: Floats,
    groundtruth: Floats,
    covariances: Floats,
    estimate: Floats,
    gauge: Gauge | None,
    samples: Samples,
) -> UncertainAte:
    """Return the ATE against uncertain groundtruth.

    Args:
        times: (N,), seconds.
        groundtruth: (N, 3), metres, the most likely positions.
        covariances: (N, 3, 3), about the world's axes.
        estimate: (N, 3), metres.
        gauge: To align it by, weighted; None if it is aligned already.
        samples: Of the groundtruth.

    Raises:
        DegenerateGeometryError: Too few poses, or no motion, for the gauge's alignment.
    """
    errors, weighted = weighted_errors(gauge, groundtruth, estimate, covariances)
    variances = np.trace(covariances, axis1=1, axis2=2)
    sigma_m = samples.noise.position_m
    supported = np.sqrt(variances) < max(_SHARE_OF_ERROR * weighted, _SAMPLE_SIGMAS * sigma_m)
    if np.count_nonzero(supported) < 2:
        return UncertainAte(weighted, None, supported, None)
    rmse = float(np.sqrt(np.square(errors[supported]).sum(axis=1).mean()))
    order = np.argsort(times, kind="stable")
    interval = ate_interval(
        times[order],
        errors[order],
        variances[order],
        supported[order],
        sigma_m,
        samples.usual_step_s,
    )
    return UncertainAte(weighted, rmse, supported, interval)
