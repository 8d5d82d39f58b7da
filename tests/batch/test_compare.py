"""`trajeval compare` from files to tables: what is done again, what stays, what is told."""

from __future__ import annotations

import csv
import os
from pathlib import Path

import numpy as np
import pytest
from comparison_runs import compare, here, write_run, write_runs

pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
pytest.importorskip("jinja2", reason="Jinja2 is missing, the extra `compare`")
pytest.importorskip("matplotlib", reason="matplotlib is missing, the extra `compare`")

import pyarrow
import pyarrow.parquet

from trajeval_ros.batch.comparison import Progress, run_plan
from trajeval_ros.batch.comparison_summary import ComparisonSummary, summary_of
from trajeval_ros.batch.config import plan_of
from trajeval_ros.batch.finished_comparison import RUNS, pooled_rows
from trajeval_ros.batch.planned_figures import sequence_figures
from trajeval_ros.batch.records import OWN, RECORDS, Record, RecordStore
from trajeval_ros.batch.results_table import ResultsTable
from trajeval_ros.batch.summary_tables import matrices
from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError
from trajeval_ros.report.matrix import to_latex


def run(config: Path, **more: bool) -> tuple[Progress, ComparisonSummary]:
    out = config.parent / "out"
    progress = run_plan(plan_of(config, {"common_time_span": more.get("cut")}), out, here)
    return progress, summary_of(out)


def records(config: Path) -> bytes:
    return (config.parent / "out" / RECORDS / OWN).read_bytes()


def stored(config: Path) -> int:
    """Return how many runs have a record."""
    return len(RecordStore(config.parent / "out" / RECORDS))


@pytest.mark.slow
def test_nothing_is_done_twice(tmp_path: Path) -> None:
    config = write_runs(tmp_path)
    first, _ = run(config)
    assert (first.done, first.kept, first.failed) == (8, 0, 0)
    made = records(config)
    table = (tmp_path / "out" / RUNS).read_bytes()
    second, _ = run(config)
    assert (second.done, second.kept) == (0, 8)
    assert records(config) == made
    assert (tmp_path / "out" / RUNS).read_bytes() == table


@pytest.mark.slow
def test_only_what_changed_is_done_again(tmp_path: Path) -> None:
    config = write_runs(tmp_path)
    _, before = run(config)
    write_run(tmp_path / "bad" / "yard_trial1.txt", 1.2)
    progress, after = run(config)
    assert (progress.done, progress.kept) == (1, 7)
    changed = [
        now.trial for then, now in zip(before.trials, after.trials, strict=True) if then != now
    ]
    assert changed == ["1"]
    assert after.of("bad", "yard")[1].rmse["position_m"] > 0.5


@pytest.mark.slow
def test_a_change_of_the_same_size_at_the_same_time_is_seen(tmp_path: Path) -> None:
    config = write_runs(tmp_path)
    path = tmp_path / "bad" / "yard_trial1.txt"
    stamp = path.stat().st_mtime_ns
    run(config)
    rows = path.read_text()
    path.write_text(rows.replace("4.1", "4.2"))
    assert len(rows) == path.stat().st_size
    os.utime(path, ns=(stamp, stamp))
    progress, _ = run(config)
    assert progress.done == 1


def test_other_content_with_the_stamp_and_size_of_the_old_is_seen(tmp_path: Path) -> None:
    config = write_runs(tmp_path)
    path, other = tmp_path / "bad" / "yard_trial1.txt", tmp_path / "other.txt"
    long_ago = (10**9, 10**9)
    os.utime(path, long_ago)
    run(config)
    write_run(other, 1.3)
    assert other.stat().st_size == path.stat().st_size
    os.utime(other, long_ago)
    other.replace(path)
    progress, _ = run(config)
    assert progress.done == 1


@pytest.mark.slow
def test_other_settings_are_other_runs_and_the_old_ones_are_kept(tmp_path: Path) -> None:
    config = write_runs(tmp_path)
    run(config)
    run_plan(plan_of(config, {"gauge": "yaw"}), tmp_path / "out", here)
    assert stored(config) == 16
    progress, _ = run(config)
    assert progress.done == 0


@pytest.mark.slow
def test_what_can_not_be_read_any_more_is_made_anew(tmp_path: Path) -> None:
    config = write_runs(tmp_path)
    _, before = run(config)
    out = tmp_path / "out"
    for path in (out / RUNS, out / RECORDS / OWN):
        path.write_bytes(path.read_bytes()[:100])
    (out / "inputs.json").write_text('{"')
    _, after = run(config)
    assert after.trials == before.trials


@pytest.mark.slow
def test_failed_and_missing_runs_stay_and_are_worse_than_all(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = write_runs(tmp_path, trials=3)
    (tmp_path / "good" / "yard_trial0.txt").write_text("no trajectory\n")
    (tmp_path / "good" / "yard_trial2.txt").unlink()
    (tmp_path / "good" / "hall_trial1.txt").write_text("")
    out = tmp_path / "out"
    assert compare(config, output=out) == 0
    told = capsys.readouterr()
    assert "warning: good yard 2 missing: " in told.err
    assert "warning: good yard 0 failed:" in told.err
    assert "3/6" in told.out
    assert "9 runs evaluated, 3 failed or missing; report.html" in told.out
    with (out / "ate_position_m.csv").open() as file:
        good, bad = list(csv.DictReader(file))
    assert good["yard"] == "inf"
    # One of three failed: the median over all three is the worse of the other two.
    ok = [trial.rmse["position_m"] for trial in summary_of(out).of("good", "hall") if trial.key]
    assert float(good["hall"]) == max(ok)
    assert float(good["coverage"]) == pytest.approx(0.5, abs=0.02)
    assert float(bad["coverage"]) == pytest.approx(1.0, abs=0.02)
    text = (out / "tables.md").read_text()
    assert "failed 1/3" in text
    assert "good hall 1 failed" in text
    # Failed runs are tried again; then they may succeed.
    write_run(tmp_path / "good" / "yard_trial0.txt", 1.01)
    progress, summary = run(config)
    assert (progress.done, progress.kept, progress.failed) == (1, 9, 1)
    assert summary.of("good", "yard")[0].status == "ok"


def test_who_lost_runs_is_never_the_best_in_relative_errors(tmp_path: Path) -> None:
    config = write_runs(tmp_path, trials=1)
    # What is hard for both, one has no estimate of.
    write_run(tmp_path / "good" / "yard_trial0.txt", 1.5)
    (tmp_path / "bad" / "yard_trial0.txt").unlink()
    _, summary = run(config)
    table = next(matrix for matrix in matrices(summary) if matrix.name == "re_position_percent")
    (_, good), (_, bad) = table.rows
    assert good[0].value is not None
    assert bad[0].value is not None
    assert bad[0].value < good[0].value
    assert [cells[0].note for _, cells in table.rows] == ["§", "1/2"]  # an error of 50 % in scale
    # Neither: a mark would say that the larger number is the better one.
    assert [ranks[0] for ranks in table.ranks()] == [0, 0]
    assert "¶ not ranked: bad (1 of 2 runs)." in table.caption
    assert r"$^\P$ not ranked: bad (1 of 2 runs)." in to_latex(table)


def test_a_common_time_span_takes_the_early_end_of_one_from_all(tmp_path: Path) -> None:
    config = write_runs(tmp_path, trials=1)
    write_run(tmp_path / "bad" / "hall_trial0.txt", 1.03, count=150, seconds=10.0)
    _, whole = run(config)
    assert [round(trial.coverage, 1) for trial in whole.of("bad")] == [0.5, 1.0]
    progress, cut = run(config, cut=True)
    assert progress.done == 4
    rows = ResultsTable(tmp_path / "out" / RUNS).select(
        ["common_span", "span_s", "groundtruth_coverage", "own_groundtruth_coverage"],
        kind="ate", metric="position_m", sequence="hall",
    )  # fmt: skip
    assert [row["span_s"] for row in rows] == pytest.approx([10.0, 10.0], abs=0.1)
    assert [row["common_span"] for row in rows] == pytest.approx([0.5, 0.5], abs=0.01)
    assert [row["groundtruth_coverage"] for row in rows] == pytest.approx([1.0, 1.0], abs=0.01)
    assert [row["own_groundtruth_coverage"] for row in rows] == pytest.approx([1, 0.5], abs=0.01)
    assert cut.of("bad", "hall")[0].rmse == pytest.approx(whole.of("bad", "hall")[0].rmse)
    assert cut.of("good", "hall")[0].rmse != whole.of("good", "hall")[0].rmse
    assert cut.of("good", "yard")[0].rmse == pytest.approx(whole.of("good", "yard")[0].rmse)
    again, _ = run(config, cut=True)
    assert again.done == 0


def test_runs_without_common_time_say_so(tmp_path: Path) -> None:
    config = write_runs(tmp_path, trials=1, sequences=["hall"])
    path = write_run(tmp_path / "bad" / "hall_trial0.txt", 1.03, count=100, seconds=8.0)
    write_run(tmp_path / "good" / "hall_trial0.txt", 1.01)
    late = np.loadtxt(tmp_path / "good" / "hall_trial0.txt")[150:]
    np.savetxt(tmp_path / "good" / "hall_trial0.txt", late, fmt="%.9f")
    assert path.exists()
    _, summary = run(config, cut=True)
    assert {trial.reason for trial in summary.trials} == {
        "the runs of hall have no common time span"
    }


def test_the_caption_states_the_association(tmp_path: Path) -> None:
    config = write_runs(tmp_path, trials=1, sequences=["hall"])
    for options, text in (
        (
            {},
            "groundtruth interpolated (for points and fixes the estimate), gaps up to 0.5 s.",
        ),
        ({"max_gap": 2.0, "association": "linear"}, "groundtruth interpolated, gaps up to 2 s."),
        ({"association": "nearest"}, "nearest timestamps one to one, within 0.02 s."),
    ):
        run_plan(plan_of(config, options), tmp_path / "out", here)
        caption = matrices(summary_of(tmp_path / "out"))[0].caption
        assert f"gauge se3, all states; {text}" in caption


def test_the_trial_of_a_figure_is_named(tmp_path: Path) -> None:
    config = write_runs(tmp_path, trials=3, sequences=["hall"])
    _, summary = run(config)
    planned = sequence_figures(summary, RecordStore(tmp_path / "out" / RECORDS), "hall")
    (paths,) = (item.plot.paths for item in planned if item.name == "trajectories_hall")
    assert [name for name, _ in paths.values()] == ["good, trial 1", "bad, trial 1"]


def test_shares_of_the_path_are_the_same_lengths_for_all(tmp_path: Path) -> None:
    config = write_runs(tmp_path, trials=1, sequences=["hall"])
    write_run(tmp_path / "bad" / "hall_trial0.txt", 1.03, count=250, seconds=16.0)
    run_plan(plan_of(config, {"lengths": "20%"}), tmp_path / "out", here)
    rows = ResultsTable(tmp_path / "out" / RUNS).select(["length", "length_m"], kind="re")
    assert {row["length"] for row in rows} == {"20%"}
    assert len({row["length_m"] for row in rows}) == 1
    assert rows[0]["length_m"] == pytest.approx(0.2 * 2 * np.pi * 4.0, rel=0.2)


@pytest.mark.parametrize(
    ("lengths", "headings", "across"),
    [
        ("1f", ("1 frame",), "[frames]"),
        ("5deg", ("5 deg",), "[deg]"),
        ("4,1s", ("4 m", "1 s"), ""),
        ("20%", ("20 %",), "[% of the path]"),
    ],
)
def test_lengths_of_every_unit_are_in_tables_and_figures(
    lengths: str, headings: tuple[str, ...], across: str, tmp_path: Path
) -> None:
    config = write_runs(tmp_path, trials=1, sequences=["hall"])
    out = tmp_path / "out"
    run_plan(plan_of(config, {"lengths": lengths}), out, here)
    summary = summary_of(out)
    relative = [matrix for matrix in matrices(summary) if matrix.name.startswith("re_")]
    unit = "percent" if lengths == "20%" else "m"
    assert [item.columns for item in relative] == [headings, headings]
    assert relative[0].name == f"re_position_{unit}"
    assert all(cell.value is not None for _, cells in relative[0].rows for cell in cells)
    planned = sequence_figures(summary, RecordStore(out / RECORDS), "hall")
    plots = [item.plot for item in planned if item.name.startswith("re_")]
    shown = [heading.split()[0] for heading in headings] if across else list(headings)
    assert [plot.groups for plot in plots] == [shown, shown]
    assert {plot.axis for plot in plots} == {f"length of sub-trajectory {across}".rstrip()}


@pytest.mark.slow
def test_the_table_has_a_row_per_run_metric_and_length_with_provenance(tmp_path: Path) -> None:
    config = write_runs(tmp_path)
    run(config)
    table = pyarrow.parquet.read_table(tmp_path / "out" / RUNS)
    rows = table.to_pylist()
    kinds = [(row["kind"], row["length"]) for row in rows if row["metric"] == "rotation_deg"]
    assert kinds == 8 * [("ate", None), ("re", "4m"), ("re", "8m")]
    for row in rows:
        assert row["status"] == "ok"
        assert len(row["estimate_sha256"]) == 64
        assert row["gauge"] == "se3"
        assert row["rmse"] is not None
        assert row["count"] > 0
    names = [(row["algorithm"], row["sequence"], row["trial"]) for row in rows]
    item = {(*name, row["kind"], row["metric"], row["length"])
            for name, row in zip(names, rows, strict=True)}  # fmt: skip
    assert len(item) == len(rows)


@pytest.mark.slow
def test_urls_are_sources_too(tmp_path: Path) -> None:
    pytest.importorskip("upath", reason="universal-pathlib is missing, the extra `remote`")
    import fsspec

    config = write_runs(tmp_path, trials=1)
    store = fsspec.filesystem("memory")
    store.put(str(tmp_path), "/runs", recursive=True)
    remote = tmp_path / "remote.yaml"
    text = config.read_text()
    for name in ("groundtruth", "good", "bad"):
        text = text.replace(f"{name}: ", f"{name}: memory://runs/")
    remote.write_text(text)
    _, local = run(config)
    far = tmp_path / "far"
    plan = plan_of(remote, {})
    assert all(item.estimate.startswith("memory://") for item in plan.runs)
    run_plan(plan, far, here)
    assert [trial.rmse for trial in summary_of(far).trials] == [
        trial.rmse for trial in local.trials
    ]
    assert run_plan(plan, far, here).done == 0
    store.put(str(write_run(tmp_path / "x.txt", 1.1)), "/runs/bad/yard_trial0.txt")
    assert run_plan(plan_of(remote, {}), far, here).done == 1
    remote.write_text(text.replace("bad/{seq", "worse/{seq"))
    with pytest.raises(InputError, match="no file matches"):
        plan_of(remote, {})


@pytest.mark.slow
def test_a_folder_that_can_not_be_written_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = write_runs(tmp_path)
    run(config)
    finished = records(config)
    write_run(tmp_path / "bad" / "yard_trial1.txt", 1.2)

    write = os.pwrite

    def full(file: int, data: bytes, place: int) -> int:
        if len(data) < 100:
            raise OSError(28, "No space left on device")
        return write(file, data[: len(data) // 2], place)

    with monkeypatch.context() as patch:
        patch.setattr(os, "pwrite", full)
        with pytest.raises(InputError, match="can't be written: no space left"):
            run(config)
    assert records(config) == finished
    assert {path.name for path in (tmp_path / "out" / RECORDS).iterdir()} == {OWN}
    progress, _ = run(config)
    assert (progress.done, progress.kept) == (1, 7)


def test_tables_that_are_none_are_refused(tmp_path: Path) -> None:
    for name, content, text in (
        ("half", b"PAR1 and then the disk was full", "not a complete Parquet file"),
        ("none", None, "does not exist"),
    ):
        path = tmp_path / f"{name}.parquet"
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(InputError, match=text):
            ResultsTable(path)
    other = tmp_path / "other.parquet"
    pyarrow.parquet.write_table(pyarrow.table({"a": [1]}), other)
    with pytest.raises(InputError, match="not a table of trajeval compare"):
        ResultsTable(other)


def test_usage_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = str(write_runs(tmp_path))
    for arguments, text in (
        (["--workers", "2", "--cluster", "tcp://127.0.0.1:1"], "give one of them"),
        (["--workers", "0"], "workers"),
        (["--gauge", "yaww"], "unknown gauge 'yaww'"),
    ):
        assert main(["compare", config, *arguments]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert text in line


def record_of(errors: dict[str, np.ndarray], sizes: dict[str, float | None]) -> Record:
    """Return the record of a run whose sub-trajectories have these errors, m and deg."""
    segments = [{} if size is None else {"length_m": size} for size in sizes.values()]
    absolute = dict.fromkeys(("position_m", "rotation_deg", "yaw_deg", "tilt_deg"))
    result = {"runs": [{"ate": absolute, "re": {"segments": segments}}]}
    columns = {
        f"{length}.{metric}": rows
        for length in sizes
        for metric, rows in zip(("position_m", "rotation_deg"), errors[length], strict=True)
    }
    return Record("", result, tuple(sizes), (0, 1), columns)


@pytest.mark.parametrize("sizes", [(8.0, 8.0), (8.0, 10.0)], ids=["metres", "shares"])
def test_pooled_drift_is_each_error_over_the_length_of_its_own_trial(
    sizes: tuple[float, float],
) -> None:
    random = np.random.default_rng(3)
    trials = [random.uniform(0.1, 2.0, (2, count)) for count in (5, 7)]
    records = [
        record_of({"25%": errors}, {"25%": size})
        for errors, size in zip(trials, sizes, strict=True)
    ]
    rows = {row["metric"]: row for row in pooled_rows("vio", "hall", 3, records)}
    expected = {
        "position_m": trials[0][0].tolist() + trials[1][0].tolist(),
        "rotation_deg": trials[0][1].tolist() + trials[1][1].tolist(),
        "position_percent": [
            100.0 * error / size
            for errors, size in zip(trials, sizes, strict=True)
            for error in errors[0]
        ],
        "rotation_deg_per_m": [
            error / size for errors, size in zip(trials, sizes, strict=True) for error in errors[1]
        ],
    }
    assert rows.keys() == expected.keys()
    for metric, errors in expected.items():
        row = rows[metric]
        assert (row["count"], row["trials"], row["evaluated"]) == (12, 3, 2)
        assert row["rmse"] == pytest.approx(np.sqrt(np.mean(np.square(errors))))
        assert row["mean"] == pytest.approx(np.mean(errors))
        assert (row["min"], row["max"]) == pytest.approx((min(errors), max(errors)))
        for name, share in {"p5": 5, "p25": 25, "median": 50, "p75": 75, "p95": 95}.items():
            assert row[name] == pytest.approx(np.percentile(errors, share)), name


def test_pooled_durations_have_no_drift() -> None:
    record = record_of({"1s": np.ones((2, 4))}, {"1s": None})
    rows = list(pooled_rows("vio", "hall", 1, [record]))
    assert [row["metric"] for row in rows] == ["position_m", "rotation_deg"]
    assert [row["length_m"] for row in rows] == [None, None]
