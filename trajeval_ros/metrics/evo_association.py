"""Which of two trajectories' stamps belong together for evo 1.38, also where it is a quirk.

evo searches sorted stamps by bisection and unsorted ones one by one, and the two differ where
several stamps are equally near.
"""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Indices


def match(short_s: Floats, long_s: Floats, limit_s: float) -> tuple[Indices, Indices]:
    """Return pairs of rows: for each of the shorter trajectory's stamps the nearest other one.

    Args:
        short_s: (N,) seconds, of the trajectory with fewer states.
        long_s: (M,) seconds, M > 0. Several of the N may be paired with the same one.
        limit_s: Largest difference, itself included.

    Returns:
        Rows of `short_s`, (K,), increasing, and the rows of `long_s` that belong to them, (K,).
    """
    if (np.diff(long_s) >= 0.0).all():
        return _match_sorted(short_s, long_s, limit_s)
    return _match_unsorted(short_s, long_s, limit_s)


def _match_sorted(short_s: Floats, long_s: Floats, limit_s: float) -> tuple[Indices, Indices]:
    """Bisect: of equal stamps that are hit, the last one; of two as near, the earlier."""
    last = len(long_s) - 1
    # For a stamp on or after the last one both neighbours are the last two rows. So of a repeated
    # last stamp that is hit, evo takes the last row but one.
    upper = np.minimum(np.searchsorted(long_s, short_s, side="right"), last)
    to_upper = long_s[upper] - short_s
    to_lower = np.where(upper > 0, short_s - long_s[upper - 1], np.inf)
    in_range = (short_s >= long_s[0] - limit_s) & (short_s <= long_s[last] + limit_s)
    take_upper = in_range & (to_upper <= limit_s) & (to_upper < to_lower)
    take_lower = in_range & (to_lower <= limit_s) & (to_lower <= to_upper)
    rows = np.flatnonzero(take_upper | take_lower)
    return rows, np.where(take_upper, upper, upper - 1)[rows]


def _match_unsorted(short_s: Floats, long_s: Floats, limit_s: float) -> tuple[Indices, Indices]:
    """Find what a search in file order finds: of all that are equally near, the first row."""
    order = np.argsort(long_s, kind="stable")  # equal stamps stay in file order
    in_order = long_s[order]
    after = np.minimum(np.searchsorted(in_order, short_s), len(in_order) - 1)
    before = np.searchsorted(in_order, in_order[np.maximum(after - 1, 0)])
    to_after, to_before = (np.abs(in_order[each] - short_s) for each in (after, before))
    after, before = order[after], order[before]
    nearest = np.where(to_after < to_before, after, before)
    nearest = np.where(to_after == to_before, np.minimum(after, before), nearest)
    rows = np.flatnonzero(np.minimum(to_after, to_before) <= limit_s)
    return rows, nearest[rows]
