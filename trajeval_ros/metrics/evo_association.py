"""The association of evo 1.38, including its behaviour for repeated and unsorted timestamps.

evo bisects sorted timestamps and scans unsorted ones. The results differ if several timestamps are
equally near.
"""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Indices


def match(short_s: Floats, long_s: Floats, limit_s: float) -> tuple[Indices, Indices]:
    """Return pairs of rows: every timestamp of the shorter trajectory with the nearest other one.

    Args:
        short_s: (N,) seconds, of the trajectory with fewer states.
        long_s: (M,) seconds, M > 0. Several of the N rows can be paired with one of these.
        limit_s: Largest difference, inclusive.

    Returns:
        Rows of `short_s`, (K,), increasing, and the paired rows of `long_s`, (K,).
    """
    if (np.diff(long_s) >= 0.0).all():
        return _match_sorted(short_s, long_s, limit_s)
    return _match_unsorted(short_s, long_s, limit_s)


def _match_sorted(short_s: Floats, long_s: Floats, limit_s: float) -> tuple[Indices, Indices]:
    """Bisect: the last of equal timestamps; the earlier of two equally near ones."""
    last = len(long_s) - 1
    # On or after the last timestamp, the two candidates are the last two rows. If the last
    # timestamp is repeated, evo therefore takes the last row but one.
    upper = np.minimum(np.searchsorted(long_s, short_s, side="right"), last)
    to_upper = long_s[upper] - short_s
    to_lower = np.where(upper > 0, short_s - long_s[upper - 1], np.inf)
    in_range = (short_s >= long_s[0] - limit_s) & (short_s <= long_s[last] + limit_s)
    take_upper = in_range & (to_upper <= limit_s) & (to_upper < to_lower)
    take_lower = in_range & (to_lower <= limit_s) & (to_lower <= to_upper)
    rows = np.flatnonzero(take_upper | take_lower)
    return rows, np.where(take_upper, upper, upper - 1)[rows]


def _match_unsorted(short_s: Floats, long_s: Floats, limit_s: float) -> tuple[Indices, Indices]:
    """Scan in file order: of equally near timestamps, the first row."""
    order = np.argsort(long_s, kind="stable")  # equal stamps stay in file order
    in_order = long_s[order]
    after = np.minimum(np.searchsorted(in_order, short_s), len(in_order) - 1)
    before = np.searchsorted(in_order, in_order[np.maximum(after - 1, 0)])
    to_after, to_before = (np.abs(in_order[rows] - short_s) for rows in (after, before))
    after, before = order[after], order[before]
    nearest = np.where(to_after < to_before, after, before)
    nearest = np.where(to_after == to_before, np.minimum(after, before), nearest)
    rows = np.flatnonzero(np.minimum(to_after, to_before) <= limit_s)
    return rows, nearest[rows]
