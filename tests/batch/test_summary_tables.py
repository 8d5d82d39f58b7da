"""The tables of a comparison from the summary of its runs: marks, footnotes, KITTI's ranking."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from comparison_runs import compare

pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
pytest.importorskip("jinja2", reason="Jinja2 is missing, the extra `compare`")

from trajeval_ros.batch.comparison_summary import ComparisonSummary, Trial
from trajeval_ros.batch.results_table import FAILED, MISSING, OK, RE
from trajeval_ros.batch.summary_tables import matrices
from trajeval_ros.io.requests.request_from import request_from
from trajeval_ros.io.requests.settings_table import settings_of
from trajeval_ros.report.matrix import to_csv, to_latex, to_markdown, with_common_notes

METRICS = ("position_percent", "rotation_deg_per_m")


def summary(protocol: str = "default", cause: str = "other_run") -> ComparisonSummary:
    """Return two algorithms on one sequence; the first one shows a mistake."""
    request = request_from({"protocol": protocol, "lengths": "8,16"})
    settings: dict[str, Any] = {**settings_of(request), "common_time_span": False}
    trials = tuple(
        Trial(
            name, "hall", "", OK, "", 1.0, 200, name,
            {"position_m": 1.0, "rotation_deg": 1.0}, {"time_offset_s": 0.1},
            (), (cause,) if name == "wrong" else (),
        )
        for name in ("wrong", "right")
    )  # fmt: skip
    pooled = tuple(
        {"algorithm": trial.algorithm, "sequence": "hall", "kind": RE, "metric": metric,
         "length": length, "mean": 2.0, "count": 9, "evaluated": 1}
        for trial in trials
        for metric in METRICS
        for length in settings["lengths"]
    )  # fmt: skip
    return ComparisonSummary("t", settings, trials, pooled)


def test_every_number_of_a_run_with_a_mistake_has_its_mark_and_footnote() -> None:
    tables = matrices(summary())
    assert [item.name for item in tables] == [
        "ate_position_m", "ate_rotation_deg", *(f"re_{metric}" for metric in METRICS),
        "time_offset_s",
    ]  # fmt: skip
    for table in tables:
        marks = {name: {cell.note for cell in cells} for name, cells in table.rows}
        assert marks == {"wrong": {"§"}, "right": {""}}
        assert "§ mistakes found (other_run: wrong hall); follow" in table.caption
        assert "§ mistakes found." in table.brief
        assert "§" in to_markdown(table).partition("right")[0]
        assert r"\S" in to_latex(table).partition("right")[0]
        wrong, right = to_csv(table).splitlines()[1:]
        assert wrong.count("§") == len(table.columns)
        assert right.endswith(",")
    assert not any("§" in matrix.caption for matrix in matrices(summary(cause="keyframes")))


def test_a_note_of_several_tables_stands_once_below_them() -> None:
    tables, common = with_common_notes(matrices(summary()))
    noted = [*common, *(note for table in tables for note in table.notes)]
    assert len(noted) == len(set(noted))
    assert {note for matrix in matrices(summary()) for note in matrix.notes} == set(noted)


def test_common_time_spans_are_stated_with_their_length_and_share() -> None:
    whole = summary()
    of_hall = [replace(trial, span_s=149.4, common_span=0.82) for trial in whole.trials]
    of_yard = [replace(item, sequence="yard", span_s=75.6, common_span=0.68) for item in of_hall]
    settings = {**whole.settings, "common_time_span": True}
    cut = replace(whole, settings=settings, trials=(*of_hall, *of_yard))
    spans = "76 s of yard (68 % of its groundtruth), 149 s of hall (82 % of its groundtruth)"
    for table in matrices(cut)[:4]:
        assert f"Only the common time span of all runs of a sequence: {spans}." in table.caption
        assert f", common time span: {spans};" in table.brief
    assert not any("common time span" in matrix.caption for matrix in matrices(whole))


def test_a_run_without_a_file_is_missing_and_has_no_coverage() -> None:
    whole = summary(cause="keyframes")
    wrong, right = whole.trials
    gone = replace(wrong, status=MISSING, coverage=0.0, rmse={}, values={}, pairs=0)
    for status, word in ((MISSING, "missing"), (FAILED, "failed")):
        lost = replace(gone, status=status)
        [table, *_] = matrices(replace(whole, trials=(lost, right)))
        assert [cells[0].text for _, cells in table.rows] == [word, "1.000"]
        assert "not ranked" not in table.caption


def test_the_coverage_in_a_footnote_is_that_of_its_column() -> None:
    whole = summary(cause="keyframes")
    half = [replace(whole.trials[0], sequence=name, coverage=share) for name, share in
            (("hall", 1.0), ("yard", 1.0), ("road", 0.4))]  # fmt: skip
    other = [replace(item, algorithm="right", coverage=1.0) for item in half]
    tables = matrices(replace(whole, trials=(*half, *other)))
    table = next(item for item in tables if item.name == "re_position_percent")
    assert table.coverage == pytest.approx((0.8, 1.0))
    assert "not ranked: wrong (covers 80 %)." in table.caption


@pytest.mark.slow
def test_kitti_has_the_tables_of_its_benchmark(shared_data: Path, tmp_path: Path) -> None:
    folder, out = shared_data / "kitti_odom_eval", tmp_path / "out"
    sources = [str(folder / f"09_{item}.txt") for item in ("groundtruth", "frame_index")]
    given = ["--protocol", "kitti", "--gauge", "sim3", "--quiet"]
    assert compare(*sources, *given, output=out) == 0
    # By the tool of that folder, 7dof.
    for name, expected in (("kitti_percent", 2.884113), ("kitti_deg_per_100m", 0.249056)):
        (row,) = csv.DictReader((out / f"re_{name}.csv").read_text().splitlines())
        assert float(row["09_groundtruth"]) == pytest.approx(expected, abs=5e-7)
    text = (out / "tables.md").read_text()
    assert "KITTI: mean over the sub-trajectories of 100 m to 800 m" in text
    assert not any("kitti" in matrix.name for matrix in matrices(summary()))


def test_of_many_common_time_spans_the_smallest_and_the_largest_are_stated() -> None:
    whole = summary()
    trials = [
        replace(whole.trials[1], sequence=name, span_s=seconds, common_span=share)
        for name, seconds, share in (
            ("a", 30.0, 0.5), ("b", 20.0, 0.9), ("c", 10.0, 0.3), ("d", 40.0, 0.7),
        )
    ]  # fmt: skip
    lost = replace(trials[0], sequence="e", status=FAILED, span_s=0.0, rmse={})
    settings = {**whole.settings, "common_time_span": True}
    cut = replace(whole, settings=settings, trials=(*trials, lost))
    assert cut.common_spans == (
        "10 s of c (30 % of its groundtruth) to 20 s of b (90 % of its groundtruth)"
    )
    assert whole.common_spans == ""


@pytest.mark.parametrize("metric", ["position_m", "rotation_deg"])
def test_a_trial_without_a_value_is_ranked_last(metric: str) -> None:
    whole = summary()
    wrong, right = whole.trials
    partial = {name: 0.5 for name in wrong.rmse if name != metric}
    trials = (
        *(replace(wrong, trial=str(k), rmse={**partial, metric: 0.5}) for k in range(2)),
        *(replace(wrong, trial=str(k), rmse=partial) for k in range(2, 5)),
        *(replace(right, trial=str(k)) for k in range(5)),
    )
    tables = {matrix.name: matrix for matrix in matrices(replace(whole, trials=trials))}
    table = tables[f"ate_{metric}"]
    assert [cells[0].text for _, cells in table.rows] == ["withheld", "1.000"]
    assert table.ranks() == [[0], [1]]
    assert table.rows[0][1][0].note.startswith("2/5")


@pytest.mark.parametrize("metric", METRICS)
def test_relative_errors_of_fewer_trials_are_not_ranked(metric: str) -> None:
    whole = summary(cause="keyframes")
    trials = tuple(
        replace(trial, trial=str(k), rmse={}) for trial in whole.trials for k in range(5)
    )
    having = {"wrong": 2, "right": 5}
    pooled = tuple(
        {**row, "evaluated": having[row["algorithm"]] if row["metric"] == metric else 5}
        for row in whole.pooled
    )
    tables = {
        matrix.name: matrix for matrix in matrices(replace(whole, trials=trials, pooled=pooled))
    }
    table, [other] = tables[f"re_{metric}"], [f"re_{item}" for item in METRICS if item != metric]
    # Absolute errors that are withheld do not matter.
    assert [[cell.note for cell in cells] for _, cells in table.rows] == [["2/5"] * 2, [""] * 2]
    assert "not ranked: wrong (2 of 5 runs)." in table.caption
    assert "not ranked" not in tables[other].caption


def test_a_sequence_too_short_for_a_length_favours_no_algorithm() -> None:
    whole = summary(cause="keyframes")
    trials = (*whole.trials, *(replace(trial, sequence="yard") for trial in whole.trials))
    pooled = [{**row, "sequence": name} for name in ("hall", "yard") for row in whole.pooled]
    short = tuple(row for row in pooled if (row["sequence"], row["length"]) != ("yard", "16m"))
    assert len(short) < len(pooled)
    tables = matrices(replace(whole, trials=trials, pooled=short))
    assert not any("not ranked" in table.caption for table in tables)


def test_a_trial_without_a_likelihood_is_ranked_last() -> None:
    whole = summary()
    wrong, right = whole.trials
    trials = (
        replace(wrong, trial="0", values={"nll_per_pose": 0.1}),
        *(replace(wrong, trial=str(k), values={}) for k in (1, 2)),
        *(replace(right, trial=str(k), values={"nll_per_pose": 1.0}) for k in range(3)),
    )
    tables = {matrix.name: matrix for matrix in matrices(replace(whole, trials=trials))}
    assert tables["nll_per_pose"].ranks() == [[0], [1]]
    assert tables["nll_per_pose"].rows[0][1][0].text == "withheld"
