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

from trajeval_ros.batch.gate import Gate
from trajeval_ros.batch.gate_values import GateTrials
from trajeval_ros.batch.gates import judge
from trajeval_ros.batch.gates_markdown import to_markdown
from trajeval_ros.exceptions import SettingsError


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


@pytest.mark.parametrize("more", ["", " untested"])
def test_the_last_digit_is_no_regression(more: str, tmp_path: Path) -> None:
    before = trials_of(3, 10)
    now = {name: [x * (1.0 + 4e-16) for x in each if x] for name, each in before.items()}
    equal = {name: [1.0] * 10 for name in before}
    next_digit = {name: [1.0 + 4e-16] * 10 for name in before}
    gate = f"ate.position_m.rmse worse than 0 %{more}"
    assert not judged(tmp_path, before, now, gate).fails
    assert not judged(tmp_path, equal, next_digit, gate).fails


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
