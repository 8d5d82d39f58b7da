"""The picture's text: how wrong, over how much, and what its colours mean; in Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from trajeval_ros.consistency.result import Consistency
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.sub_trajectories import Length
from trajeval_ros.viewer import colours

if TYPE_CHECKING:
    from trajeval_ros.online.reports import Snapshot

Rows = Sequence[tuple[str, Sequence[str]]]
NOTHING = "–"


def text(
    names: Sequence[str],
    rows: Rows,
    full_m: float | None,
    remarks: Sequence[str] = (),
    *,
    is_growing: bool = False,
) -> str:
    """Return the whole text.

    Args:
        names: Of the estimates.
        rows: What is told of each of them: a label, and a value for each name.
        full_m: The error where the scale of colours ends; None while there is none.
        remarks: One sentence each.
        is_growing: Whether the newest part of the path is not coloured yet.
    """
    table = [
        "| | " + " | ".join(f"**{_plain(each)}**" for each in names) + " |",
        "|---|" + "---|" * len(names),
        *(f"| {label} | {' | '.join(map(_plain, values))} |" for label, values in rows),
    ]
    meaning = ["The grey line is the groundtruth."]
    if full_m is not None:
        meaning.append(
            "The other line is the estimate, aligned with it."
            if len(names) == 1
            else "The other lines are the estimates, aligned with it."
        )
        what = "The estimate is" if len(names) == 1 else "Lines from estimate to groundtruth are"
        meaning.append(f"{what} {colours.in_words(full_m)}.")
        if is_growing and len(names) == 1:
            meaning.append("Its newest part gets its colours later.")
    else:
        meaning.append("The other line is the estimate in its own frame: no alignment yet.")
    return "\n".join(
        [*table, "", " ".join(meaning), "", *(f"* {_plain(each)}" for each in remarks)]
    )


def metres(value: float | None) -> str:
    """Return a length in words."""
    return NOTHING if value is None else f"{value:.3f} m"


def degrees(value: float | None) -> str:
    """Return an angle in words."""
    return NOTHING if value is None else f"{value:.2f}°"


def percent(share: float | None) -> str:
    """Return a share in words."""
    return NOTHING if share is None else f"{100.0 * share:.1f} %"


def of_evaluations(
    evaluations: Sequence[Evaluation],
    consistencies: Sequence[Consistency | None],
    names: Sequence[str],
    full_m: float,
    remarks: Sequence[str],
) -> str:
    """Return the text about recorded runs."""
    rows: list[tuple[str, list[str]]] = [
        (
            "Position error, rmse (ATE)",
            [metres(_rmse(each, "position_m")) for each in evaluations],
        ),
        (
            "Rotation error, rmse",
            [degrees(_rmse(each, "rotation_deg")) for each in evaluations],
        ),
        ("Drift", [_drift(each) for each in evaluations]),
        (
            "Estimate covered",
            [percent(each.association.estimate_coverage) for each in evaluations],
        ),
        (
            "Groundtruth covered",
            [percent(each.association.groundtruth_coverage) for each in evaluations],
        ),
        ("Aligned by", [aligned_by(each) for each in evaluations]),
    ]
    if evaluations[0].protocol.gauge.has_scale:
        scales = [f"{each.alignment.similarity.scale:.4f}" for each in evaluations]
        rows.insert(2, ("Scale", scales))
    if any(consistencies):
        rows.append(("As sure as it should be?", [_verdict(each) for each in consistencies]))
        rows.append(("NEES / dof", [_nees(each) for each in consistencies]))
    return text(names, rows, full_m, remarks)


def of_snapshots(
    snapshots: Sequence[Snapshot],
    names: Sequence[str],
    gauge: Gauge,
    full_m: float | None,
    *,
    is_growing: bool,
) -> str:
    """Return the text about live runs so far."""
    rows: list[tuple[str, list[str]]] = [
        (
            "Position error, rmse (ATE)",
            [metres(each.position_rmse_m) for each in snapshots],
        ),
        (
            "of the newest window",
            [metres(each.window_position_rmse_m) for each in snapshots],
        ),
        (
            "Rotation error of the window",
            [degrees(_window_rmse(each, "rotation_deg")) for each in snapshots],
        ),
        ("Drift", [_drift_so_far(each) for each in snapshots]),
        ("Estimate covered", [percent(each.estimate_coverage) for each in snapshots]),
        ("Aligned by", [_aligned_so_far(each, gauge) for each in snapshots]),
    ]
    if gauge.has_scale:
        scales = [
            NOTHING if each.alignment is None else f"{each.alignment.similarity.scale:.4f}"
            for each in snapshots
        ]
        rows.insert(3, ("Scale", scales))
    remarks = [
        f"{name}: {each.warming_up}"
        for name, each in zip(names, snapshots, strict=True)
        if each.warming_up
    ]
    return text(names, rows, full_m, remarks, is_growing=is_growing)


def aligned_by(evaluation: Evaluation) -> str:
    """Return gauge and states in few words."""
    gauge = evaluation.protocol.gauge
    if gauge is Gauge.NONE:
        return "nothing"
    return f"{gauge.value}, {evaluation.alignment.states_used} states"


def _rmse(evaluation: Evaluation, metric: str) -> float | None:
    statistics = evaluation.ate[metric]
    return None if statistics is None else statistics.rmse


def _drift(evaluation: Evaluation) -> str:
    drift = evaluation.drift
    if drift is None:
        return NOTHING
    return f"{drift.percent.mean:.2f} % of {drift.length_m:.4g} m"


def _verdict(consistency: Consistency | None) -> str:
    return NOTHING if consistency is None else consistency.verdict


def _nees(consistency: Consistency | None) -> str:
    """Return the NEES of all poses, or of the worst one, and what honest runs have."""
    if consistency is None or consistency.per_pose is None:
        return NOTHING
    if consistency.joint is not None:
        low, high = consistency.joint.band_95
        share = consistency.joint.nees / consistency.joint.dof
        return f"{share:.3g} (honest: {low:.2f} to {high:.2f})"
    worst = consistency.per_pose
    return f"{worst.max:.3g} at most (honest: under {worst.limit_95:.2f})"


def _window_rmse(snapshot: Snapshot, metric: str) -> float | None:
    statistics = snapshot.ate.get(metric)
    return None if statistics is None else statistics.rmse


def _drift_so_far(snapshot: Snapshot) -> str:
    known = [Length.parse(text) for text, errors in snapshot.relative.items() if errors.count]
    if not known:
        return NOTHING
    longest = str(max(known, key=lambda length: (length.unit == "m", length.value)))
    return f"{snapshot.relative[longest].position_m:.3f} m in {longest}"


def _aligned_so_far(snapshot: Snapshot, gauge: Gauge) -> str:
    if gauge is Gauge.NONE:
        return "nothing"
    if snapshot.alignment is None:
        return NOTHING
    return f"{gauge.value}, {snapshot.alignment.states_used} states"


def _plain(words: str) -> str:
    """Keep names and sentences from being taken for Markdown."""
    return "".join(f"\\{each}" if each in "\\|*_`<>[]#" else each for each in words)
