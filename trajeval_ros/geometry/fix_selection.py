"""Selection of usable GNSS fixes, and their trajectory.

The selection uses the receiver's own status and covariance only. It does not compare with an
estimate: a fix that disagrees can be right.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps
from trajeval_ros.geometry.fixes import STATUS_NO_FIX, STATUS_UNKNOWN, Fixes
from trajeval_ros.geometry.geodesy import Datum, east_north_up
from trajeval_ros.geometry.source_info import NOT_READ, SourceInfo
from trajeval_ros.geometry.trajectory import Trajectory

FRAME = "east_north_up"
DEFAULT_CORRELATION_S = 100.0
# A datum farther away is a mistake, such as swapped coordinates.
_FARTHEST_M = 100_000.0


@dataclass(frozen=True)
class FixRule:
    """The selection of fixes, their frame and their correlation time."""

    datum: Datum | None = None  # origin of the frame; None for the first usable fix
    min_status: int | None = None  # least status of a usable fix; None for any fix
    # Largest standard deviation along a horizontal axis, metres; None for any.
    max_sigma_m: float | None = None
    # Time in which the correlation of fix errors decays to 1/e, seconds.
    correlation_s: float = DEFAULT_CORRELATION_S

    def __post_init__(self) -> None:
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
        """Return which of N fixes are usable, (N,), and how many are not, by reason.

        `level`: fixes without height are usable, as for gauge planar.
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
        """Return the origin of the frame: the rule's, or the first usable fix (N > 0)."""
        first = fixes.places[int(np.argmin(stamps))]
        height = float(first[2]) if np.isfinite(first[2]) else 0.0
        if self.datum is None:
            return Datum(float(first[0]), float(first[1]), height)
        place = np.array([[first[0], first[1], height]])
        away_m = float(np.linalg.norm(east_north_up(place, self.datum)))
        if away_m > _FARTHEST_M:
            raise InputError(
                f"the datum {self.datum} is {away_m / 1e3:.0f} km away from the first fix "
                f"({first[0]:.6f},{first[1]:.6f}); check the order and the signs of latitude "
                "and longitude"
            )
        return self.datum

    def applied(self, trajectory: Trajectory, *, level: bool = False) -> Trajectory:
        """Return the usable fixes of a trajectory, in the frame of the rule's datum.

        A trajectory without fixes is returned unchanged. `level`: whether to use fixes without
        height although others have one.
        """
        fixes = trajectory.reading.fixes
        if fixes is None:
            return trajectory
        if level and fixes.flat is not None:
            trajectory, fixes = _with_flat(trajectory, fixes)
        elif (self.datum, self.min_status, self.max_sigma_m) == (None, None, None):
            return trajectory
        level = level or not fixes.have_heights
        kept, dropped = self.usable(fixes, level=level)
        return _located(trajectory, fixes, kept, dropped, self, level=level)


def fix_trajectory(
    stamps: Stamps, fixes: Fixes, reading: SourceInfo = NOT_READ, **attributes: Any
) -> Trajectory:
    """Return the trajectory of the usable fixes, in the frame of the first; count the others.

    If only some have a height, those without are counted and kept apart, as `Fixes.flat`.
    `stamps`: (N,), nanoseconds.
    """
    rule = FixRule()
    usable, _ = rule.usable(fixes, level=True)
    level = not fixes[usable].have_heights
    kept, dropped = rule.usable(fixes, level=level)
    apart = usable & ~kept
    if apart.any():
        fixes = dataclasses.replace(fixes, flat=(stamps[apart], fixes[apart]))
    states = Trajectory(
        stamps, np.zeros((len(stamps), 3)), frame=FRAME, reading=reading, **attributes
    )
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
    reading = trajectory.reading
    dropped = {item: count for item, count in reading.dropped.items() if item != "no_height"}
    states = dataclasses.replace(
        trajectory,
        stamps=stamps[order],
        positions=np.zeros((len(stamps), 3)),
        covariances=None,
        # The receive times of the fixes without height are unknown here.
        reading=dataclasses.replace(reading, fixes=joined, dropped=dropped, receive_times=None),
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
    """Return the states with kept fixes, at the positions of these fixes; count the others."""
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
        reading=dataclasses.replace(states.reading, fixes=used).with_dropped(dropped),
    )


def fixes_of_rows(places: Floats, quality: Floats) -> Fixes:
    """Return the fixes of `places` (N, 3) and `quality` (N, 11), as in `trajectory_of_rows`."""
    return Fixes(
        places=places,
        status=quality[:, 0].astype(np.int64),
        covariance_types=quality[:, 1].astype(np.int64),
        covariances=quality[:, 2:].reshape(-1, 3, 3),
    )


def trajectory_of_rows(
    where: str,
    stamps: Stamps,
    places: Floats,
    quality: Floats,
    reading: SourceInfo,
    **attributes: Any,
) -> Trajectory:
    """Return the trajectory of GNSS fixes; invalid fixes are dropped and counted.

    `stamps`: (N,), nanoseconds. `places`: (N, 3), latitude and longitude in degrees, height in
    metres. `quality`: (N, 11), status and covariance type as in sensor_msgs/NavSatFix, then the
    covariance (3 x 3, row by row) along east, north and up, m^2.
    """
    try:
        return fix_trajectory(stamps, fixes_of_rows(places, quality), reading, **attributes)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
