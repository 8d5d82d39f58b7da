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

from trajeval_ros.consistency.consistency_result import Consistency
from trajeval_ros.consistency.covariance_request import IntegrityRequest
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS


@dataclass(frozen=True)
class TimeToAlert:
    """Times from the start of episodes with errors beyond the alert limit to an alert."""

    # Times of the episodes with an alert; negative if the alert came first.
    seconds: tuple[float, ...]
    missed: int  # number of episodes without an alert

    @property
    def median(self) -> float | None:
        """Median time of the episodes with an alert; None if there is none."""
        return float(np.median(self.seconds)) if self.seconds else None

    @property
    def worst(self) -> float | None:
        """Longest time of the episodes with an alert; None if there is none."""
        return max(self.seconds, default=None)


def times_to_alert(
    stamps: Stamps,
    errors: Floats,
    levels: Floats,
    limit: float,
    warnings: Sequence[tuple[int, int]] = (),
) -> TimeToAlert:
    """Return the times from the starts of errors (N,) beyond a limit to the alerts.

    An alert is a protection level (N,) beyond the limit, or another warning, which has a first and
    a last timestamp. An alert that is active when the errors start counts from its own start.
    """
    alerts = np.array([*_spans(stamps, levels > limit), *warnings], np.int64).reshape(-1, 2)
    seconds = []
    missed = 0
    for begin, end in _spans(stamps, errors > limit):
        during = (alerts[:, 0] <= end) & (alerts[:, 1] >= begin)
        if during.any():
            seconds.append(int(alerts[during, 0].min() - begin) / NANOSECONDS)
        else:
            missed += 1
    return TimeToAlert(tuple(seconds), missed)


def _spans(stamps: Stamps, holds: Booleans) -> list[tuple[int, int]]:
    """Return the first and the last timestamp of every uninterrupted period."""
    edges = np.diff(holds.astype(np.int8), prepend=0, append=0)
    begins, ends = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1
    return list(zip(stamps[begins].tolist(), stamps[ends].tolist(), strict=True))


AREAS = ("nominal", "unavailable", "misleading", "hazardous", "misleading_unavailable")
_CONFIDENCE = 0.95
_INFLATION_SHARE = 0.999
# Rows and columns of errors and covariances.
_PARTS = {"horizontal": slice(0, 2), "vertical": slice(2, 3), "heading": slice(5, 6)}


@dataclass(frozen=True, eq=False)
class PartIntegrity:
    """Integrity of one part of the pose."""

    part: str  # `horizontal`, `vertical` or `heading`
    unit: str  # unit of errors, levels and limit: m or deg
    alert_limit: float  # largest acceptable error
    errors: Floats  # (N,), magnitudes
    levels: Floats  # (N,), protection levels
    areas: dict[str, float]  # share of the poses in every area of `AREAS`; the sum is 1
    episodes: dict[str, int]  # number of times that consecutive poses entered an area
    availability: float  # share of poses with a level within the limit
    bounded: float  # share of poses with an error within the level
    # Effective number of independent poses, since successive errors are correlated.
    effective: float
    # 95 % interval of the hazardous share for the effective number
    hazardous_95: tuple[float, float]
    inflation: float  # factor of the levels for which they bound 99.9 % of the errors
    time_to_alert: TimeToAlert  # times from errors beyond the limit to an alert


@dataclass(frozen=True, eq=False)
class Integrity:
    """Protection levels of an estimate, and whether its errors exceed them."""

    risk: float  # risk of the protection levels
    # As in `Consistency`. With `bound`, levels are upper bounds: misleading poses are confirmed,
    # others are not.
    exactness: str
    parts: tuple[PartIntegrity, ...]  # horizontal, vertical, and heading if requested


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

    Warnings, which have a first and a last timestamp, count as alerts, too.
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
        selected = consistency.errors[judged, rows]
        levels = protection_levels(consistency.covariances[judged, rows, rows], request.risk)
        if not levels.any():  # of an estimate in a plane
            continue
        errors, levels = factor * np.linalg.norm(selected, axis=1), factor * levels
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
