"""Regression gates: what is worse, what is noise, and what was lost."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from comparison_runs import here, write_run, write_runs
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
pytest.importorskip("jinja2", reason="Jinja2 is missing, the extra `compare`")
pytest.importorskip("matplotlib", reason="matplotlib is missing, the extra `compare`")

from trajeval_ros.batch.comparison import run_plan
from trajeval_ros.batch.config import plan_of
from trajeval_ros.batch.gates import (
    Gate,
    GateValues,
    judge,
    paired_interval,
    require_same_settings,
    to_markdown,
)
from trajeval_ros.batch.results_table import ResultsTable
from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError, SettingsError

GATE = "ate.position_m.rmse worse than 5 % + 2 MAD"


@pytest.mark.parametrize(
    ("text", "percent", "deviations"),
    [
        (GATE, 5.0, 2.0),
        ("ate.position_m.rmse worse than 10%", 10.0, 0.0),
        (" re.8m.position_percent.mean  worse than 1.5 MAD ", 0.0, 1.5),
        ("ate.position_m.rmse worse than 2 MAD+5%", 5.0, 2.0),
        ("association.groundtruth_coverage worse than 0 %", 0.0, 0.0),
    ],
)
def test_gates_are_read_and_written(text: str, percent: float, deviations: float) -> None:
    gate = Gate.parse(text)
    assert (gate.percent, gate.deviations) == (percent, deviations)
    assert Gate.parse(str(gate)) == gate


@pytest.mark.parametrize(
    "text",
    ["", "ate.position_m.rmse < 3", "a worse than", "a worse than 5", "a worse than 5 % + 5 %",
     "a worse than 1.2.3 %", "a worse than much", "a worse than . %", "a worse than .. MAD"],
)  # fmt: skip
def test_other_words_are_refused(text: str) -> None:
    with pytest.raises(SettingsError, match="can't read the gate"):
        Gate.parse(text)


TRIALS = st.lists(st.floats(0.01, 10.0), min_size=2, max_size=12).map(np.array)


@given(TRIALS, st.floats(0.1, 3.0))
def test_a_shift_of_all_trials_is_found_exactly(before: np.ndarray, shift: float) -> None:
    interval = paired_interval(before, before + shift, 0.05)
    assert interval == pytest.approx((shift, shift))
    assert paired_interval(before, before, 0.05) == (0.0, 0.0)


@given(TRIALS)
def test_the_interval_turns_its_sign_with_the_sides(before: np.ndarray) -> None:
    now = before[np.random.default_rng(len(before)).permutation(len(before))]
    there, back = (paired_interval(*sides, 0.05) for sides in ((before, now), (now, before)))
    assert there is not None
    assert back is not None
    assert there[0] <= there[1]
    assert there == pytest.approx((-back[1], -back[0]), abs=1e-12)


@pytest.mark.parametrize("trials", [2, 3, 5, 10, 20])
def test_trials_that_only_vary_are_seldom_called_a_regression(trials: int) -> None:
    generator = np.random.default_rng(trials)
    numbers, tables, called = 10, 60, 0
    for _ in range(tables):
        sides = generator.lognormal(0.0, 0.3, size=(numbers, 2, trials))
        intervals = [paired_interval(*each, 0.05 / numbers) for each in sides]
        assert None not in intervals
        called += any(each[0] > 0.0 for each in intervals if each is not None)
    # Of all numbers of a table together 2.5 % on this side, 1.5 of 60: 7 are as rare as 1 in 1000.
    assert called < 7


def table(folder: Path, config: Path) -> Path:
    run_plan(plan_of(config, {}), folder, here)
    return folder / "runs.parquet"


@pytest.fixture(scope="module")
def yesterday(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a comparison with its table in `old/`."""
    folder = tmp_path_factory.mktemp("yesterday")
    table(folder / "old", write_runs(folder, trials=4))
    return folder


@pytest.fixture
def today(yesterday: Path, tmp_path: Path) -> Path:
    """The same runs once more, to be changed."""
    shutil.copytree(yesterday, tmp_path / "today")
    return tmp_path / "today"


def verdicts(today: Path, yesterday: Path, *gates: str) -> dict[tuple[str, str], str]:
    now = table(today / "old", today / "runs.yaml")
    judged = judge(
        [Gate.parse(each) for each in gates or (GATE,)],
        GateValues(ResultsTable(yesterday / "old" / "runs.parquet")),
        GateValues(ResultsTable(now)),
    )
    return {(each.algorithm, each.sequence): each.verdict for each in judged}


def test_the_same_runs_are_the_same(today: Path, yesterday: Path) -> None:
    assert set(verdicts(today, yesterday).values()) == {"same"}


def test_what_is_worse_in_all_trials_is_worse_and_the_other_way_better(
    today: Path, yesterday: Path
) -> None:
    for trial in range(4):
        write_run(today / "good" / f"yard_trial{trial}.txt", 1.05 + 0.001 * trial)
        write_run(today / "bad" / f"hall_trial{trial}.txt", 1.002 + 0.0001 * trial)
    found = verdicts(today, yesterday)
    assert found["good", "yard"] == "worse"
    assert found["bad", "hall"] == "better"
    assert found["good", "hall"] == found["bad", "yard"] == "same"


def test_what_varies_in_both_ways_is_noise(today: Path, yesterday: Path) -> None:
    for trial, scale in enumerate((1.005, 1.09, 1.005, 1.09)):
        write_run(today / "good" / f"yard_trial{trial}.txt", scale)
    assert verdicts(today, yesterday)["good", "yard"] == "noise"


def test_within_the_limit_is_the_same(today: Path, yesterday: Path) -> None:
    for trial in range(4):
        error = 0.01 * (1.0 + 0.1 * trial + 0.01)
        write_run(today / "good" / f"yard_trial{trial}.txt", 1.0 + 1.04 * error)
    assert verdicts(today, yesterday)["good", "yard"] == "same"
    strict = verdicts(today, yesterday, "ate.position_m.rmse worse than 1 %")
    assert strict["good", "yard"] == "worse"


def test_less_coverage_is_worse(today: Path, yesterday: Path) -> None:
    for trial in range(4):
        path = today / "good" / f"yard_trial{trial}.txt"
        path.write_text("\n".join(path.read_text().splitlines()[:200]))
    found = verdicts(today, yesterday, "association.groundtruth_coverage worse than 5 %")
    assert found["good", "yard"] == "worse"
    assert found["bad", "yard"] == "same"


@pytest.mark.slow
def test_a_run_that_fails_now_is_lost_and_the_rest_can_not_hide_it(
    today: Path, yesterday: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (today / "good" / "yard_trial3.txt").write_text("nothing\n")
    shutil.rmtree(today / "old")
    old = str(yesterday / "old" / "runs.parquet")
    arguments = ["compare", str(today / "runs.yaml"), "--output", str(today / "old")]
    assert main([*arguments, "--workers", "1", "--baseline", old, "--fail-if", GATE]) == 1
    printed = capsys.readouterr().out
    text = (today / "old" / "gates.md").read_text()
    assert printed.endswith(text)
    assert "1 regression in 4 numbers" in text
    row = next(line for line in text.splitlines() if "**lost**" in line)
    assert row.startswith("| good, yard |")
    assert "trial 3:" in row
    # The same without the failure: nothing is worse.
    shutil.copy(yesterday / "good" / "yard_trial3.txt", today / "good")
    assert main([*arguments, "-q", "--baseline", old, "--fail-if", GATE]) == 0
    assert "no regression in 4 numbers" in (today / "old" / "gates.md").read_text()


def test_what_is_gone_or_new_is_told(today: Path, yesterday: Path) -> None:
    config = today / "runs.yaml"
    text = config.read_text()
    config.write_text(text.replace("  bad: bad/", "  other: bad/"))
    found = verdicts(today, yesterday)
    assert found["bad", "hall"] == "lost"
    assert found["other", "hall"] == "new"


def test_nothing_but_failures_is_no_mistake_of_the_user(today: Path, yesterday: Path) -> None:
    for path in today.glob("*/*_trial*.txt"):
        path.write_text("nothing\n")
    found = verdicts(today, yesterday, "re.8m.position_m.rmse worse than 5 %")
    assert set(found.values()) == {"lost"}


@pytest.mark.slow
def test_the_table_of_the_same_folder_can_be_the_baseline(today: Path) -> None:
    for trial in range(4):
        write_run(today / "good" / f"yard_trial{trial}.txt", 1.05)
    arguments = ["compare", str(today / "runs.yaml"), "--output", str(today / "old"), "-q"]
    gate = ["--baseline", str(today / "old" / "runs.parquet"), "--fail-if", GATE]
    assert main([*arguments, "--workers", "1", *gate]) == 1
    assert main([*arguments, "--workers", "1", *gate]) == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--fail-if", GATE], "give both"),
        (["--baseline", "OLD"], "give both"),
        (["--baseline", "OLD", "--fail-if", "ate.positon_m.rmse worse than 5 %"], "position_m"),
        (["--baseline", "OLD", "--fail-if", "ate.position_m.rms worse than 5 %"], "'rmse'"),
        (["--baseline", "OLD", "--fail-if", "re.9m.position_m.rmse worse than 5 %"], "'9m'"),
        (
            ["--baseline", "OLD", "--fail-if", "eta.position_m.rmse worse than 5 %"],
            "it has ate, re",
        ),
        (["--baseline", "OLD", "--fail-if", "association.pairs worse than 5 %"], "'pairs'"),
        (["--baseline", "OLD", "--fail-if", "association worse than 5 %"], "coverage"),
        (["--baseline", "OLD", "--fail-if", "re worse than 5 %"], "no ''"),
        (["--baseline", "none.parquet", "--fail-if", GATE], "does not exist"),
        (["--baseline", "OLD", "--fail-if", GATE, "--gauge", "yaw"], "made with gauge se3"),
    ],
)
def test_what_can_not_be_judged_is_refused_before_any_work(
    arguments: list[str],
    said: str,
    yesterday: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    old = str(yesterday / "old" / "runs.parquet")
    given = [old if each == "OLD" else each for each in arguments]
    out = tmp_path / "out"
    assert main(["compare", str(yesterday / "runs.yaml"), "--output", str(out), *given]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line
    assert not out.exists()


@pytest.mark.parametrize(
    "path", ["re.8m.position_percent.mean", "re.pooled.position_percent.mean", "ate.yaw_deg.p95"]
)
def test_other_numbers_can_be_judged(path: str, yesterday: Path) -> None:
    values = GateValues(ResultsTable(yesterday / "old" / "runs.parquet"))
    judged = judge([Gate.parse(f"{path} worse than 1 %")], values, values)
    assert [each.verdict for each in judged] == 4 * ["same"]
    assert [each.trials for each in judged] == 4 * [4]
    assert f"`{path}`" in to_markdown(judged, "all | runs", ["the groundtruth changed"])


def test_the_last_digit_is_no_regression(today: Path, yesterday: Path) -> None:
    # Four equal trials have no deviation, and no two machines the same last digit.
    for folder in (today, yesterday):
        for trial in range(4):
            for algorithm in ("good", "bad"):
                for sequence in ("hall", "yard"):
                    write_run(folder / algorithm / f"{sequence}_trial{trial}.txt", 1.02)
    shutil.copytree(yesterday, today.with_name("equal"))
    old = table(today.with_name("equal") / "old", today.with_name("equal") / "runs.yaml")
    before = GateValues(ResultsTable(old))
    after = GateValues(ResultsTable(old))
    for row in after._rows:
        row["rmse"] = None if row["rmse"] is None else row["rmse"] * (1.0 + 4e-16)
    judged = judge([Gate.parse("ate.position_m.rmse worse than 2 MAD")], before, after)
    assert {each.verdict for each in judged} == {"same"}


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
        for trial in range(4):
            (copy / "bad" / f"yard_trial{trial}.txt").write_text("nothing\n")
        table(copy / "old", copy / "runs.yaml")
    found = verdicts(
        today.with_name(f"{today.name}_failed"), yesterday.with_name(f"{yesterday.name}_failed")
    )
    assert found["bad", "yard"] == "failed"
    assert found["bad", "hall"] == "same"
