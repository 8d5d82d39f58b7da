"""The ATE by the number of aligned states: Table III of the tutorial."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest
from paths import TESTS
from strategies import make_pair

from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.io.requests.request_from import request_from
from trajeval_ros.metrics.states_table import FirstStates, parse_first_states
from trajeval_ros.pipeline.pipeline import evaluate, run

PAIRS = TESTS / "data" / "parity" / "pairs"
LIST = "1,25%,50%,75%,all"


def test_shares_are_those_of_the_papers_table() -> None:
    counts = [states.count(1807) for states in parse_first_states(LIST)]
    assert counts == [1, 452, 904, 1355, None]
    assert FirstStates.parse("1%").count(10) == 1


@pytest.mark.parametrize("text", ["1,", "0%,all", "100%", "120%,1", "x%", "nan%", "1,1", "0,all"])
def test_lists_that_mean_nothing_are_refused(text: str) -> None:
    with pytest.raises(SettingsError):
        request_from({"align_states": text})


def test_each_row_is_the_evaluation_by_so_many_states() -> None:
    pair = make_pair(3, 400, smooth=True)
    groundtruth, estimate = pair.groundtruth, pair.estimate
    request = request_from({"gauge": "yaw", "align_states": LIST})
    (outcome,) = run(groundtruth, [estimate], request).runs
    assert [row.states for row in outcome.by_states] == LIST.split(",")
    pairs = len(outcome.evaluation.association)
    for row in outcome.by_states:
        count = FirstStates.parse(row.states).count(pairs)
        alone = evaluate(
            groundtruth, estimate, dataclasses.replace(request.protocol, align_states=count)
        )
        assert row.states_used == alone.alignment.states_used == (count or pairs)
        assert row.position_m == alone.ate["position_m"]
        assert row.rotation_deg == alone.ate["rotation_deg"]
    positions = [row.position_m.rmse for row in outcome.by_states if row.position_m]
    assert len(positions) == 5
    assert min(positions) == positions[-1]  # the least squares are of exactly these errors
    assert outcome.evaluation.protocol.align_states is None


def test_the_command_prints_the_table_and_writes_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [
        f"--{side}={PAIRS / 'mono_scale' / name}.txt"
        for side, name in (("groundtruth", "gt"), ("estimate", "est"))
    ]
    result = tmp_path / "result.json"
    words = ["evaluate", *files, "--modality=mono", f"--align-states={LIST}", f"--json={result}"]
    assert main(words) == 0
    (outcome,) = json.loads(result.read_text(encoding="utf-8"))["runs"]
    first, *others = outcome["by_states"]
    assert first["position_m"] is None
    assert "one state does not determine a scale" in first["reason"]
    assert [row["states_used"] for row in others] == [150, 300, 449, 599]
    assert others[-1]["position_m"] == outcome["ate"]["position_m"]
    printed = capsys.readouterr().out
    assert "aligned by 1: one state does not determine a scale" in printed
    for row in others:
        (line,) = (
            line
            for line in printed.splitlines()
            if line.split()[:1] == [row["states"]] and line.split()[-1] == str(row["states_used"])
        )
        assert f"{row['position_m']['rmse']:.4g}" in line


def test_a_comparison_refuses_the_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    config = tmp_path / "compare.yaml"
    config.write_text(
        f"folder: {PAIRS}\ngroundtruth: '{{sequence}}/gt.txt'\n"
        "runs: {x: '{sequence}/est.txt'}\n"
    )
    assert main(["compare", str(config), "--align-states", LIST]) == 2
    assert "a single value of align states" in capsys.readouterr().err
