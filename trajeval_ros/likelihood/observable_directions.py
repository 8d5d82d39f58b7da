"""Scores in nested gauges: the contribution of scale and tilt.

The density in a smaller gauge is that in a larger one under a condition (Savage and Dickey):

    log L_se3 = log L_sim3 + log p(log scale = 0 | data)
    log L_yaw = log L_se3 + log p(tilt = 0 | data)
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import DegenerateGeometryError
from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.likelihood.alignment_chart import scales
from trajeval_ros.likelihood.marginal import AbsoluteErrorDensity, generalised_absolute_error
from trajeval_ros.likelihood.relative_density import LOG_2_PI
from trajeval_ros.likelihood.residuals import Residuals


@dataclass(frozen=True)
class Condition:
    """Agreement of a larger gauge's alignment with a smaller gauge."""

    values: tuple[float, ...]  # (k,), of the alignment: log scale, or rotation about x and y, rad
    sigmas: tuple[float, ...]  # (k,), their standard deviations
    log_density: float  # log density at zero, nats

    @property
    def z(self) -> tuple[float, ...]:
        """The values in standard deviations."""
        return tuple(v / s for v, s in zip(self.values, self.sigmas, strict=True))


@dataclass(frozen=True)
class GaugeScores:
    """Scores of one estimate in three gauges."""

    sim3: float | None  # log likelihood of the shape, nats; None without a scale
    se3: float  # with the scale
    yaw: float  # with scale and tilt
    scale: Condition | None  # the condition between `sim3` and `se3`; None with `sim3`
    tilt: Condition  # the condition between `se3` and `yaw`
    why_no_sim3: str = ""  # reason if `sim3` is None


def gauge_scores(residuals: Residuals) -> GaugeScores:
    """Return the scores of an estimate in all gauges, independent of its own."""
    se3 = generalised_absolute_error(dataclasses.replace(residuals, gauge=Gauge.SE3))
    yaw = generalised_absolute_error(dataclasses.replace(residuals, gauge=Gauge.YAW))
    try:
        sim3 = generalised_absolute_error(dataclasses.replace(residuals, gauge=Gauge.SIM3))
        why_no_sim3 = ""
    except DegenerateGeometryError as error:
        sim3, why_no_sim3 = None, str(error)
    return GaugeScores(
        None if sim3 is None else sim3.log_likelihood,
        se3.log_likelihood,
        yaw.log_likelihood,
        None if sim3 is None else _scale_of(sim3),
        _tilt_of(se3),
        why_no_sim3,
    )


def _scale_of(error: AbsoluteErrorDensity) -> Condition:
    """Return the condition of the log scale."""
    value = np.log(scales(error.mode.element))
    return _condition(np.array([value]), error.covariance[-1:, -1:])


def _tilt_of(error: AbsoluteErrorDensity) -> Condition:
    """Return the condition of the tilt: the horizontal rotation vector after removing yaw."""
    rotation = error.mode.element[:3, :3]
    yaw = np.array([0.0, 0.0, so3.yaw_of_matrix(rotation)])
    tilt = so3.log(rotation @ so3.exp(-yaw))[:2]
    return _condition(tilt, error.covariance[3:5, 3:5])


def _condition(values: Floats, covariance: Floats) -> Condition:
    """Return a condition from values (k,) and their covariance (k, k)."""
    squared = float(values @ np.linalg.solve(covariance, values))
    determinant = float(np.linalg.slogdet(covariance)[1])
    return Condition(
        tuple(values.tolist()),
        tuple(np.sqrt(np.diag(covariance)).tolist()),
        -0.5 * (squared + determinant + len(values) * LOG_2_PI),
    )
