"""A test of covariances without groundtruth: information on yaw that no sensor gives.

Without a magnetometer, GNSS or a map, yaw is not observable. Its standard deviation then never
falls below that of the prior. It falls in estimators that linearise again at every update, without
first-estimate Jacobians. Live and offline evaluation share this code.
"""

from __future__ import annotations

import math

import numpy as np

from trajeval_ros.formatting.remarks import Remark, warning
from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS

# Smallest standard deviation over that of the first message. OpenVINS: 0.45 to 0.89 with
# first-estimate Jacobians, 0.06 to 0.08 without.
_LEAST_OF_FIRST, _LEAST_AFTER_UPDATES = 0.2, 0.1
# Over the largest one before, after the start of this duration. OpenVINS: 0.92 to 1 and 0.51 to
# 0.77. At the start, the initialisation explains a fall.
_LEAST_OF_LARGEST, _START_NS = 0.85, 20 * NANOSECONDS
_SHORTEST_NS = 30 * NANOSECONDS
# A fall to this multiple from one message to the next is a loop closure or a reset. Without
# first-estimate Jacobians, it is at least 0.98.
_SUDDEN = 0.95
# Least share of the largest variance of all axes. Yaw is the least certain rotation of every
# estimator that does not observe it, and other axes, such as the body's, have a smaller variance.
_SHARE = 0.9


class YawInformation:
    """Compares the standard deviations of yaw, at a constant cost per message."""

    def __init__(self) -> None:
        self._first_ns: int | None = None
        self._newest_ns = 0
        self._first = self._smallest = self._previous = self._largest = 0.0  # rad
        self._fall = 1.0, 0.0, 0.0  # the largest one after the start: ratio, from, to
        self._has_updates = False

    def add(self, stamps: Stamps, covariances: Floats, up: Floats) -> None:
        """Take N messages in order: stamps (N,), ns, and rotation covariances (N, 3, 3), rad^2.

        They are about the axes of a frame with the vertical axis `up` (3,).
        """
        rows = _are_spatial(covariances)
        stamps, covariances = stamps[rows], covariances[rows]
        if not len(stamps):
            return
        variances = np.einsum("i,nij,j->n", up, covariances, up)
        if self._first_ns is None:
            self._first_ns = int(stamps[0])
            self._first = self._smallest = math.sqrt(float(variances[0]))
        self._newest_ns = int(stamps[-1])
        is_yaw = variances >= _SHARE * np.linalg.eigvalsh(covariances)[:, -1]
        sigmas = np.sqrt(variances[is_yaw])
        self._smallest = float(sigmas.min(initial=self._smallest))
        self._add_later(sigmas[stamps[is_yaw] >= self._first_ns + _START_NS])

    def _add_later(self, sigmas: Floats) -> None:
        """Take standard deviations after the start."""
        if not len(sigmas):
            return
        before = np.concatenate([[self._previous or sigmas[0]], sigmas[:-1]])
        updates = np.flatnonzero(sigmas < _SUDDEN * before)
        self._has_updates |= len(updates) > 0
        for number, part in enumerate(np.split(sigmas, updates)):
            if not len(part):
                continue
            largest = np.maximum.accumulate(part)
            if not number:
                largest = np.maximum(largest, self._largest)
            row = int(np.argmin(part / largest))
            fall = float(part[row] / largest[row]), float(largest[row]), float(part[row])
            self._fall = min(self._fall, fall)
            self._largest = float(largest[-1])
        self._previous = float(sigmas[-1])

    @property
    def remark(self) -> Remark | None:
        """The warning about information that no sensor gives; None without it."""
        if self._first_ns is None or self._newest_ns - self._first_ns < _SHORTEST_NS:
            return None
        ratio, largest, smallest = self._fall
        least = _LEAST_AFTER_UPDATES if self._has_updates else _LEAST_OF_FIRST
        if self._smallest < least * self._first:
            largest, smallest = self._first, self._smallest
        elif self._has_updates or ratio >= _LEAST_OF_LARGEST:
            return None
        return warning(
            "yaw_information",
            f"the standard deviation of yaw falls from {math.degrees(largest):.3g} to "
            f"{math.degrees(smallest):.3g} deg, although yaw cannot be observed: the covariance "
            "claims information that the sensors do not give (inconsistent linearisation); use "
            "first-estimate Jacobians, unless a magnetometer, GNSS or a map measures yaw",
            "covariance",
        )


def _are_spatial(covariances: Floats) -> Booleans:
    """Return which covariances (N, 3, 3) are known for all axes, as those in a plane are not."""
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    are_known: Booleans = np.logical_and.reduce(
        [np.isfinite(covariances).all(axis=(1, 2)), (variances > 0.0).all(axis=1)]
    )
    return are_known
