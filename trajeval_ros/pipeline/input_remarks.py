"""Remarks on the inputs of an evaluation and on the coverage of their pairs, with instructions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.diagnosis.discontinuities import has_clock_step
from trajeval_ros.formatting.numbers import counted, percent, whole_percent
from trajeval_ros.formatting.remarks import Level, Remark, warning
from trajeval_ros.geometry.fix_selection import FixRule
from trajeval_ros.geometry.geodesy import is_earth_centred
from trajeval_ros.geometry.valid_poses import GROUNDTRUTH_DROPPED, MOST_UNUSABLE, NO_STATE, reasons
from trajeval_ros.metrics.coverage import LOW_COVERAGE
from trajeval_ros.metrics.protocol import PROTOCOLS
from trajeval_ros.metrics.receive_clock import stamped_at_arrival

if TYPE_CHECKING:
    from trajeval_ros.geometry.trajectory import Trajectory
    from trajeval_ros.metrics.association import Association
    from trajeval_ros.metrics.evaluation import Evaluation

_WHOLE = 0.95  # of the time from the first to the last pair
# Of a UTM zone; northings below are within 9 deg of the equator.
_EASTING_M, _NORTHING_M = (1e5, 1e6), (1e6, 1e7)
# Reasons to drop a pose that do not depend on other poses or on the groundtruth.
_BY_TIME = {
    "method": "--association",
    "max_time_difference_s": "--max-time-difference",
    "max_gap_s": "--max-gap",
    "time_offset_s": "--time-offset",
}


def completeness_in_words(evaluation: Evaluation) -> str:
    """Return the number of states of sparse groundtruth with an estimate, as text."""
    pairs, share = evaluation.association, evaluation.association.groundtruth_coverage
    what = {"gnss": "fixes", "points": "points"}.get(pairs.groundtruth.kind, "groundtruth poses")
    # A live run stores only pairs and their fraction of the states.
    states = round(len(pairs) / share)
    gap = pairs.coverage.longest_gap
    without = "" if gap is None else f", longest gap {gap}"
    return (
        f"{len(pairs)} of {states} {what} ({whole_percent(share)}) along "
        f"{pairs.groundtruth.path_length_m:.1f} m have an estimate{without}"
    )


def about_rows(evaluation: Evaluation) -> Iterator[Remark]:
    """Name a side that has no timestamps, and settings of an association by time."""
    rule = evaluation.protocol.association
    if evaluation.association.rule.method != "index" or rule.method == "index":
        return
    sides = {
        "groundtruth": evaluation.groundtruth.reading,
        "estimate": evaluation.estimate.reading,
    }
    without = [name for name, reading in sides.items() if not reading.stamped]
    if len(without) == 1 and not any(side.numbered for side in sides.values()):
        yield warning(
            "paired_by_row",
            f"poses are paired by row, because the {without[0]} has no timestamps; give "
            "them, such as with --frame-rate or, in Python, with seconds=",
        )
    of_protocol = PROTOCOLS.get(evaluation.protocol.name, PROTOCOLS["default"]).association
    why = (
        "without timestamps on both sides, poses are paired by row; give timestamps, such as with "
        "--frame-rate"
    )
    yield from _about_unused(rule, of_protocol, _BY_TIME, why)


def about_coverage(evaluation: Evaluation) -> Iterator[Remark]:
    """Yield the warnings about poses without a pair."""
    pairs = evaluation.association
    yield from _about_unusable(pairs)
    if evaluation.score is not None:
        missing = evaluation.score.missing
        if missing:
            yield warning(
                "points_missed", f"{counted(missing, 'point')} without an estimate, scored 0"
            )
        return
    if pairs.estimate_coverage is None:
        if pairs.groundtruth_coverage < LOW_COVERAGE:
            yield warning(
                "low_coverage",
                f"{completeness_in_words(evaluation)} (dropped: {reasons(pairs.dropped)}); "
                "compare only results at the same points",
            )
    elif min(pairs.estimate_coverage, pairs.groundtruth_coverage) < LOW_COVERAGE:
        why, coverage = reasons(pairs.dropped), pairs.coverage
        # Without a loss between the first and the last pair, the groundtruth is only longer.
        lost = coverage.covered < _WHOLE * coverage.span or pairs.estimate_coverage < LOW_COVERAGE
        yield Remark(
            Level.WARNING if lost else Level.NOTE,
            "low_coverage",
            f"the pairs cover {whole_percent(coverage.covered)} of the groundtruth's "
            f"time and {whole_percent(pairs.estimate_coverage)} of the estimate's poses"
            + (f" (dropped: {why})" if why else "")
            + (f", {coverage.gap_in_words}" if coverage.longest_gap else "")
            + _across_gaps(pairs)
            + "; compare only runs with the same coverage",
        )


def _across_gaps(pairs: Association) -> str:
    """Return what to do if most poses are in groundtruth gaps, as text."""
    if pairs.dropped.get("in_groundtruth_gap", 0) <= len(pairs):
        return ""
    return (
        "; most poses are in groundtruth gaps: if the groundtruth is slow, use --association "
        "groundtruth-stamps or a larger --max-gap"
    )


def _about_unusable(pairs: Association) -> Iterator[Remark]:
    unusable = {item: count for item, count in pairs.dropped.items() if item in NO_STATE}
    count = sum(unusable.values())
    if not count or not pairs.estimate_coverage:
        return
    share = count / (count + len(pairs) / pairs.estimate_coverage)
    if share <= MOST_UNUSABLE:
        return
    yield warning(
        "unusable_poses",
        f"{percent(share)} of the estimate's poses are not usable and were dropped: "
        f"{reasons(unusable)}; correct the output of the estimator",
    )


def about_frames(groundtruth: str, estimate: str) -> Iterator[Remark]:
    """Yield the warning about two bodies with different known names, if they differ."""
    if not groundtruth or not estimate or groundtruth == estimate:
        return
    yield warning(
        "bodies_differ",
        f"the groundtruth is of body {groundtruth!r} and the estimate of {estimate!r}: if the "
        "bodies differ, the errors include their lever arm and rotation",
    )


def about_inputs(evaluation: Evaluation) -> Iterator[Remark]:
    """Yield the warnings about bodies, projections, timestamps and dropped poses of both sides."""
    groundtruth, estimate = evaluation.groundtruth, evaluation.estimate
    # The warning about lever arms is about antennas, too.
    is_fix = groundtruth.kind == "gnss"
    if not is_fix:
        # Of VINS-Fusion, the body has the name of the fixed frame, which names no body.
        bodies = (
            item.child_frame != item.frame and item.child_frame for item in (groundtruth, estimate)
        )
        yield from about_frames(*(body or "" for body in bodies))
    paired = evaluation.association.estimate
    for name, side in (("groundtruth", groundtruth), ("estimate", paired)):
        yield from _about_projection(name, side)
        if not has_clock_step(evaluation) and stamped_at_arrival(side):
            yield warning(
                "arrival_times",
                f"the {name}'s timestamps are probably arrival times: they have jitter, its "
                "motion has none; use sensor timestamps, and check for a constant delay with "
                "--time-offset auto",
            )
    dropped = groundtruth.reading.dropped
    if dropped:
        yield warning("groundtruth_dropped", f"{GROUNDTRUTH_DROPPED}{reasons(dropped)}")


def about_lever_arm(evaluation: Evaluation) -> Iterator[Remark]:
    """Warn that the groundtruth may be of another point of the body than the estimate."""
    kind, protocol = evaluation.groundtruth.kind, evaluation.protocol
    can_rotate = kind == "gnss" or evaluation.estimate.quaternions is not None
    if kind != "poses" and can_rotate and protocol.lever_m is None:
        point = "the antenna" if kind == "gnss" else "a point, such as a prism"
        yield warning(
            "lever_arm_not_given",
            f"the groundtruth is the position of {point}, so rotations of the body add an error "
            "of up to its distance from the estimate's body frame; give the lever arm with "
            "--lever-arm X,Y,Z (metres, in that frame)",
        )


def about_unused_rule(rule: FixRule) -> Iterator[Remark]:
    """Yield the warning about settings of fixes for groundtruth that has none."""
    options = {
        "datum": "--datum",
        "min_status": "--min-fix-status",
        "max_sigma_m": "--max-fix-sigma",
        "correlation_s": "--fix-correlation",
    }
    why = "the groundtruth has no GNSS fixes; remove the option, or give the fixes as groundtruth"
    yield from _about_unused(rule, FixRule(), options, why)


def _about_projection(name: str, side: Trajectory) -> Iterator[Remark]:
    """Yield a warning if a side's positions are earth-centred, or those of a UTM zone."""
    if is_earth_centred(side.positions):
        yield warning(
            "earth_centred_coordinates",
            f"the {name} is probably in earth-centred coordinates (ECEF), where z is not up; "
            "convert it to latitude and longitude or to a local frame, or use --gauge se3",
        )
        return
    columns = [np.abs(column) for column in side.up.to_z_up(side.positions)[:, :2].T]
    low, high = ([reduced(column) for column in columns] for reduced in (np.min, np.max))
    east, north = np.argsort(low)  # either may come first
    is_zone = all(
        least <= low[axis] and high[axis] <= most
        for axis, (least, most) in ((east, _EASTING_M), (north, _NORTHING_M))
    )
    if not is_zone:
        return
    yield warning(
        "utm_coordinates",
        f"the {name} is probably in UTM coordinates (easting {low[east]:.0f} m, northing "
        f"{low[north]:.0f} m): lengths are up to 0.4 m per km too short or long, and grid north "
        "is up to 2 deg off; use latitude and longitude, or gauge sim3 to fit the scale",
    )


def _about_unused(
    given: object, default: object, options: Mapping[str, str], why: str
) -> Iterator[Remark]:
    """Yield the warning about settings that differ from the default without an effect."""
    unused = [
        option
        for name, option in options.items()
        if getattr(given, name) != getattr(default, name)
    ]
    if unused:
        yield warning("unused_settings", f"no effect of {', '.join(unused)}: {why}")
