"""GNSS fixes of a receiver, and the selection of usable ones.

The selection uses the receiver's own status and covariance only. It does not compare with an
estimate: a fix that disagrees can be right.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices, Stamps
from trajeval_ros.geometry.dropped_counts import add_counts
from trajeval_ros.geometry.geodesy import Datum, east_north_up, turned_covariances
from trajeval_ros.geometry.trajectory import Trajectory

# sensor_msgs/NavSatStatus and the covariance types of sensor_msgs/NavSatFix.
STATUS_UNKNOWN, STATUS_NO_FIX = -2, -1
COVARIANCE_UNKNOWN, COVARIANCE_APPROXIMATED = 0, 1
_COVARIANCE_TYPES = {1: "approximated", 2: "diagonal", 3: "known"}
FRAME = "east_north_up"
DEFAULT_CORRELATION_S = 100.0
# A datum farther away is a mistake, such as swapped coordinates.
_FARTHEST_M = 100_000.0


@dataclass(frozen=True, eq=False)
class Fixes:
    """The fixes of a receiver, as in its messages.

    Attributes:
        places: (N, 3), latitude and longitude in degrees (WGS 84), height above the ellipsoid in
            metres; NaN for a fix without height.
        status: (N,), of sensor_msgs/NavSatStatus: -2 unknown, -1 none, 0 fix, 1 with satellite
            and 2 with ground-based augmentation.
        covariance_types: (N,), of sensor_msgs/NavSatFix: 0 unknown, 1 approximated, 2 diagonal
            known, 3 known.
        covariances: (N, 3, 3), m^2, about east, north and up at the fix.
        datum: Origin of the east-north-up frame; None before one is chosen.
        flat: Timestamps (M,) and fixes of the same receiver without height, which are not among
            these: only gauge planar can use them. None if there are none.
    """

    places: Floats
    status: Indices
    covariance_types: Indices
    covariances: Floats
    datum: Datum | None = None
    flat: tuple[Stamps, Fixes] | None = None

    def __len__(self) -> int:
        """Return the number of fixes."""
        return len(self.places)

    def __getitem__(self, rows: slice | Indices | Booleans) -> Fixes:
        """Return the fixes of a slice, a mask or an array of indices."""
        return dataclasses.replace(
            self,
            places=self.places[rows],
            status=self.status[rows],
            covariance_types=self.covariance_types[rows],
            covariances=self.covariances[rows],
        )

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

        Args:
            level: Use the datum's height for a fix without height; else all fixes have heights.
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
        covariances[known, :3, :3] = turned_covariances(
            self.covariances[known], self.places[known], self.datum
        )
        return covariances


def quality_of(fixes: Fixes) -> str:
    """Summarise status and covariances: "989 of status 1; standard deviation ..."."""
    counts = zip(*np.unique(fixes.status, return_counts=True), strict=True)
    said = ", ".join(f"{count} of status {status}" for status, count in counts)
    known = fixes.known
    if not known.any():
        return f"{said}; covariance unknown"
    level, up = fixes.sigma_level_m[known], fixes.sigma_up_m[known]
    kinds = np.unique(fixes.covariance_types[known]).tolist()
    names = " and ".join(_COVARIANCE_TYPES.get(kind, f"type {kind}") for kind in kinds)
    some = "" if known.all() else f" of {np.count_nonzero(known)} of them"
    return (
        f"{said}; standard deviation{some} {level.min():.3g} to {level.max():.3g} m horizontal, "
        f"{up.min():.3g} to {up.max():.3g} m vertical, covariance {names}"
    )


@dataclass(frozen=True)
class FixRule:
    """The selection of fixes, their frame and their correlation time.

    Attributes:
        datum: Origin of the frame; None for the first usable fix.
        min_status: Least status of a usable fix; None for any fix.
        max_sigma_m: Largest standard deviation along a horizontal axis, metres; None for any.
        correlation_s: Time in which the correlation of fix errors decays to 1/e, seconds.

    Raises:
        SettingsError: A value is out of range.

    Example:
        >>> from trajeval_ros.geometry.fixes import FixRule
        >>> FixRule(max_sigma_m=0.05).correlation_s
        100.0
    """

    datum: Datum | None = None
    min_status: int | None = None
    max_sigma_m: float | None = None
    correlation_s: float = DEFAULT_CORRELATION_S

    def __post_init__(self) -> None:
        """Refuse values out of range."""
        if self.min_status is not None and self.min_status not in (0, 1, 2):
            raise SettingsError(
                "the minimum fix status must be 0 (any fix), 1 (satellite-based augmentation) "
                f"or 2 (ground-based, such as RTK), not {self.min_status}"
            )
        if self.max_sigma_m is not None and not 0.0 < self.max_sigma_m < np.inf:
            raise SettingsError(
                f"the largest sigma of a fix must be greater than 0 m, not {self.max_sigma_m}"
            )
        if not 0.0 < self.correlation_s < np.inf:
            raise SettingsError(
                "the correlation time of fix errors must be greater than 0 s, not "
                f"{self.correlation_s}; a typical value is 100 s"
            )

    def usable(self, fixes: Fixes, *, level: bool) -> tuple[Booleans, dict[str, int]]:
        """Return which fixes are usable, (N,), and how many are not, by reason.

        Args:
            fixes: N fixes.
            level: Whether fixes without height are usable, as for gauge planar.
        """
        kept = np.ones(len(fixes), dtype=bool)
        dropped: dict[str, int] = {}
        for reason, bad in self._faults(fixes, level=level):
            dropped[reason] = int(np.count_nonzero(kept & bad))
            kept &= ~bad
        return kept, dropped

    def _faults(self, fixes: Fixes, *, level: bool) -> list[tuple[str, Booleans]]:
        """Return the reasons for rejection, with the fixes (N,) that they apply to."""
        known, status, places = fixes.known, fixes.status, fixes.places
        horizontal = places[:, :2]
        finite = np.isfinite(horizontal).all(axis=1)
        on_earth = (np.abs(places[:, 0]) <= 90.0) & (np.abs(places[:, 1]) <= 360.0)
        no_fix = (status == STATUS_NO_FIX) | ((status == STATUS_UNKNOWN) & ~known)
        faults = [
            ("no_fix", no_fix | (finite & (horizontal == 0.0).all(axis=1))),
            ("not_finite", ~(finite & on_earth) | np.isinf(places[:, 2])),
        ]
        if not level:
            faults.append(("no_height", np.isnan(places[:, 2])))
        if self.min_status is not None:
            faults.append(("below_fix_status", status < self.min_status))
        if self.max_sigma_m is not None:
            sigma = fixes.sigma_level_m
            faults.append(("fix_sigma_unknown", np.isnan(sigma)))
            faults.append(("fix_sigma_above_limit", sigma > self.max_sigma_m))
        return faults

    def datum_of(self, stamps: Stamps, fixes: Fixes) -> Datum:
        """Return the origin of the frame: the rule's, or the first usable fix (N > 0).

        Raises:
            InputError: The rule's datum is more than 100 km away.
        """
        first = fixes.places[int(np.argmin(stamps))]
        height = float(first[2]) if np.isfinite(first[2]) else 0.0
        if self.datum is None:
            return Datum(float(first[0]), float(first[1]), height)
        away_m = float(np.linalg.norm(_away(first, height, self.datum)))
        if away_m > _FARTHEST_M:
            raise InputError(
                f"the datum {self.datum} is {away_m / 1e3:.0f} km away from the first fix "
                f"({first[0]:.6f},{first[1]:.6f}); check the order and the signs of latitude "
                "and longitude"
            )
        return self.datum

    def applied(self, trajectory: Trajectory, *, level: bool = False) -> Trajectory:
        """Return the usable fixes of a trajectory, in the frame of the rule's datum.

        A trajectory without fixes is returned unchanged.

        Args:
            trajectory: As `fix_trajectory` returns it.
            level: Whether to use fixes without height although others have one.

        Raises:
            InputError: No fix is usable, or the datum is too far away.
        """
        fixes = trajectory.fixes
        if fixes is None:
            return trajectory
        if level and fixes.flat is not None:
            trajectory, fixes = _with_flat(trajectory, fixes)
        elif (self.datum, self.min_status, self.max_sigma_m) == (None, None, None):
            return trajectory
        level = level or not fixes.have_heights
        kept, dropped = self.usable(fixes, level=level)
        return _located(trajectory, fixes, kept, dropped, self, level=level)


def fix_trajectory(stamps: Stamps, fixes: Fixes, **attributes: Any) -> Trajectory:
    """Return the trajectory of the usable fixes, in the frame of the first; count the others.

    If only some have a height, those without are counted and kept apart, as `Fixes.flat`.

    Args:
        stamps: (N,), nanoseconds.
        fixes: N fixes.
        **attributes: Other attributes of `Trajectory`.

    Raises:
        InputError: No fix is usable, or all are at the same place.
    """
    rule = FixRule()
    usable, _ = rule.usable(fixes, level=True)
    level = not fixes[usable].have_heights
    kept, dropped = rule.usable(fixes, level=level)
    apart = usable & ~kept
    if apart.any():
        fixes = dataclasses.replace(fixes, flat=(stamps[apart], fixes[apart]))
    states = Trajectory(stamps, np.zeros((len(stamps), 3)), frame=FRAME, **attributes)
    return _located(states, fixes, kept, dropped, rule, level=level)


def _with_flat(trajectory: Trajectory, fixes: Fixes) -> tuple[Trajectory, Fixes]:
    """Return a trajectory with its fixes without height, and no positions yet; and all fixes."""
    assert fixes.flat is not None
    stamps, flat = fixes.flat
    stamps = np.concatenate([trajectory.stamps, stamps])
    order = np.argsort(stamps, kind="stable")
    places, status, types, covariances = (
        np.concatenate([getattr(fixes, name), getattr(flat, name)])[order]
        for name in ("places", "status", "covariance_types", "covariances")
    )
    joined = Fixes(places, status, types, covariances)
    states = dataclasses.replace(
        trajectory,
        stamps=stamps[order],
        positions=np.zeros((len(stamps), 3)),
        covariances=None,
        fixes=joined,
        dropped={each: count for each, count in trajectory.dropped.items() if each != "no_height"},
    )
    return states, joined


def _located(
    trajectory: Trajectory,
    fixes: Fixes,
    kept: Booleans,
    dropped: dict[str, int],
    rule: FixRule,
    *,
    level: bool,
) -> Trajectory:
    """Return the states whose fixes are kept, at the positions of these fixes.

    Args:
        trajectory: N states, with any positions.
        fixes: N fixes.
        kept: (N,) which fixes are usable.
        dropped: Number of the other fixes by reason.
        rule: Determines the datum.
        level: See `Fixes.positions`.

    Raises:
        InputError: No fix is kept, all are at the same place, or the datum is too far away.
    """
    if not kept.any():
        why = ", ".join(
            f"{count} {reason.replace('_', ' ')}" for reason, count in dropped.items() if count
        )
        raise InputError(
            f"no usable fix among {len(fixes)} ({why}); check the receiver, --min-fix-status and "
            "--max-fix-sigma"
        )
    used = fixes[kept]
    if len(used) > 1 and (used.places[:, :2] == used.places[0, :2]).all():
        raise InputError(
            f"all fixes ({len(used)}) are at the same place, "
            f"{used.places[0, 0]:.7f},{used.places[0, 1]:.7f}: the driver repeats its last "
            "fix, or the receiver is set to a fixed position"
        )
    states = trajectory[kept]
    used = dataclasses.replace(used, datum=rule.datum_of(states.stamps, used))
    return dataclasses.replace(
        states,
        positions=used.positions(level=level),
        covariances=used.pose_covariances(),
        fixes=used,
        dropped=add_counts(trajectory.dropped, dropped),
    )


def _away(place: Floats, height: float, datum: Datum) -> Floats:
    """Return the position (1, 3) of a place in the frame of a datum, metres."""
    return east_north_up(np.array([[place[0], place[1], height]]), datum)
