"""The position ATE against groundtruth of varying accuracy.

Inside a dropout, the error of the groundtruth's mean is larger than that of a good estimate, and a
plain RMSE measures the groundtruth. Two alternatives are the RMSE of all poses, weighted by their
information, and the RMSE of the well-supported poses, with their share.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.continuous_time.samples import Samples
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.likelihood.ate_interval import ate_interval
from trajeval_ros.metrics.weighted_alignment import weighted_errors

# A pose is well supported if the groundtruth's standard deviation is below this share of the
# error, or below this multiple of a sample's.
_SHARE_OF_ERROR, _SAMPLE_SIGMAS = 0.5, 1.5 * 3.0**0.5


@dataclass(frozen=True, eq=False)
class UncertainAte:
    """Position ATE of N poses, metres.

    Attributes:
        weighted_m: RMSE weighted by the information of the poses.
        supported_m: RMSE of the well-supported poses; None if there are none.
        supported: (N,), which poses are well supported.
        interval_m: Interval of the ATE against exact groundtruth with a coverage of at least 95 %:
            see `ate_interval`. None if too few poses are well supported.
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
        covariances: (N, 3, 3), m^2, about the world's axes.
        estimate: (N, 3), metres.
        gauge: Gauge of a weighted alignment; None if the estimate is aligned already.
        samples: Samples of the groundtruth.

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
