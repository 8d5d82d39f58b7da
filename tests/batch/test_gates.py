"""Regression gates: what is worse, what is noise, and what was lost."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from comparison_runs import compare, here, write_run, write_runs

pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
pytest.importorskip("jinja2", reason="Jinja2 is missing, the extra `compare`")
pytest.importorskip("matplotlib", reason="matplotlib is missing, the extra `compare`")

from gate_tables import GATE, made_table

from trajeval_ros.batch.comparison import run_plan
from trajeval_ros.batch.config import plan_of
from trajeval_ros.batch.gate import Gate, GateValues, remarks_on, require_same_settings
from trajeval_ros.batch.gates import judge
from trajeval_ros.batch.gates_output import to_markdown
from trajeval_ros.batch.results_table import ResultsTable
from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError, SettingsError

TRIALS = 5  # the fewest on both sides with which a number is tested alone


@pytest.mark.parametrize(
    ("text", "gate"),
    [
        (GATE, Gate("ate.position_m.rmse", 5.0)),
        ("ate.position_m.rmse worse than 10%", Gate("ate.position_m.rmse", 10.0)),
        (" re.8m.position_m.mean  worse than 1.5 % ", Gate("re.8m.position_m.mean", 1.5)),
        ("association.x worse than 0 % untested", Gate("association.x", 0.0, tested=False)),
    ],
)
def test_gates_are_read_and_written(text: str, gate: Gate) -> None:
    assert Gate.parse(text) == gate
    assert Gate.parse(str(gate)) == gate


@pytest.mark.parametrize(
    ("text", "message"),
    [
        *((name, "is not valid; write it") for name in (
            "", "ate.position_m.rmse < 3", "a worse than", "a worse than 5",
            "a worse than 5 % + 5 %", "a worse than 1.2.3 %", "a worse than much",
            "a worse than . %", "a worse than .. MAD", "a worse than untested")),
        *((f"a worse than {name}", "without an exact test, 'spread' or 'MAD'; remove it") for name
          in ("5 % + 2 MAD", "2 MAD", "1.5MAD + 5%", "5 % spread 15 %", "5 % spread 3 %")),
        ("association.x worse than 100 %", "below 100 %"),
    ],
)  # fmt: skip
def test_other_words_are_refused(text: str, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        Gate.parse(text)


@pytest.mark.parametrize("values", [None, [1], [{"a": 1}]])
def test_tables_that_lack_a_column_or_hold_another_are_refused(
    tmp_path: Path, values: list[Any] | None
) -> None:
    import pyarrow
    from pyarrow import parquet

    path = tmp_path / "odd.parquet"
    made_table(path, {"a": [0.1, 0.2]})
    table = parquet.read_table(path)
    column = None if values is None else pyarrow.array(values * table.num_rows)
    for name in ("trial", "metric", "length"):
        place = table.column_names.index(name)
        odd = table.drop([name]) if column is None else table.set_column(place, name, column)
        parquet.write_table(odd, path)
        with pytest.raises(InputError, match=f"has no column {name} of string"):
            GateValues(ResultsTable(path))


def table(folder: Path, config: Path) -> Path:
    run_plan(plan_of(config, {}), folder, here)
    return folder / "runs.parquet"


@pytest.fixture(scope="module")
def yesterday(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a comparison with its table in `old/`."""
    folder = tmp_path_factory.mktemp("yesterday")
    table(folder / "old", write_runs(folder, trials=TRIALS))
    return folder


@pytest.fixture
def today(yesterday: Path, tmp_path: Path) -> Path:
    """The same runs once more, to be changed."""
    shutil.copytree(yesterday, tmp_path / "today")
    return tmp_path / "today"


def verdicts(today: Path, yesterday: Path, *gates: str) -> dict[tuple[str, str], str]:
    now = table(today / "old", today / "runs.yaml")
    judgement = judge(
        [Gate.parse(gate) for gate in gates or (GATE,)],
        GateValues(ResultsTable(yesterday / "old" / "runs.parquet")),
        GateValues(ResultsTable(now)),
    )
    return {number.group: number.verdict for number in judgement.gates[0].numbers}


def test_the_same_runs_are_not_worse(today: Path, yesterday: Path) -> None:
    assert set(verdicts(today, yesterday).values()) <= {"undecided", "no worse"}


@pytest.mark.slow
def test_what_is_worse_in_all_trials_is_worse_and_the_other_way_no_worse(
    today: Path, yesterday: Path
) -> None:
    for trial in range(TRIALS):
        write_run(today / "good" / f"yard_trial{trial}.txt", 1.05 + 0.001 * trial)
    result = verdicts(today, yesterday)
    assert result["good", "yard"] == "worse"
    assert "worse" not in (result["good", "hall"], result["bad", "yard"], result["bad", "hall"])
    for trial in range(TRIALS):
        write_run(today / "good" / f"yard_trial{trial}.txt", 1.002 + 0.0001 * trial)
    assert verdicts(today, yesterday)["good", "yard"] == "no worse"


def test_what_varies_in_both_ways_is_undecided(today: Path, yesterday: Path) -> None:
    for trial, scale in enumerate((1.005, 1.09, 1.0052, 1.092, 1.02)):
        write_run(today / "good" / f"yard_trial{trial}.txt", scale)
    assert verdicts(today, yesterday)["good", "yard"] == "undecided"


def test_within_the_limit_is_not_worse(today: Path, yesterday: Path) -> None:
    for trial in range(TRIALS):
        error = 0.01 * (1.0 + 0.1 * trial + 0.01)
        write_run(today / "good" / f"yard_trial{trial}.txt", 1.0 + 1.04 * error)
    assert verdicts(today, yesterday)["good", "yard"] != "worse"
    for limit, word in ((5, "no worse"), (1, "worse")):
        gate = f"ate.position_m.rmse worse than {limit} % untested"
        assert verdicts(today, yesterday, gate)["good", "yard"] == word


def test_less_coverage_is_worse(today: Path, yesterday: Path) -> None:
    for trial in range(TRIALS):
        path = today / "good" / f"yard_trial{trial}.txt"
        path.write_text("\n".join(path.read_text().splitlines()[:200]))
    result = verdicts(today, yesterday, "association.groundtruth_coverage worse than 5 %")
    assert result["good", "yard"] == "worse"
    assert result["bad", "yard"] != "worse"


@pytest.mark.slow
def test_a_sequence_without_numbers_is_lost_and_the_rest_can_not_hide_it(
    today: Path, yesterday: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for trial in range(TRIALS):
        (today / "good" / f"yard_trial{trial}.txt").write_text("nothing\n")
    shutil.rmtree(today / "old")
    old = str(yesterday / "old" / "runs.parquet")
    gate = ["--baseline", old, "--fail-if", GATE]
    assert compare(today / "runs.yaml", *gate, output=today / "old") == 1
    printed = capsys.readouterr().out
    text = (today / "old" / "gates.md").read_text()
    assert printed.endswith(text)
    assert ": missing values" in text
    row = next(line for line in text.splitlines() if "**missing value**" in line)
    assert row.startswith("| good, yard |")
    assert "yard_trial0.txt" in row
    # The same without the failure: nothing is worse, which isn't evidence that all is well.
    for trial in range(TRIALS):
        shutil.copy(yesterday / "good" / f"yard_trial{trial}.txt", today / "good")
    assert compare(today / "runs.yaml", "-q", *gate, output=today / "old") == 0
    assert ": inconclusive" in (today / "old" / "gates.md").read_text()
    assert json.loads((today / "old" / "gates.json").read_text())["verdict"] == "undecided"
    capsys.readouterr()
    assert (
        compare(today / "runs.yaml", "-q", *gate, "--undecided", "fail", output=today / "old") == 1
    )
    assert "inconclusive, which fails by --undecided fail" in capsys.readouterr().err
    loose = [*gate[:-1], "ate.position_m.rmse worse than 90 %", "--undecided", "fail"]
    assert compare(today / "runs.yaml", "-q", *loose, output=today / "old") == 0
    assert ": no worse than 90 %" in (today / "old" / "gates.md").read_text()


@pytest.mark.slow
def test_a_gate_that_cannot_fail_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sequences = ["hall", "yard", "attic", "cellar"]
    config, new = write_runs(tmp_path, sequences, ["good"], trials=1), tmp_path / "new"
    assert compare(config, "-q", output=tmp_path / "old") == 0
    for sequence in sequences:
        write_run(tmp_path / "good" / f"{sequence}_trial0.txt", 1.5)
    gate = ["--baseline", str(tmp_path / "old" / "runs.parquet"), "--fail-if", GATE]
    capsys.readouterr()
    for given in [], ["--undecided", "fail"]:
        assert compare(config, "-q", *gate, *given, output=new) == 2
        error = capsys.readouterr().err
        assert f"the gate '{GATE}' cannot fail: 4 values with so few trials" in error
        assert "use 2 trials on both sides, or 1 more per value now" in error
        assert ": inconclusive" in (new / "gates.md").read_text()
    assert compare(config, "-q", *gate, "--undecided", "pass", output=new) == 0
    # What the message advises is enough.
    write_runs(tmp_path, sequences, ["good"], trials=2)
    assert compare(config, "-q", output=tmp_path / "old") == 0
    for sequence in sequences:
        for trial in range(2):
            write_run(tmp_path / "good" / f"{sequence}_trial{trial}.txt", 1.5 + 0.01 * trial)
    assert compare(config, "-q", *gate, output=new) == 1


def test_what_is_gone_or_new_is_told(today: Path, yesterday: Path) -> None:
    config = today / "runs.yaml"
    text = config.read_text()
    config.write_text(text.replace("  bad: bad/", "  other: bad/"))
    result = verdicts(today, yesterday)
    assert result["bad", "hall"] == "lost"
    assert result["other", "hall"] == "new"


def test_nothing_but_failures_is_no_mistake_of_the_user(today: Path, yesterday: Path) -> None:
    for path in today.glob("*/*_trial*.txt"):
        path.write_text("nothing\n")
    result = verdicts(today, yesterday, "re.8m.position_m.rmse worse than 5 %")
    assert set(result.values()) == {"lost"}


@pytest.mark.slow
def test_the_table_of_the_same_folder_can_be_the_baseline(today: Path) -> None:
    for trial in range(TRIALS):
        write_run(today / "good" / f"yard_trial{trial}.txt", 1.05 + 0.001 * trial)
    arguments = [today / "runs.yaml", "-q"]
    gate = ["--baseline", str(today / "old" / "runs.parquet"), "--fail-if", GATE]
    assert compare(*arguments, *gate, output=today / "old") == 1
    assert compare(*arguments, *gate, output=today / "old") == 0
    for more, is_paired in (["--paired"], True), ([], False):
        assert compare(*arguments, *gate, *more, output=today / "old") == 0
        (result,) = json.loads((today / "old" / "gates.json").read_text())["gates"]
        assert (result["paired"], result["verdict"] == "no worse") == (is_paired, is_paired)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--fail-if", GATE], "give both"),
        (["--baseline", "OLD"], "give both"),
        (["--baseline", "OLD", "--fail-if", "ate.positon_m.rmse worse than 5 %"], "position_m"),
        (["--baseline", "OLD", "--fail-if", "ate.position_m.rms worse than 5 %"], "mean rmse?"),
        (["--baseline", "OLD", "--fail-if", "re.9m.position_m.rmse worse than 5 %"], "'9m'"),
        (
            ["--baseline", "OLD", "--fail-if", "eta.position_m.rmse worse than 5 %"],
            "use one of ate, as_available, re",
        ),
        (["--baseline", "OLD", "--fail-if", "association.pairs worse than 5 %"], "'pairs'"),
        (["--baseline", "OLD", "--fail-if", "association worse than 5 %"], "coverage"),
        (["--baseline", "OLD", "--fail-if", "re worse than 5 %"], "part of re: ''"),
        (
            ["--baseline", "OLD", "--fail-if", GATE, "--false-alarms", "0"],
            "--false-alarms 0 is out of range",
        ),
        (["--baseline", "OLD", "--fail-if", GATE, "--undecided", "maybe"], "pass, fail"),
        (["--paired"], "--paired, --undecided and --false-alarms need --baseline"),
        (["--baseline", "OLD", "--fail-if", f"{GATE} spread 9 %"], "without an exact test"),
        (["--baseline", "none.parquet", "--fail-if", GATE], "does not exist"),
        (["--baseline", "FOLDER", "--fail-if", GATE], "is a folder; give the runs.parquet in it"),
        (["--baseline", "OLD", "--fail-if", GATE, "--gauge", "yaw"], "made with gauge se3"),
    ],
)
def test_what_can_not_be_judged_is_refused_before_any_work(
    arguments: list[str],
    message: str,
    yesterday: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    old = str(yesterday / "old" / "runs.parquet")
    known = {"OLD": old, "FOLDER": str(yesterday / "old")}
    given = [known.get(argument, argument) for argument in arguments]
    out = tmp_path / "out"
    assert main(["compare", str(yesterday / "runs.yaml"), "--output", str(out), *given]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line
    assert not out.exists()


@pytest.mark.parametrize(
    "path", ["re.8m.position_percent.mean", "re.pooled.position_percent.mean", "ate.yaw_deg.p95"]
)
def test_other_numbers_can_be_judged(path: str, yesterday: Path) -> None:
    values = GateValues(ResultsTable(yesterday / "old" / "runs.parquet"))
    judgement = judge([Gate.parse(f"{path} worse than 1 %")], values, values)
    assert not judgement.fails
    assert [number.trials for number in judgement.gates[0].numbers] == 4 * [(TRIALS, TRIALS)]
    assert f"`{path} worse" in to_markdown(judgement, "all | runs", ["the groundtruth changed"])


def test_pools_of_other_lengths_are_refused(today: Path) -> None:
    old = GateValues(ResultsTable(today / "old" / "runs.parquet"))
    other = {**old.settings, "lengths": ["2m", *old.settings["lengths"]]}
    gate = Gate.parse("re.pooled.position_percent.mean worse than 5 %")
    with pytest.raises(InputError, match="made with lengths"):
        require_same_settings(old, other, [gate])
    require_same_settings(old, other, [Gate.parse(GATE)])


def test_a_run_that_failed_before_is_not_new(today: Path, yesterday: Path) -> None:
    for folder in (today, yesterday):
        copy = folder.with_name(f"{folder.name}_failed")
        shutil.copytree(folder, copy)
        for trial in range(TRIALS):
            (copy / "bad" / f"yard_trial{trial}.txt").write_text("nothing\n")
        table(copy / "old", copy / "runs.yaml")
    result = verdicts(
        today.with_name(f"{today.name}_failed"), yesterday.with_name(f"{yesterday.name}_failed")
    )
    assert result["bad", "yard"] == "failed"
    assert result["bad", "hall"] != "worse"


def test_another_groundtruth_is_told_by_its_sequence_and_a_missing_run_is_none(
    tmp_path: Path,
) -> None:
    values = {"s0": [1.0], "s1": [1.0]}
    before, now = (made_table(tmp_path / f"{name}.parquet", values) for name in ("old", "new"))
    assert remarks_on(before, now) == []
    now.groundtruths["vio", "s1"] = "another"
    del now.groundtruths["vio", "s0"]
    (told,) = remarks_on(before, now)
    assert "the groundtruth of s1 differs from the baseline" in told


def test_another_common_time_span_is_told_by_its_sequences(tmp_path: Path) -> None:
    values = {"s0": [1.0, None], "s1": [1.0, 1.0], "s2": [None]}
    before, now = (made_table(tmp_path / f"{name}.parquet", values) for name in ("old", "new"))
    before.spans_s["s0"], before.spans_s["s1"] = 60.5, 75.0
    assert remarks_on(before, now) == []  # every run has its own span
    now.settings["common_time_span"] = True
    (told,) = remarks_on(before, now)
    assert told.startswith("the common time span of s1 differs from the baseline")


def test_a_table_with_damaged_texts_is_refused(tmp_path: Path) -> None:
    import pyarrow
    from pyarrow import parquet

    path = tmp_path / "runs.parquet"
    made_table(path, {"a": [0.1, 0.2]})
    table = parquet.read_table(path)
    place = table.column_names.index("algorithm")
    damaged = pyarrow.array([b"\xff"] * table.num_rows, pyarrow.binary()).view(pyarrow.string())
    parquet.write_table(table.set_column(place, table.schema.field(place), damaged), path)
    with pytest.raises(InputError, match="is not a complete Parquet file; create it again"):
        GateValues(ResultsTable(path))
