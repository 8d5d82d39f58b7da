"""The text of the picture in Markdown: errors, coverage, and the meaning of the colours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from trajeval_ros.consistency.consistency_result import Consistency
from trajeval_ros.formatting.escaping import markdown_text
from trajeval_ros.formatting.numbers import NOTHING, degrees, metres, whole_percent
from trajeval_ros.formatting.text_tables import BOLD, MarkedText, markdown_table
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.alignment import Alignment
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.statistics import Statistics
from trajeval_ros.metrics.sub_trajectories import Length
from trajeval_ros.viewer.appearance import ErrorScale, shortened

if TYPE_CHECKING:
    from trajeval_ros.online.reports import Snapshot

Row = tuple[str, list[str]]  # a label, and one value per name
_POSITION = "Position error, RMSE (ATE)"
_MOST_COLUMNS, _LONGEST_NAME = 2, 20
_SHORT = {
    _POSITION: "ATE",
    "of the newest window": "newest",
    "Rotation error, RMSE": "Rotation",
    "Rotation error of the window": "Rotation",
    "Estimate covered": "Estimate",
    "Groundtruth covered": "Groundtruth",
}


def of_evaluations(
    evaluations: Sequence[Evaluation],
    consistencies: Sequence[Consistency | None],
    names: Sequence[str],
    scale: ErrorScale,
    remarks: Sequence[str],
) -> str:
    """Return the text about recorded runs."""
    gauge = evaluations[0].protocol.gauge
    alignments = [evaluation.alignment for evaluation in evaluations]
    pairs = [evaluation.association for evaluation in evaluations]
    rows: list[Row] = [
        (_POSITION, [metres(rmse_of(evaluation.ate, "position_m")) for evaluation in evaluations]),
        (
            "Rotation error, RMSE",
            [degrees(rmse_of(evaluation.ate, "rotation_deg")) for evaluation in evaluations],
        ),
        *_scales(gauge, alignments),
        ("Drift", [_drift(evaluation) for evaluation in evaluations]),
        ("Estimate covered", [whole_percent(pair.estimate_coverage) for pair in pairs]),
        ("Groundtruth covered", [whole_percent(pair.groundtruth_coverage) for pair in pairs]),
        _aligned_by(gauge, alignments),
    ]
    if any(consistencies):
        rows.append(("Consistency", [_verdict(consistency) for consistency in consistencies]))
        rows.append(("NEES / dof", [_nees(consistency) for consistency in consistencies]))
    return _text(names, rows, scale, remarks)


def of_snapshots(
    snapshots: Sequence[Snapshot],
    names: Sequence[str],
    gauge: Gauge,
    scale: ErrorScale | None,
    *,
    is_growing: bool,
) -> str:
    """Return the text about live runs so far."""
    alignments = [snapshot.alignment for snapshot in snapshots]
    rows: list[Row] = [
        (_POSITION, [metres(snapshot.position_rmse_m) for snapshot in snapshots]),
        (
            "of the newest window",
            [metres(snapshot.window_position_rmse_m) for snapshot in snapshots],
        ),
        (
            "Rotation error of the window",
            [degrees(rmse_of(snapshot.ate, "rotation_deg")) for snapshot in snapshots],
        ),
        *_scales(gauge, alignments),
        ("Drift", [_drift_so_far(snapshot) for snapshot in snapshots]),
        (
            "Estimate covered",
            [whole_percent(snapshot.estimate_coverage) for snapshot in snapshots],
        ),
        (
            "Groundtruth covered",
            [
                NOTHING if snapshot.coverage is None else whole_percent(snapshot.coverage.covered)
                for snapshot in snapshots
            ],
        ),
        _aligned_by(gauge, alignments),
    ]
    remarks = [
        f"{name}: {snapshot.warming_up}"
        for name, snapshot in zip(names, snapshots, strict=True)
        if snapshot.warming_up
    ]
    return _text(names, rows, scale, remarks, is_growing=is_growing)


def origin_in_words(origin: Floats) -> str:
    """Return a sentence about the picture's origin, (3,), metres."""
    return "origin of the drawing: (" + ", ".join(f"{item:.0f}" for item in origin) + ") m"


def gap_in_words(name: str, step_ns: int) -> str:
    """Return a sentence about a gap in the pairs of an estimate, in nanoseconds."""
    return f"{name}: no pairs for {step_ns / NANOSECONDS:.1f} s"


def rmse_of(statistics: Mapping[str, Statistics | None], metric: str) -> float | None:
    """Return the RMSE of a metric; None if there is none."""
    errors = statistics.get(metric)
    return None if errors is None else errors.rmse


def _scales(gauge: Gauge, alignments: Sequence[Alignment | None]) -> list[Row]:
    if not gauge.has_scale:
        return []
    texts = [
        NOTHING if alignment is None else f"{alignment.similarity.scale:.4f}"
        for alignment in alignments
    ]
    return [("Scale", texts)]


def _aligned_by(gauge: Gauge, alignments: Sequence[Alignment | None]) -> Row:
    """Return the row with gauge and number of states."""
    if gauge is Gauge.NONE:
        return "Aligned by", ["nothing"] * len(alignments)
    texts = [
        NOTHING if alignment is None else f"{gauge.value}, {alignment.states_used} states"
        for alignment in alignments
    ]
    return "Aligned by", texts


def _drift(evaluation: Evaluation) -> str:
    drift = evaluation.drift
    if drift is None:
        return NOTHING
    return evaluation.kitti_ranking or f"{drift.percent.mean:.2f} % of {drift.length_m:.4g} m"


def _verdict(consistency: Consistency | None) -> str:
    return NOTHING if consistency is None else consistency.verdict


def _nees(consistency: Consistency | None) -> str:
    """Return the joint NEES, or that of the worst pose, and the range of consistent estimates."""
    if consistency is None or consistency.per_pose is None:
        return NOTHING
    if consistency.joint is not None:
        low, high = consistency.joint.band_95
        share = consistency.joint.nees / consistency.joint.dof
        return f"{share:.3g} (consistent: {low:.2f} to {high:.2f})"
    worst = consistency.per_pose
    limit = "" if worst.limit_95 is None else f" (consistent: below {worst.limit_95:.2f})"
    return f"{worst.max:.3g} at most{limit}"


def longest_drift(snapshot: Snapshot) -> tuple[Length, float] | None:
    """Return the longest length with a relative error so far, and its mean position error, m."""
    known = [Length.parse(text) for text, errors in snapshot.relative.items() if errors.count]
    if not known:
        return None
    longest = max(known, key=lambda length: (length.unit == "m", length.value))
    return longest, snapshot.relative[str(longest)].position_m


def _drift_so_far(snapshot: Snapshot) -> str:
    drift = longest_drift(snapshot)
    return NOTHING if drift is None else f"{metres(drift[1])} in {drift[0]}"


def _text(
    names: Sequence[str],
    rows: list[Row],
    scale: ErrorScale | None,
    remarks: Sequence[str] = (),
    *,
    is_growing: bool = False,
) -> str:
    labels = [label for label, _ in rows]
    if len(names) > _MOST_COLUMNS:
        # One row per estimate, because columns of numbers are narrower than columns of names.
        table = markdown_table(
            ["", *(_SHORT.get(item, item) for item in labels)],
            [
                [MarkedText(shortened(name, _LONGEST_NAME), BOLD), *values]
                for name, *values in zip(names, *(values for _, values in rows), strict=True)
            ],
        )
    else:
        table = markdown_table(
            ["", *(MarkedText(item, BOLD) for item in names)],
            [[label, *values] for label, values in rows],
        )
    meaning = [
        "The white line is the groundtruth, from the dot on.",
        "In plots, thin lines are errors, and thick pale lines the RMSE.",
    ]
    if scale is None:
        meaning.append("The other line is the estimate in its own frame (not aligned yet).")
    else:
        one = len(names) == 1
        lines = "line is the aligned estimate" if one else "lines are the aligned estimates"
        meaning.append(f"The other {lines}.")
        what = "The estimate and the lines to it are" if one else "Lines to the estimates are"
        meaning.append(f"{what} {scale.in_words}.")
        if is_growing and one:
            meaning.append("The colours of the newest part follow later.")
    items = (f"* {markdown_text(remark)}" for remark in remarks)
    return "\n".join([*table, "", " ".join(meaning), "", *items])
