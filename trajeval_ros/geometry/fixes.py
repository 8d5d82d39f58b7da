"""GNSS fixes of a receiver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats, Indices, Stamps, at_rows
from trajeval_ros.geometry.geodesy import Datum, east_north_up, rotated_covariances

# sensor_msgs/NavSatStatus and the covariance types of sensor_msgs/NavSatFix.
STATUS_UNKNOWN, STATUS_NO_FIX = -2, -1
COVARIANCE_UNKNOWN, COVARIANCE_APPROXIMATED = 0, 1
_COVARIANCE_TYPES = {1: "approximated", 2: "diagonal", 3: "known"}


@dataclass(frozen=True, eq=False)
class Fixes:
    """The fixes of a receiver, as in its messages."""

    # (N, 3), latitude and longitude in degrees (WGS 84), height above the ellipsoid in metres; NaN
    # for a fix without height.
    places: Floats
    # (N,), of sensor_msgs/NavSatStatus: -2 unknown, -1 none, 0 fix, 1 with satellite and 2 with
    # ground-based augmentation.
    status: Indices
    # (N,), of sensor_msgs/NavSatFix: 0 unknown, 1 approximated, 2 diagonal known, 3 known.
    covariance_types: Indices
    covariances: Floats  # (N, 3, 3), m^2, about east, north and up at the fix
    datum: Datum | None = None  # origin of the east-north-up frame; None before one is chosen
    # Timestamps (M,) and fixes of the same receiver without height, which are not among these:
    # only gauge planar can use them. None if there are none.
    flat: tuple[Stamps, Fixes] | None = None

    def __len__(self) -> int:
        return len(self.places)

    def __getitem__(self, rows: slice | Indices | Booleans) -> Fixes:
        return at_rows(self, ("places", "status", "covariance_types", "covariances"), rows)

    @property
    def have_heights(self) -> bool:
        """Whether a fix has a height; without heights fixes are used in the plane."""
        return bool(np.isfinite(self.places[:, 2]).any())

    @property
    def known(self) -> Booleans:
        """Which fixes have a covariance, (N,): type not unknown, finite, diagonal positive."""
        variances = np.diagonal(self.covariances, axis1=1, axis2=2)
        level = np.isfinite(self.covariances).all(axis=(1, 2)) & (variances > 0.0).all(axis=1)
        known: Booleans = level & (self.covariance_types != COVARIANCE_UNKNOWN)
        return known

    @property
    def sigma_level_m(self) -> Floats:
        """Standard deviation along the worst horizontal axis, (N,), metres; NaN if unknown."""
        known = self.known
        sigma = np.full(len(self), np.nan)
        level = self.covariances[known][:, :2, :2]
        sigma[known] = np.sqrt(np.linalg.eigvalsh(level)[:, -1])
        return sigma

    @property
    def sigma_up_m(self) -> Floats:
        """Standard deviation of the height, (N,), metres; NaN if unknown."""
        known = self.known
        sigma = np.full(len(self), np.nan)
        sigma[known] = np.sqrt(self.covariances[known, 2, 2])
        return sigma

    def positions(self, *, level: bool = False) -> Floats:
        """Return positions in the datum's frame, (N, 3), metres.

        `level`: use the datum's height for a fix without height; else all fixes have heights.
        """
        assert self.datum is not None
        places = self.places
        if level:
            places = places.copy()
            places[np.isnan(places[:, 2]), 2] = self.datum.height_m
        return east_north_up(places, self.datum)

    def pose_covariances(self) -> Floats:
        """Return pose covariances (N, 6, 6) in the datum's frame; NaN if unknown."""
        assert self.datum is not None
        known = self.known
        covariances = np.full((len(self), 6, 6), np.nan)
        covariances[known, :3, :3] = rotated_covariances(
            self.covariances[known], self.places[known], self.datum
        )
        return covariances


def quality_of(fixes: Fixes) -> str:
    """Summarise status and covariances: "989 of status 1; standard deviation ..."."""
    counts = zip(*np.unique(fixes.status, return_counts=True), strict=True)
    statuses = ", ".join(f"{count} of status {status}" for status, count in counts)
    known = fixes.known
    if not known.any():
        return f"{statuses}; covariance unknown"
    level, up = fixes.sigma_level_m[known], fixes.sigma_up_m[known]
    kinds = np.unique(fixes.covariance_types[known]).tolist()
    names = " and ".join(_COVARIANCE_TYPES.get(kind, f"type {kind}") for kind in kinds)
    some = "" if known.all() else f" of {np.count_nonzero(known)} of them"
    return (
        f"{statuses}; standard deviation{some} {level.min():.3g} to {level.max():.3g} m "
        f"horizontal, {up.min():.3g} to {up.max():.3g} m vertical, covariance {names}"
    )
