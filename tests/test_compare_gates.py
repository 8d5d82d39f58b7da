"""Regression gates: what is worse, what is noise, and what was lost."""

from __future__ import annotations

import dataclasses
import json
import math
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from comparison_runs import here, write_run, write_runs

pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
pytest.importorskip("jinja2", reason="Jinja2 is missing, the extra `compare`")
pytest.importorskip("matplotlib", reason="matplotlib is missing, the extra `compare`")

from trajeval_ros.batch.comparison import run_plan
from trajeval_ros.batch.config import plan_of
from trajeval_ros.batch.gate import Gate
from trajeval_ros.batch.gate_values import (
    GateTrials,
    GateValues,
    remarks_on,
    require_same_settings,
)
from trajeval_ros.batch.gate_verdicts import Judgement
from trajeval_ros.batch.gates import judge
from trajeval_ros.batch.gates_json import to_json
from trajeval_ros.batch.gates_markdown import to_markdown
from trajeval_ros.batch.results_table import ResultsTable
from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError, SettingsError

GATE = "ate.position_m.rmse worse than 5 %"


@pytest.mark.parametrize(
    ("text", "gate"),
    [
        (GATE, Gate("ate.position_m.rmse", 5.0)),
        (f"{GATE} + 2 MAD", Gate("ate.position_m.rmse", 5.0, 2.0)),
        ("ate.position_m.rmse worse than 10%", Gate("ate.position_m.rmse", 10.0)),
        (" re.8m.position_m.mean  worse than 1.5 MAD ", Gate("re.8m.position_m.mean", 0.0, 1.5)),
        ("a worse than 2 MAD+5%", Gate("a", 5.0, 2.0)),
        ("association.x worse than 0 % untested", Gate("association.x", 0.0, tested=False)),
        ("a worse than 5 % spread 15 %", Gate("a", 5.0, spread_percent=15.0)),
        ("a worse than 5 % + 2 MAD spread 7.5%", Gate("a", 5.0, 2.0, 7.5)),
    ],
)
def test_gates_are_read_and_written(text: str, gate: Gate) -> None:
    assert Gate.parse(text) == gate
    assert Gate.parse(str(gate)) == gate


@pytest.mark.parametrize(
    ("text", "said"),
    [
        *((each, "is not valid; write it") for each in (
            "", "ate.position_m.rmse < 3", "a worse than", "a worse than 5",
            "a worse than 5 % + 5 %", "a worse than 1.2.3 %", "a worse than much",
            "a worse than . %", "a worse than .. MAD", "a worse than 5 % spread",
            "a worse than 5 % spread 3 % untested", "a worse than untested")),
        ("a worse than 5 % spread 0 %", "write 'untested'"),
        ("association.x worse than 100 %", "below 100 %"),
    ],
)  # fmt: skip
def test_other_words_are_refused(text: str, said: str) -> None:
    with pytest.raises(SettingsError, match=said):
        Gate.parse(text)


def made_table(
    path: Path, trials: dict[str, list[float | None]], hashes: dict[str, list[str]] | None = None
) -> GateValues:
    """Return a table of an algorithm's ATE and coverage by sequence; None is a failed run."""
    import pyarrow
    from pyarrow import parquet

    texts = (
        "status",
        "reason",
        "groundtruth_sha256",
        "estimate_sha256",
        "kind",
        "metric",
        "length",
    )
    statistics = ("mean", "median", "std", "min", "max", "p95", "estimate_coverage")
    rows = []
    for sequence, values in trials.items():
        for trial, value in enumerate(values):
            row = dict.fromkeys(texts) | dict.fromkeys(statistics)
            row |= {"algorithm": "vio", "sequence": sequence, "trial": str(trial)}
            row |= {"rmse": value, "own_groundtruth_coverage": value}
            row |= {"status": "failed", "reason": "tracking was lost"}
            if value is not None:
                own = (hashes or {}).get(sequence) or [f"{value!r} {each}" for each in range(99)]
                row |= {"status": "ok", "reason": None, "kind": "ate", "metric": "position_m"}
                row |= {"groundtruth_sha256": "g", "estimate_sha256": own[trial]}
            rows.append(row)
    metadata = {"trajeval.schema": "trajeval-runs/1", "trajeval.title": "made",
                "trajeval.settings": "{}"}  # fmt: skip
    arrow = pyarrow.Table.from_pylist(rows)
    parquet.write_table(arrow.replace_schema_metadata(metadata), path)
    return GateValues(ResultsTable(path))


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


def trials_of(
    sequences: int, count: int, factor: float = 1.0, spread: float = 0.1, seed: int = 0
) -> dict[str, list[float | None]]:
    generator = np.random.default_rng(seed)
    return {
        f"s{each}": list(factor * generator.lognormal(0.0, spread, count))
        for each in range(sequences)
    }


def judged(
    folder: Path,
    before: dict[str, list[float | None]],
    now: dict[str, list[float | None]],
    *gates: str,
    paired: bool = False,
) -> Judgement:
    tables = (made_table(folder / "old.parquet", before), made_table(folder / "new.parquet", now))
    return judge([Gate.parse(each) for each in gates or (GATE,)], *tables, paired=paired)


def pooled_word(judgement: Judgement) -> str:
    pooled = judgement.gates[0].pooled
    assert pooled is not None
    return pooled.verdict


def test_the_margin_is_what_may_change(tmp_path: Path) -> None:
    before, now = trials_of(11, 5), trials_of(11, 5, 1.3, seed=1)
    words = [
        pooled_word(judged(tmp_path, before, now, f"ate.position_m.rmse worse than {each} %"))
        for each in (0, 10, 30, 60, 100)
    ]
    assert words == ["worse", "worse", "undecided", "no worse", "no worse"]


def test_a_coverage_is_worse_where_it_falls(tmp_path: Path) -> None:
    before, now = trials_of(11, 5, 0.9, 0.01), trials_of(11, 5, 0.8, 0.01, seed=1)
    gate = "association.groundtruth_coverage worse than 5 %"
    assert pooled_word(judged(tmp_path, before, now, gate)) == "worse"
    assert pooled_word(judged(tmp_path, now, before, gate)) == "no worse"
    fallen = judged(tmp_path, before, now, gate.replace("5", "20"))
    assert pooled_word(fallen) == "no worse"
    pooled = fallen.gates[0].pooled
    assert pooled is not None
    assert pooled.change == pytest.approx(-1.0 / 9.0, abs=0.01)


def test_trials_that_were_not_run_again_are_no_failures(tmp_path: Path) -> None:
    before = trials_of(3, 10)
    judgement = judged(tmp_path, before, {name: each[:3] for name, each in before.items()})
    assert not judgement.fails
    assert {each.verdict for each in judgement.gates[0].numbers} == {"undecided"}
    assert [each.trials for each in judgement.gates[0].numbers] == [(10, 3)] * 3
    assert (judgement.failures.before, judgement.failures.now) == ((0, 30), (0, 9))


def test_a_failed_run_alone_is_no_alarm_and_many_are(tmp_path: Path) -> None:
    before, now = trials_of(11, 5), trials_of(11, 5, seed=1)
    now["s3"][2] = None
    assert not judged(tmp_path, before, now).fails
    for each in range(11):
        now[f"s{each}"][each % 5] = None
    judgement = judged(tmp_path, before, now)
    assert judgement.failures.fails
    assert judgement.failures.now == (12, 55)  # one of s3 beside one of each
    text = to_markdown(judgement, "runs", [])
    assert text.startswith(("### runs: more failed runs\n", "### runs: worse\n"))
    assert "**more failures**" in text
    # As many as before are none more.
    assert not judged(tmp_path, now, now).fails


def test_failed_runs_count_as_the_worst_trials(tmp_path: Path) -> None:
    before = trials_of(11, 5)
    now: dict[str, list[float | None]] = {
        name: [each[0], each[1], None, None, None] for name, each in before.items()
    }
    assert pooled_word(judged(tmp_path, before, now)) == "worse"
    assert {each.now for each in judged(tmp_path, before, now).gates[0].numbers} == {math.inf}


def test_one_trial_of_one_number_is_undecided_and_says_what_to_do(tmp_path: Path) -> None:
    judgement = judged(tmp_path, {"s": [1.0]}, {"s": [9.0]})
    assert not judgement.fails
    assert not judgement.is_no_worse
    assert [each.verdict for each in judgement.gates[0].numbers] == ["undecided"]
    text = to_markdown(judgement, "runs", [])
    assert text.startswith("### runs: inconclusive\n")
    assert "undecided" not in text
    assert text.count("inconclusive") == 3  # the head, all values together, and the one value
    assert "1 trial on both sides of one value: too few for a test" in text
    assert "No worsening of any size is detectable." in text


def test_one_trial_of_many_numbers_is_judged_together_alone(tmp_path: Path) -> None:
    judgement = judged(tmp_path, trials_of(11, 1), trials_of(11, 1, 1.5, seed=1))
    assert pooled_word(judgement) == "worse"
    assert {each.verdict for each in judgement.gates[0].numbers} == {"not judged alone"}
    assert "With 10 trials in the baseline and 3 here" in to_markdown(judgement, "runs", [])


def test_a_spread_of_the_user_judges_one_trial(tmp_path: Path) -> None:
    gate = f"{GATE} spread 15 %"
    assert judged(tmp_path, {"s": [1.0]}, {"s": [2.0]}, gate).fails
    same = judged(tmp_path, {"s": [1.0]}, {"s": [1.3]}, gate)
    assert pooled_word(same) == "undecided"
    assert "is given by the user" in to_markdown(same, "runs", [])


def test_untested_medians_decide_by_the_limit_alone(tmp_path: Path) -> None:
    for factor, is_worse in ((1.04, False), (1.06, True)):
        judgement = judged(tmp_path, {"s": [1.0]}, {"s": [factor]}, f"{GATE} untested")
        assert judgement.fails is is_worse
        assert judgement.is_no_worse is not is_worse


def test_a_single_number_that_is_worse_is_named_and_no_other(tmp_path: Path) -> None:
    before, now = trials_of(11, 10), trials_of(11, 10, seed=1)
    now["s4"] = [1.5 * each for each in now["s4"] if each is not None]
    worse = [each for each in judged(tmp_path, before, now).gates[0].numbers if each.fails]
    assert [each.sequence for each in worse] == ["s4"]
    assert worse[0].noticeable is not None
    assert 0.1 < worse[0].noticeable < 0.5


def test_deviations_are_a_further_condition_on_single_numbers(tmp_path: Path) -> None:
    before, now = trials_of(2, 10), trials_of(2, 10, seed=1)
    now["s1"] = [1.5 * each for each in now["s1"] if each is not None]
    verdicts = {}
    for more in ("", " + 1 MAD", " + 20 MAD"):
        judgement = judged(tmp_path, before, now, GATE + more)
        verdicts[more] = (judgement.gates[0].numbers[1].verdict, pooled_word(judgement))
    assert verdicts[""] == verdicts[" + 1 MAD"]
    assert verdicts[""][0] == "worse"
    assert verdicts[" + 20 MAD"] == ("undecided", verdicts[""][1])


def test_copies_of_a_run_are_one_trial(tmp_path: Path) -> None:
    before = made_table(tmp_path / "a", {"s": [1.0] * 10}, {"s": ["h"] * 10})
    now = made_table(tmp_path / "b", {"s": [2.0] * 10}, {"s": ["i"] * 10})
    judgement = judge([Gate.parse(GATE)], before, now)
    assert judgement.gates[0].numbers[0].trials == (1, 1)
    assert not judgement.fails
    assert "counted once: 18" in to_markdown(judgement, "runs", [])


def test_gates_share_the_chance_of_a_false_alarm(tmp_path: Path) -> None:
    before, now = trials_of(11, 10), trials_of(11, 10, seed=1)
    untested = "association.groundtruth_coverage worse than 50 % untested"
    one = judged(tmp_path, before, now, GATE, untested).gates[0].pooled
    two = judged(tmp_path, before, now, GATE, "ate.position_m.rmse worse than 9 %").gates[0].pooled
    assert one is not None
    assert two is not None
    assert two.level == pytest.approx(one.level / 2.0)


def test_what_would_have_been_noticed_stands_beside_every_verdict(tmp_path: Path) -> None:
    for factor in (1.0, 1.02, 1.3, 0.5):
        text = to_markdown(judged(tmp_path, trials_of(11, 5), trials_of(11, 5, factor, seed=1)),
                           "runs", [])  # fmt: skip
        assert "is detected in 80 % of comparisons" in text
        assert "Probability of a false alarm: at most 2.5 %" in text


def test_old_and_new_values_have_a_unit(tmp_path: Path) -> None:
    coverage = "association.groundtruth_coverage worse than 50 % untested"
    text = to_markdown(judged(tmp_path, {"s": [0.25]}, {"s": [0.5]}, GATE, coverage), "runs", [])
    assert "| old [m] | new [m] |" in text
    assert "| vio, s | 0.250 | 0.500 |" in text
    assert "| old [%] | new [%] |" in text
    assert "| vio, s | 25.000 | 50.000 |" in text
    lost = judged(tmp_path, {"s": [0.25]}, {"s": [None]})
    per_metre = Gate("re.8m.rotation_deg_per_m.mean", 5.0)
    gate = dataclasses.replace(lost.gates[0], gate=per_metre)
    text = to_markdown(dataclasses.replace(lost, gates=(gate,)), "runs", [])
    assert "| old [deg/m] | new [deg/m] |" in text
    assert "| 0.250 | failed |" in text


def as_json(judgement: Judgement, title: str = "runs", remarks: Sequence[str] = ()) -> Any:
    """Return the judgement as JSON says it; refuses NaN and infinities."""

    def refused(word: str) -> None:
        raise AssertionError(word)

    text = to_json(judgement, title, remarks)
    assert text == to_json(judgement, title, remarks)
    return json.loads(text, parse_constant=refused)


def test_json_says_what_the_markdown_says_with_all_digits(tmp_path: Path) -> None:
    before, now = trials_of(11, 10), trials_of(11, 3, seed=1)
    now["s4"] = [2.0 * each for each in now["s4"] if each is not None]
    untested = "association.groundtruth_coverage worse than 50 % untested"
    judgement = judged(tmp_path, before, now, f"{GATE} + 1 MAD", untested)
    found = as_json(judgement, 'a "title" | </script>', ["the groundtruth of s0 changed"])
    assert (found["schema"], found["title"]) == ("trajeval-gates/1", 'a "title" | </script>')
    assert found["notes"] == ["the groundtruth of s0 changed"]
    assert (found["verdict"], found["false_alarms"]) == ("worse", 0.025)
    tested, other = found["gates"]
    parts = ("path", "margin", "deviations", "spread", "tested")
    assert [tested[each] for each in parts] == ["ate.position_m.rmse", 0.05, 1.0, None, True]
    assert Gate.parse(tested["gate"]) == judgement.gates[0].gate
    pooled = judgement.gates[0].pooled
    assert pooled is not None
    assert pooled.bounds is not None
    assert tested["together"] == {
        "count": 11, "verdict": pooled.verdict, "change": pooled.change,
        "bounds": list(pooled.bounds), "noticeable": pooled.noticeable, "p": pooled.p,
        "level": pooled.level}  # fmt: skip
    low, high = tested["together"]["bounds"]
    assert low < pooled.change < high
    (worse,) = [each for each in tested["numbers"] if each["verdict"] == "worse"]
    medians = [float(np.median(np.array(side["s4"], float))) for side in (before, now)]
    assert worse["sequence"] == "s4"
    assert worse["before"] == {"median": pytest.approx(medians[0], rel=1e-12), "trials": 10}
    assert worse["now"] == {"median": pytest.approx(medians[1], rel=1e-12), "trials": 3}
    assert worse["change"] == pytest.approx(medians[1] / medians[0] - 1.0, rel=1e-12)
    for each in tested["numbers"]:
        assert (each["verdict"] == "worse") is (each["p"] <= each["level"])
        assert 0.0 < each["level"] <= 0.025
    assert (other["together"], other["tested"], other["verdict"]) == (None, False, "no worse")
    assert {each["p"] for each in other["numbers"]} == {None}


def test_json_has_null_for_what_is_not_known(tmp_path: Path) -> None:
    found = as_json(judged(tmp_path, {"s": [1.0]}, {"s": [9.0]}))
    (gate,) = found["gates"]
    assert (gate["verdict"], found["verdict"]) == ("undecided", "undecided")
    assert (gate["together"]["bounds"], gate["together"]["noticeable"]) == (None, None)
    assert (gate["together"]["p"], gate["advised"]) == (1.0, None)
    before, now = trials_of(11, 1), trials_of(11, 1, 1.5, seed=1)
    (few,) = as_json(judged(tmp_path, before, now))["gates"]
    assert {(each["p"], each["level"], each["noticeable"]) for each in few["numbers"]} == {
        (None, None, None)
    }
    assert few["advised"]["before"] == {"trials": 10}
    least, most = few["advised"]["noticeable"]["alone"]
    assert 0.0 < few["advised"]["noticeable"]["together"] < least <= most


def test_json_says_of_failed_runs_what_the_verdict_on_them_says(tmp_path: Path) -> None:
    before, now = trials_of(11, 5), trials_of(11, 5, seed=1)
    assert as_json(judged(tmp_path, before, now))["failures"]["verdict"] == "undecided"
    for each in range(11):
        now[f"s{each}"] = [1.0, 1.0, None, None, None]
    found = as_json(judged(tmp_path, before, now))
    failures = found["failures"]
    assert failures["before"] == {"failed": 0, "runs": 55}
    assert failures["now"] == {"failed": 33, "runs": 55}
    assert failures["verdict"] == "more failures"
    assert failures["p"] <= failures["level"] == 0.025
    number = found["gates"][0]["numbers"][0]
    assert number["now"] == {"median": None, "trials": 5}
    assert number["change"] is None
    now = {name: [None] * 5 for name in now}
    lost = as_json(judged(tmp_path, before, now))
    assert lost["verdict"] == "lost"
    assert lost["gates"][0]["together"] is None
    assert lost["gates"][0]["numbers"][0]["reason"] == "tracking was lost"


def test_one_verdict_of_all_gates(tmp_path: Path) -> None:
    loose, strict = (f"ate.position_m.rmse worse than {each} %" for each in (90, 1))
    before, same = trials_of(11, 5), trials_of(11, 5, seed=1)
    assert judged(tmp_path, before, same, loose).verdict == "no worse"
    assert judged(tmp_path, before, same, loose, strict).verdict == "undecided"
    lost = {**same, "s0": [None] * 5}
    assert judged(tmp_path, before, lost, loose, strict).verdict == "lost"
    worse = {name: [9.0 * each for each in own if each] for name, own in same.items()}
    assert judged(tmp_path, before, {**worse, "s0": [None] * 5}, loose, strict).verdict == "worse"
    failing = {name: [*own[:2], None, None, own[4]] for name, own in before.items()}
    wide = "ate.position_m.rmse worse than 900 % untested"
    assert judged(tmp_path, before, failing, wide).verdict == "more failures"


def of_seeds(factor: float, seed: int, count: int = 6) -> dict[str, list[float | None]]:
    """Return trials of two sequences that vary by their seeds, and a little beside them."""
    noise = np.random.default_rng(seed).lognormal(0.0, 0.01, (2, count))
    shared = np.random.default_rng(0).lognormal(0.0, 0.3, (2, count))
    return {f"s{each}": list(own) for each, own in enumerate(factor * shared * noise)}


def test_pairs_show_a_change_that_seeds_hide(tmp_path: Path) -> None:
    before, now = of_seeds(1.0, 1, 9), of_seeds(1.1, 2, 9)
    assert pooled_word(judged(tmp_path, before, now)) == "undecided"
    judgement = judged(tmp_path, before, now, paired=True)
    assert pooled_word(judgement) == "worse"
    assert [each.verdict for each in judgement.gates[0].numbers] == ["worse", "worse"]
    text = to_markdown(judgement, "runs", [])
    assert "Paired by trial name" in text
    assert "The detectable worsening is not known for pairs." in text
    (found,) = as_json(judgement)["gates"]
    assert found["paired"] is True
    assert found["together"]["noticeable"] is None
    assert found["together"]["bounds"][0] > 0.05
    same = judged(tmp_path, before, of_seeds(1.0, 2, 9), paired=True)
    assert pooled_word(same) == "no worse"
    few = judged(tmp_path, of_seeds(1.0, 1, 4), of_seeds(1.1, 2, 4), paired=True)
    assert {each.verdict for each in few.gates[0].numbers} == {"not judged alone"}
    assert pooled_word(few) == "worse"


def test_the_same_files_on_both_sides_are_no_worse_by_pairs(tmp_path: Path) -> None:
    before = of_seeds(1.0, 1)
    assert pooled_word(judged(tmp_path, before, before, paired=True)) == "no worse"
    zero = "ate.position_m.rmse worse than 0 %"
    assert not judged(tmp_path, before, before, zero, paired=True).fails


def test_pairs_are_made_by_name_and_copies_of_a_pair_count_once() -> None:
    old = GateTrials([], 0, {"a": ("h", 1.0), "b": ("i", 2.0), "c": ("h", 1.0)})
    new = GateTrials([], 0, {"c": ("k", 3.0), "b": ("i", 4.0), "a": ("k", 3.0)})
    before, now = old.paired_with(new, "vio, hall")
    assert (before.values, now.values) == ([1.0, 2.0], [3.0, 4.0])
    assert (before.copies, now.copies) == (1, 1)


def test_pairs_that_can_not_be_made_are_refused(tmp_path: Path) -> None:
    before, now = of_seeds(1.0, 1), of_seeds(1.0, 2)
    less = {**now, "s1": now["s1"][:4]}
    said = "this comparison has no trial '4', '5' of vio, s1"
    with pytest.raises(SettingsError, match=said):
        judged(tmp_path, before, less, paired=True)
    with pytest.raises(SettingsError, match="the baseline has no trial '4', '5' of vio, s1"):
        judged(tmp_path, less, before, paired=True)
    two = [{name: own[:2] for name, own in each.items()} for each in (before, now)]
    with pytest.raises(SettingsError, match=r"has 4 pairs .*2\^-4\); use 6 pairs"):
        judged(tmp_path, two[0], two[1], paired=True)
    # Without a test there is nothing to pair.
    assert not judged(tmp_path, before, less, f"{GATE} untested", paired=True).gates[0].paired
    # A failed run is a trial, and the worse one of its pair.
    assert not judged(tmp_path, before, {**now, "s1": [None, *now["s1"][1:]]}, paired=True).fails


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
    judgement = judge(
        [Gate.parse(each) for each in gates or (GATE,)],
        GateValues(ResultsTable(yesterday / "old" / "runs.parquet")),
        GateValues(ResultsTable(now)),
    )
    return {(each.algorithm, each.sequence): each.verdict for each in judgement.gates[0].numbers}


def test_the_same_runs_are_not_worse(today: Path, yesterday: Path) -> None:
    assert set(verdicts(today, yesterday).values()) <= {"undecided", "no worse"}


def test_what_is_worse_in_all_trials_is_worse_and_the_other_way_no_worse(
    today: Path, yesterday: Path
) -> None:
    for trial in range(4):
        write_run(today / "good" / f"yard_trial{trial}.txt", 1.05 + 0.001 * trial)
    found = verdicts(today, yesterday)
    assert found["good", "yard"] == "worse"
    assert "worse" not in (found["good", "hall"], found["bad", "yard"], found["bad", "hall"])
    for trial in range(4):
        write_run(today / "good" / f"yard_trial{trial}.txt", 1.002 + 0.0001 * trial)
    assert verdicts(today, yesterday)["good", "yard"] == "no worse"


def test_what_varies_in_both_ways_is_undecided(today: Path, yesterday: Path) -> None:
    for trial, scale in enumerate((1.005, 1.09, 1.0052, 1.092)):
        write_run(today / "good" / f"yard_trial{trial}.txt", scale)
    assert verdicts(today, yesterday)["good", "yard"] == "undecided"


def test_within_the_limit_is_not_worse(today: Path, yesterday: Path) -> None:
    for trial in range(4):
        error = 0.01 * (1.0 + 0.1 * trial + 0.01)
        write_run(today / "good" / f"yard_trial{trial}.txt", 1.0 + 1.04 * error)
    assert verdicts(today, yesterday)["good", "yard"] != "worse"
    for limit, word in ((5, "no worse"), (1, "worse")):
        gate = f"ate.position_m.rmse worse than {limit} % untested"
        assert verdicts(today, yesterday, gate)["good", "yard"] == word


def test_less_coverage_is_worse(today: Path, yesterday: Path) -> None:
    for trial in range(4):
        path = today / "good" / f"yard_trial{trial}.txt"
        path.write_text("\n".join(path.read_text().splitlines()[:200]))
    found = verdicts(today, yesterday, "association.groundtruth_coverage worse than 5 %")
    assert found["good", "yard"] == "worse"
    assert found["bad", "yard"] != "worse"


@pytest.mark.slow
def test_a_sequence_without_numbers_is_lost_and_the_rest_can_not_hide_it(
    today: Path, yesterday: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for trial in range(4):
        (today / "good" / f"yard_trial{trial}.txt").write_text("nothing\n")
    shutil.rmtree(today / "old")
    old = str(yesterday / "old" / "runs.parquet")
    arguments = ["compare", str(today / "runs.yaml"), "--output", str(today / "old")]
    gate = ["--workers", "1", "--baseline", old, "--fail-if", GATE]
    assert main([*arguments, *gate]) == 1
    printed = capsys.readouterr().out
    text = (today / "old" / "gates.md").read_text()
    assert printed.endswith(text)
    assert ": missing values" in text
    row = next(line for line in text.splitlines() if "**missing value**" in line)
    assert row.startswith("| good, yard |")
    assert "yard_trial0.txt" in row
    # The same without the failure: nothing is worse, which isn't evidence that all is well.
    for trial in range(4):
        shutil.copy(yesterday / "good" / f"yard_trial{trial}.txt", today / "good")
    assert main([*arguments, "-q", *gate]) == 0
    assert ": inconclusive" in (today / "old" / "gates.md").read_text()
    assert json.loads((today / "old" / "gates.json").read_text())["verdict"] == "undecided"
    assert main([*arguments, "-q", *gate, "--undecided", "fail"]) == 1
    loose = [*gate[:-1], "ate.position_m.rmse worse than 90 %", "--undecided", "fail"]
    assert main([*arguments, "-q", *loose]) == 0
    assert ": no worse than 90 %" in (today / "old" / "gates.md").read_text()


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
        write_run(today / "good" / f"yard_trial{trial}.txt", 1.05 + 0.001 * trial)
    arguments = ["compare", str(today / "runs.yaml"), "--output", str(today / "old"), "-q"]
    gate = ["--baseline", str(today / "old" / "runs.parquet"), "--fail-if", GATE]
    assert main([*arguments, "--workers", "1", *gate]) == 1
    assert main([*arguments, "--workers", "1", *gate]) == 0
    for more, is_paired in (["--paired"], True), ([], False):
        assert main([*arguments, "--workers", "1", *gate, *more]) == 0
        (found,) = json.loads((today / "old" / "gates.json").read_text())["gates"]
        assert (found["paired"], found["verdict"] == "no worse") == (is_paired, is_paired)


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
            "use one of ate, re",
        ),
        (["--baseline", "OLD", "--fail-if", "association.pairs worse than 5 %"], "'pairs'"),
        (["--baseline", "OLD", "--fail-if", "association worse than 5 %"], "coverage"),
        (["--baseline", "OLD", "--fail-if", "re worse than 5 %"], "no ''"),
        (
            ["--baseline", "OLD", "--fail-if", GATE, "--false-alarms", "0"],
            "--false-alarms 0 is out of range",
        ),
        (["--baseline", "OLD", "--fail-if", GATE, "--undecided", "maybe"], "pass, fail"),
        (["--paired"], "--paired needs --baseline"),
        (["--baseline", "OLD", "--fail-if", f"{GATE} spread 9 %", "--paired"], "also gives one"),
        (["--baseline", "none.parquet", "--fail-if", GATE], "does not exist"),
        (["--baseline", "FOLDER", "--fail-if", GATE], "is a folder; give the runs.parquet in it"),
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
    known = {"OLD": old, "FOLDER": str(yesterday / "old")}
    given = [known.get(each, each) for each in arguments]
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
    judgement = judge([Gate.parse(f"{path} worse than 1 %")], values, values)
    assert not judgement.fails
    assert [each.trials for each in judgement.gates[0].numbers] == 4 * [(4, 4)]
    assert f"`{path} worse" in to_markdown(judgement, "all | runs", ["the groundtruth changed"])


@pytest.mark.parametrize("more", ["", " untested"])
def test_the_last_digit_is_no_regression(more: str, tmp_path: Path) -> None:
    before = trials_of(3, 10)
    now = {name: [x * (1.0 + 4e-16) for x in each if x] for name, each in before.items()}
    equal = {name: [1.0] * 10 for name in before}
    next_digit = {name: [1.0 + 4e-16] * 10 for name in before}
    gate = f"ate.position_m.rmse worse than 0 %{more}"
    assert not judged(tmp_path, before, now, gate).fails
    assert not judged(tmp_path, equal, next_digit, gate).fails


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
    assert found["bad", "hall"] != "worse"


@pytest.mark.parametrize(("asked", "verdict"), [(4.7, "worse"), (5.3, "undecided")])
def test_a_deviation_is_the_median_distance_to_the_baselines_median(
    asked: float, verdict: str, tmp_path: Path
) -> None:
    # Distances are 0 1 1 2 2 3 3 4 4 hundredths, so a deviation is 0.02, without the factor of
    # 1.48 that would make it the standard deviation of a normal distribution.
    steps = [each / 100.0 for each in range(-4, 5)]
    own: list[float | None] = [1.0 + step for step in steps]
    worse: list[float | None] = [1.05 + 5.0 * 0.02 + step for step in steps]
    before, now = {"s0": own, "s1": own, "s2": own}, {"s0": own, "s1": worse, "s2": own}
    judgement = judged(tmp_path, before, now, f"{GATE} + {asked} MAD")
    assert judgement.gates[0].numbers[1].verdict == verdict


def test_one_number_that_is_worse_takes_the_others_no_worse_away(tmp_path: Path) -> None:
    before = {"s0": [1.0], "s1": [1.0]}
    for factor, is_worse in ((1.0, False), (1.06, True)):
        now = {"s0": [1.0], "s1": [factor]}
        (verdict,) = judged(tmp_path, before, now, f"{GATE} untested").gates
        assert [each.verdict == "worse" for each in verdict.numbers] == [False, is_worse]
        assert (verdict.fails, verdict.is_no_worse) == (is_worse, not is_worse)


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
