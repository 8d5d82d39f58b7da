"""Protection levels from covariances, and whether errors exceed them.

A protection level is exceeded by errors of the stated covariance with a given probability, the
risk. With an alert limit, the largest acceptable error, every pose is in one of five areas of the
Stanford diagram (Tossaint et al., "The Stanford - ESA integrity diagram", 2007).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import beta, chi2

from trajeval_ros.consistency.result import Consistency
from trajeval_ros.consistency.time_to_alert import TimeToAlert, times_to_alert
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps

DEFAULT_RISK = 1e-5
AREAS = ("nominal", "unavailable", "misleading", "hazardous", "misleading_unavailable")
_CONFIDENCE = 0.95
_INFLATION_SHARE = 0.999
# Rows and columns of errors and covariances.
_PARTS = {"horizontal": slice(0, 2), "vertical": slice(2, 3), "heading": slice(5, 6)}


@dataclass(frozen=True)
class IntegrityRequest:
    """Largest acceptable errors, and the probability of larger ones without an alert.

    Attributes:
        alert_limit_m: Limit of horizontal and of vertical errors, metres.
        alert_limit_deg: Limit of the heading error, degrees; None for none.
        risk: Probability that an error exceeds its protection level.

    Raises:
        SettingsError: A limit is not positive, or the risk is no probability.
    """

    alert_limit_m: float
    alert_limit_deg: float | None = None
    risk: float = DEFAULT_RISK

    def __post_init__(self) -> None:
        """Refuse limits that are not positive, and risks that are no probability."""
        limits = [self.alert_limit_m]
        limits += [] if self.alert_limit_deg is None else [self.alert_limit_deg]
        if not all(0.0 < limit < math.inf for limit in limits):
            raise SettingsError(
                "the alert limit must be greater than zero, in metres and, for the heading, in "
                "degrees, as in --alert-limit 0.5,2"
            )
        if not 0.0 < self.risk < 1.0:
            raise SettingsError(f"the risk must be a probability such as 1e-5, not {self.risk:g}")


@dataclass(frozen=True, eq=False)
class PartIntegrity:
    """Integrity of one part of the pose.

    Attributes:
        part: `horizontal`, `vertical` or `heading`.
        unit: Unit of errors, levels and limit: m or deg.
        alert_limit: Largest acceptable error.
        errors: (N,), magnitudes.
        levels: (N,), protection levels.
        areas: Share of the poses in every area of `AREAS`; the sum is 1.
        episodes: Number of times that consecutive poses entered an area.
        availability: Share of poses with a level within the limit.
        bounded: Share of poses with an error within the level.
        effective: Effective number of independent poses, since successive errors are correlated.
        hazardous_95: 95 % interval of the hazardous share for the effective number.
        inflation: Factor of the levels for which they bound 99.9 % of the errors.
        time_to_alert: Times from errors beyond the limit to an alert.
    """

    part: str
    unit: str
    alert_limit: float
    errors: Floats
    levels: Floats
    areas: dict[str, float]
    episodes: dict[str, int]
    availability: float
    bounded: float
    effective: float
    hazardous_95: tuple[float, float]
    inflation: float
    time_to_alert: TimeToAlert


@dataclass(frozen=True, eq=False)
class Integrity:
    """Protection levels of an estimate, and whether its errors exceed them.

    Attributes:
        risk: Risk of the protection levels.
        exactness: As in `Consistency`. With `bound`, levels are upper bounds: misleading poses are
            confirmed, others are not.
        parts: Horizontal, vertical, and heading if requested.
    """

    risk: float
    exactness: str
    parts: tuple[PartIntegrity, ...]


def protection_levels(covariances: Floats, risk: float) -> Floats:
    """Return the protection levels (N,) for covariances (N, d, d).

    The largest eigenvalue is used for all d directions. This is an upper bound of the exact
    quantile of the quadratic form, and exact for equal eigenvalues.
    """
    largest = np.linalg.eigvalsh(covariances)[:, -1]
    levels: Floats = np.sqrt(np.maximum(largest, 0.0) * chi2.isf(risk, covariances.shape[-1]))
    return levels


def integrity_of(
    consistency: Consistency,
    request: IntegrityRequest,
    stamps: Stamps,
    warnings: Sequence[tuple[int, int]] = (),
) -> Integrity:
    """Compare errors with protection levels, both in the gauge of the alignment.

    Args:
        consistency: Errors and their covariances, including groundtruth noise.
        request: Limits and risk.
        stamps: (N,) timestamps of the pairs, nanoseconds.
        warnings: First and last timestamps of other warnings, which count as alerts.

    Raises:
        InputError: There are no covariances of single poses.
    """
    if consistency.covariances is None or consistency.nees is None:
        raise InputError(
            "integrity needs the covariance of every pose, and the run is too long to compute "
            "them from the joint covariance; use --covariance message, or a shorter run"
        )
    # Without a pose that the alignment makes exact.
    judged = np.isfinite(consistency.nees)
    parts = []
    for name, rows in _PARTS.items():
        unit, limit = "m", request.alert_limit_m
        factor = 1.0
        if name == "heading":
            if request.alert_limit_deg is None:
                continue
            unit, limit, factor = "deg", request.alert_limit_deg, 180.0 / math.pi
        own = consistency.errors[judged, rows]
        levels = protection_levels(consistency.covariances[judged, rows, rows], request.risk)
        errors, levels = factor * np.linalg.norm(own, axis=1), factor * levels
        alerts = times_to_alert(stamps[judged], errors, levels, limit, warnings)
        parts.append(_part(name, unit, limit, errors, levels, alerts))
    return Integrity(request.risk, consistency.exactness, tuple(parts))


def _part(
    part: str, unit: str, limit: float, errors: Floats, levels: Floats, alerts: TimeToAlert
) -> PartIntegrity:
    """Return the statistics of errors (N,) and levels (N,) of one part."""
    bounded, available, bearable = errors <= levels, levels <= limit, errors <= limit
    areas: dict[str, Booleans] = {
        "nominal": bounded & available,
        "unavailable": bounded & ~available,
        "misleading": ~bounded & available & bearable,
        "hazardous": ~bounded & available & ~bearable,
        "misleading_unavailable": ~bounded & ~available,
    }
    ratio = errors / np.maximum(levels, np.finfo(float).tiny)
    effective = effective_number(ratio)
    hazardous = float(areas["hazardous"].mean())
    return PartIntegrity(
        part=part,
        unit=unit,
        alert_limit=limit,
        errors=errors,
        levels=levels,
        areas={name: float(mask.mean()) for name, mask in areas.items()},
        episodes={
            name: int(np.count_nonzero(np.diff(mask.astype(np.int8), prepend=0) > 0))
            for name, mask in areas.items()
        },
        availability=float(available.mean()),
        bounded=float(bounded.mean()),
        effective=effective,
        hazardous_95=share_interval(hazardous, effective),
        inflation=float(np.quantile(ratio, _INFLATION_SHARE)),
        time_to_alert=alerts,
    )


def effective_number(values: Floats) -> float:
    """Return the effective number of independent values of an autocorrelated series (N,).

    N / (1 + 2 sum of autocorrelations), summed up to the first that is not positive (Geyer's
    initial sequence).
    """
    count = len(values)
    centred = values - values.mean()
    energy = float(centred @ centred)
    if energy <= 0.0 or count < 2:
        return 1.0
    spectrum = np.abs(np.fft.rfft(centred, 2 * count)) ** 2
    correlation = np.fft.irfft(spectrum)[:count] / energy
    vanished = np.flatnonzero(correlation <= 0.0)
    positive = correlation[1 : vanished[0] if len(vanished) else count]
    return float(min(max(count / (1.0 + 2.0 * positive.sum()), 1.0), count))


def share_interval(share: float, effective: float) -> tuple[float, float]:
    """Return the 95 % interval of a share of independent poses (Clopper and Pearson)."""
    hits, tail = share * effective, 0.5 * (1.0 - _CONFIDENCE)
    low = 0.0 if hits <= 0.0 else float(beta.ppf(tail, hits, effective - hits + 1.0))
    high = 1.0 if share >= 1.0 else float(beta.isf(tail, hits + 1.0, effective - hits))
    return low, high
