"""Verdicts of gates on tables of made-up numbers, and how they are written."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
pytest.importorskip("jinja2", reason="Jinja2 is missing, the extra `compare`")
pytest.importorskip("matplotlib", reason="matplotlib is missing, the extra `compare`")

from gate_tables import GATE, as_json, judged, made_table, pooled_word, trials_of

from trajeval_ros.batch.gate import Gate, GateTrials
from trajeval_ros.batch.gates import judge
from trajeval_ros.batch.gates_output import to_markdown
from trajeval_ros.exceptions import SettingsError


@pytest.mark.slow
def test_the_margin_is_what_may_change(tmp_path: Path) -> None:
    before, now = trials_of(11, 5), trials_of(11, 5, 1.3, seed=1)
    words = [
        pooled_word(judged(tmp_path, before, now, f"ate.position_m.rmse worse than {item} %"))
        for item in (0, 10, 30, 60, 100)
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
    judgement = judged(tmp_path, before, {name: item[:3] for name, item in before.items()})
    assert not judgement.fails
    assert {number.verdict for number in judgement.gates[0].numbers} == {"undecided"}
    assert [number.trials for number in judgement.gates[0].numbers] == [(10, 3)] * 3
    assert (judgement.failures.before, judgement.failures.now) == ((0, 30), (0, 9))


def test_a_failed_run_alone_is_no_alarm_and_many_are(tmp_path: Path) -> None:
    before, now = trials_of(11, 5), trials_of(11, 5, seed=1)
    now["s3"][2] = None
    assert not judged(tmp_path, before, now).fails
    for index in range(11):
        now[f"s{index}"][index % 5] = None
    judgement = judged(tmp_path, before, now)
    assert judgement.failures.verdict == "more failures"
    assert judgement.failures.now == (12, 55)  # one of s3 beside one of each
    text = to_markdown(judgement, "runs", [])
    assert text.startswith(("### runs: more failed runs\n", "### runs: worse\n"))
    assert "**more failures**" in text
    # As many as before are none more.
    assert not judged(tmp_path, now, now).fails


def test_failed_runs_have_a_verdict_of_their_own_and_no_values(tmp_path: Path) -> None:
    before = trials_of(11, 5)
    now: dict[str, list[float | None]] = {
        name: [item[0], item[1], None, None, None] for name, item in before.items()
    }
    judgement = judged(tmp_path, before, now)
    assert pooled_word(judgement) == "no worse"
    assert judgement.verdict == "more failures"
    assert {number.medians[1] for number in judgement.gates[0].numbers} == {math.inf}
    assert {number.trials for number in judgement.gates[0].numbers} == {(5, 5)}


@pytest.mark.parametrize(
    ("trials", "now", "enough", "more"),
    [(1, 1, 4, 38), (2, 2, 4, 6), (3, 3, 4, 2), (10, 1, 4, 1)],
)
def test_too_few_trials_of_one_number_are_undecided_and_say_how_many_decide(
    trials: int, now: int, enough: int, more: int, tmp_path: Path
) -> None:
    spread = [1.0 + 0.01 * index for index in range(10)]
    new = [9.0 * item for item in spread[:now]]
    judgement = judged(tmp_path, {"s": list(spread[:trials])}, {"s": list(new)})
    assert not judgement.fails
    assert judgement.verdict == "undecided"
    assert [number.verdict for number in judgement.gates[0].numbers] == ["undecided"]
    pooled = judgement.gates[0].pooled
    assert pooled is not None
    assert (pooled.bounds, pooled.noticeable, pooled.more_trials) == (None, None, more)
    text = to_markdown(judgement, "runs", [])
    assert text.startswith("### runs: inconclusive\n")
    assert "undecided" not in text
    assert "too few trials to decide. A worsening of any size remains inconclusive." in text
    assert f"Use {enough} trials on both sides, or {more} more per value now." in text
    reason = judgement.gates[0].why_it_cannot_fail(judgement.false_alarms)
    assert f"use {enough} trials on both sides, or {more} more per value now" in reason
    # What the sentence advises is enough.
    new = [9.0 + 0.01 * index for index in range(now + more)]
    assert judged(tmp_path, {"s": list(spread[:trials])}, {"s": list(new)}).fails
    assert judged(tmp_path, {"s": list(spread[:enough])}, {"s": list(new[:enough])}).fails or (
        now + more < enough
    )


def test_gates_that_can_fail_are_not_reported(tmp_path: Path) -> None:
    same = trials_of(6, 1)
    for gate in (GATE, f"{GATE} untested"):
        (verdict,) = judged(tmp_path, same, same, gate).gates
        assert not verdict.why_it_cannot_fail(0.025)
    (verdict,) = judged(tmp_path, {"a": [1.0]}, {"b": [9.0]}).gates
    assert verdict.verdict == "lost"
    assert not verdict.why_it_cannot_fail(0.025)


def test_one_trial_of_many_numbers_is_judged_together_alone(tmp_path: Path) -> None:
    judgement = judged(tmp_path, trials_of(11, 1), trials_of(11, 1, 1.5, seed=1))
    assert pooled_word(judgement) == "worse"
    assert {number.verdict for number in judgement.gates[0].numbers} == {"not judged alone"}
    text = to_markdown(judgement, "runs", [])
    assert (
        "1 trial on both sides: too few to test single values; use 5 trials on both sides" in text
    )


def test_five_sequences_with_a_trial_are_too_few_and_six_are_enough(tmp_path: Path) -> None:
    for sequences, word, more in ((5, "undecided", 1), (6, "worse", 0)):
        judgement = judged(tmp_path, trials_of(sequences, 1), trials_of(sequences, 1, 9.0, seed=1))
        pooled = judgement.gates[0].pooled
        assert pooled is not None
        assert (pooled.verdict, pooled.more_trials) == (word, more)


def test_untested_medians_decide_by_the_limit_alone(tmp_path: Path) -> None:
    for factor, is_worse in ((1.04, False), (1.06, True)):
        judgement = judged(tmp_path, {"s": [1.0]}, {"s": [factor]}, f"{GATE} untested")
        assert judgement.fails is is_worse
        assert (judgement.verdict == "no worse") is not is_worse


def test_a_single_number_that_is_worse_is_named_and_no_other(tmp_path: Path) -> None:
    before, now = trials_of(11, 10), trials_of(11, 10, seed=1)
    now["s4"] = [1.5 * item for item in now["s4"] if item is not None]
    worse = [number for number in judged(tmp_path, before, now).gates[0].numbers if number.fails]
    assert [item.group for item in worse] == [("vio", "s4")]
    assert worse[0].noticeable is not None
    assert 0.1 < worse[0].noticeable < 0.5


def test_copies_of_a_run_are_one_trial(tmp_path: Path) -> None:
    before = made_table(tmp_path / "a", {"s": [1.0] * 10}, {"s": ["h"] * 10})
    now = made_table(tmp_path / "b", {"s": [2.0] * 10}, {"s": ["i"] * 10})
    judgement = judge([Gate.parse(GATE)], before, now)
    assert judgement.gates[0].numbers[0].trials == (1, 1)
    assert not judgement.fails
    assert "counted once: 18" in to_markdown(judgement, "runs", [])


@pytest.mark.slow
def test_gates_are_one_family_with_one_level(tmp_path: Path) -> None:
    before, now = trials_of(11, 10), trials_of(11, 10, 1.1, seed=1)
    untested = "association.groundtruth_coverage worse than 50 % untested"
    one = judged(tmp_path, before, now, GATE, untested).gates[0].pooled
    same = judged(tmp_path, before, now, GATE, GATE).gates[0].pooled
    coverage = "association.estimate_coverage worse than 5 %"
    two = judged(tmp_path, before, now, GATE, coverage.replace("estimate", "groundtruth"))
    assert one is not None
    assert same is not None
    assert two.gates[0].pooled is not None
    assert (same.p, same.bounds) == (one.p, pytest.approx(one.bounds))  # twice costs nothing
    assert one.p < two.gates[0].pooled.p <= 3.0 * one.p
    assert one.level == two.gates[0].pooled.level == 0.0125


@pytest.mark.slow
@pytest.mark.parametrize("gates", [1, 2])
def test_bounds_and_verdict_agree(gates: int, tmp_path: Path) -> None:
    others = ["association.groundtruth_coverage worse than 5 %"] * (gates - 1)
    words = set()
    for margin in range(0, 70, 3):
        own = f"ate.position_m.rmse worse than {margin} %"
        judgement = judged(tmp_path, trials_of(5, 4), trials_of(5, 4, 1.3, seed=3), own, *others)
        pooled = judgement.gates[0].pooled
        assert pooled is not None
        assert pooled.bounds is not None
        low, high = pooled.bounds
        assert (pooled.verdict == "worse") is (low > 0.01 * margin)
        assert (pooled.verdict == "no worse") is (high < 0.01 * margin)
        words.add(pooled.verdict)
    assert words == {"worse", "undecided", "no worse"}


@pytest.mark.slow
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


def test_json_says_what_the_markdown_says_with_all_digits(tmp_path: Path) -> None:
    before, now = trials_of(11, 10), trials_of(11, 3, seed=1)
    now["s4"] = [2.0 * item for item in now["s4"] if item is not None]
    untested = "association.groundtruth_coverage worse than 50 % untested"
    judgement = judged(tmp_path, before, now, GATE, untested)
    result = as_json(judgement, 'a "title" | </script>', ["the groundtruth of s0 changed"])
    assert (result["schema"], result["title"]) == ("trajeval-gates/2", 'a "title" | </script>')
    assert result["notes"] == ["the groundtruth of s0 changed"]
    assert (result["verdict"], result["false_alarms"]) == ("worse", 0.025)
    tested, other = result["gates"]
    parts = ("path", "margin", "tested")
    assert [tested[part] for part in parts] == ["ate.position_m.rmse", 0.05, True]
    assert Gate.parse(tested["gate"]) == judgement.gates[0].gate
    pooled = judgement.gates[0].pooled
    assert pooled is not None
    assert pooled.bounds is not None
    assert tested["together"] == {
        "count": 11, "verdict": pooled.verdict, "change": pooled.change,
        "bounds": list(pooled.bounds), "noticeable": pooled.noticeable, "p": pooled.p,
        "level": pooled.level, "more_trials": 0}  # fmt: skip
    low, high = tested["together"]["bounds"]
    assert low < pooled.change < high
    (worse,) = [number for number in tested["numbers"] if number["verdict"] == "worse"]
    medians = [float(np.median(np.array(side["s4"], float))) for side in (before, now)]
    assert worse["sequence"] == "s4"
    assert worse["before"] == {"median": pytest.approx(medians[0], rel=1e-12), "trials": 10}
    assert worse["now"] == {"median": pytest.approx(medians[1], rel=1e-12), "trials": 3}
    assert worse["change"] == pytest.approx(medians[1] / medians[0] - 1.0, rel=1e-12)
    for number in tested["numbers"]:
        assert (number["verdict"] == "worse") is (number["p"] <= number["level"])
        assert 0.0 < number["level"] <= 0.025
    assert (other["together"], other["tested"], other["verdict"]) == (None, False, "no worse")
    assert {number["p"] for number in other["numbers"]} == {None}


def test_json_has_null_for_what_is_not_known(tmp_path: Path) -> None:
    result = as_json(judged(tmp_path, {"s": [1.0]}, {"s": [9.0]}))
    (gate,) = result["gates"]
    assert (gate["verdict"], result["verdict"]) == ("undecided", "undecided")
    assert (gate["together"]["bounds"], gate["together"]["noticeable"]) == (None, None)
    assert (gate["together"]["p"], gate["together"]["more_trials"]) == (0.5, 38)
    before, now = trials_of(11, 1), trials_of(11, 1, 1.5, seed=1)
    (few,) = as_json(judged(tmp_path, before, now))["gates"]
    assert {(number["p"], number["level"], number["noticeable"]) for number in few["numbers"]} == {
        (None, None, None)
    }
    assert few["together"]["more_trials"] == 0
    assert 0.0 < few["together"]["noticeable"] < 1.0


def test_json_says_of_failed_runs_what_the_verdict_on_them_says(tmp_path: Path) -> None:
    before, now = trials_of(11, 5), trials_of(11, 5, seed=1)
    assert as_json(judged(tmp_path, before, now))["failures"]["verdict"] == "undecided"
    for index in range(11):
        now[f"s{index}"] = [1.0, 1.0, None, None, None]
    result = as_json(judged(tmp_path, before, now))
    failures = result["failures"]
    assert failures["before"] == {"failed": 0, "runs": 55}
    assert failures["now"] == {"failed": 33, "runs": 55}
    assert failures["verdict"] == "more failures"
    assert failures["p"] <= failures["level"] == 0.025
    number = result["gates"][0]["numbers"][0]
    assert number["now"] == {"median": None, "trials": 5}
    assert number["change"] is None
    now = {name: [None] * 5 for name in now}
    lost = as_json(judged(tmp_path, before, now))
    assert lost["verdict"] == "lost"
    assert lost["gates"][0]["together"] is None
    assert lost["gates"][0]["numbers"][0]["reason"] == "tracking was lost"


@pytest.mark.slow
def test_one_verdict_of_all_gates(tmp_path: Path) -> None:
    loose, strict = (f"ate.position_m.rmse worse than {item} %" for item in (90, 1))
    before, same = trials_of(11, 5), trials_of(11, 5, seed=1)
    assert judged(tmp_path, before, same, loose).verdict == "no worse"
    assert judged(tmp_path, before, same, loose, strict).verdict == "undecided"
    lost = {**same, "s0": [None] * 5}
    assert judged(tmp_path, before, lost, loose, strict).verdict == "lost"
    worse = {name: [9.0 * item for item in own if item] for name, own in same.items()}
    assert judged(tmp_path, before, {**worse, "s0": [None] * 5}, loose, strict).verdict == "worse"
    failing = {name: [*own[:2], None, None, own[4]] for name, own in before.items()}
    wide = "ate.position_m.rmse worse than 900 % untested"
    assert judged(tmp_path, before, failing, wide).verdict == "more failures"


def of_seeds(factor: float, seed: int, count: int = 6) -> dict[str, list[float | None]]:
    """Return trials of two sequences that vary by their seeds, and a little beside them."""
    noise = np.random.default_rng(seed).lognormal(0.0, 0.01, (2, count))
    shared = np.random.default_rng(0).lognormal(0.0, 0.3, (2, count))
    return {f"s{item}": list(own) for item, own in enumerate(factor * shared * noise)}


@pytest.mark.slow
def test_pairs_show_a_change_that_seeds_hide(tmp_path: Path) -> None:
    before, now = of_seeds(1.0, 1, 9), of_seeds(1.1, 2, 9)
    assert pooled_word(judged(tmp_path, before, now)) == "undecided"
    judgement = judged(tmp_path, before, now, paired=True)
    assert pooled_word(judgement) == "worse"
    assert [number.verdict for number in judgement.gates[0].numbers] == ["worse", "worse"]
    text = to_markdown(judgement, "runs", [])
    assert "Paired by trial name" in text
    assert "is detected in 80 % of comparisons; in a single value, " in text
    (result,) = as_json(judgement)["gates"]
    assert result["paired"] is True
    assert 0.05 < result["together"]["noticeable"] < 0.1
    assert result["together"]["bounds"][0] > 0.05
    same = judged(tmp_path, before, of_seeds(1.0, 2, 9), paired=True)
    assert pooled_word(same) == "no worse"
    few = judged(tmp_path, of_seeds(1.0, 1, 4), of_seeds(1.1, 2, 4), paired=True)
    assert {number.verdict for number in few.gates[0].numbers} == {"not judged alone"}
    assert pooled_word(few) == "worse"


def test_the_same_files_on_both_sides_are_no_worse_by_pairs(tmp_path: Path) -> None:
    before = of_seeds(1.0, 1)
    assert pooled_word(judged(tmp_path, before, before, paired=True)) == "no worse"
    zero = "ate.position_m.rmse worse than 0 %"
    assert not judged(tmp_path, before, before, zero, paired=True).fails


def test_pairs_are_made_by_name_and_copies_of_a_pair_count_once() -> None:
    old = GateTrials({"a": ("h", 1.0), "b": ("i", 2.0), "c": ("h", 1.0)})
    new = GateTrials({"c": ("k", 3.0), "b": ("i", 4.0), "a": ("k", 3.0)})
    before, now = old.paired_with(new, "vio, hall")
    assert (before.values, now.values) == ([1.0, 2.0], [3.0, 4.0])
    assert (before.copies, now.copies) == (1, 1)


def test_pairs_that_can_not_be_made_are_refused(tmp_path: Path) -> None:
    before, now = of_seeds(1.0, 1), of_seeds(1.0, 2)
    less = {**now, "s1": now["s1"][:4]}
    text = "this comparison has no trial '4', '5' of vio, s1"
    with pytest.raises(SettingsError, match=text):
        judged(tmp_path, before, less, paired=True)
    with pytest.raises(SettingsError, match="the baseline has no trial '4', '5' of vio, s1"):
        judged(tmp_path, less, before, paired=True)
    two = [{name: own[:2] for name, own in item.items()} for item in (before, now)]
    with pytest.raises(SettingsError, match=r"has 4 pairs .*2\^-4\); use 6 pairs"):
        judged(tmp_path, two[0], two[1], paired=True)
    # Without a test there is nothing to pair.
    assert not judged(tmp_path, before, less, f"{GATE} untested", paired=True).gates[0].paired
    # A failed run is a trial, and the worse one of its pair.
    assert not judged(tmp_path, before, {**now, "s1": [None, *now["s1"][1:]]}, paired=True).fails


@pytest.mark.parametrize("more", ["", " untested"])
def test_the_last_digit_is_no_regression(more: str, tmp_path: Path) -> None:
    before = trials_of(3, 10)
    now = {name: [x * (1.0 + 4e-16) for x in item if x] for name, item in before.items()}
    equal = {name: [1.0] * 10 for name in before}
    next_digit = {name: [1.0 + 4e-16] * 10 for name in before}
    gate = f"ate.position_m.rmse worse than 0 %{more}"
    assert not judged(tmp_path, before, now, gate).fails
    assert not judged(tmp_path, equal, next_digit, gate).fails


def test_one_number_that_is_worse_takes_the_others_no_worse_away(tmp_path: Path) -> None:
    before = {"s0": [1.0], "s1": [1.0]}
    for factor, is_worse in ((1.0, False), (1.06, True)):
        now = {"s0": [1.0], "s1": [factor]}
        (verdict,) = judged(tmp_path, before, now, f"{GATE} untested").gates
        assert [number.verdict == "worse" for number in verdict.numbers] == [False, is_worse]
        assert verdict.verdict == ("worse" if is_worse else "no worse")
