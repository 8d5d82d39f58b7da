"""Commands of definitions, which give their numbers, and the verb with its messages."""

from __future__ import annotations

import json
import math
import re
from collections import defaultdict
from itertools import combinations
from pathlib import Path
from typing import Any

import pytest
from explained_pairs import files, sides, values

from trajeval_ros.cli.app import main
from trajeval_ros.explanation.definition import Command, Definition, command_of
from trajeval_ros.io.results.requirement import Requirement


def entry(run: dict[str, Any], lengths: list[str], path: str) -> float:
    """Return an entry of a run by its path, as `--require` reads it."""
    sentence = Requirement(path, "<", -math.inf).unmet(run, lengths)
    assert "not met" in sentence, sentence
    value: Any = run
    for key in path.split("."):
        if isinstance(value, dict) and "pooled" in value and key != "pooled":
            value = value["segments"][lengths.index(key)]
        else:
            value = value[key]
    return float(value)


def computed(command: Command, formulas: list[str], pair: str, folder: Path) -> list[float]:
    """Run a command as a process would, and return the values of formulas of its result."""
    truth, estimate = map(str, files(pair))
    given = [estimate, truth] if command.exchanged else [truth, estimate]
    (folder / "protocol.yaml").write_text(command.file or "base: evo\n", encoding="utf-8")
    here = {"protocol.yaml": str(folder / "protocol.yaml")}
    options = [here.get(word, word) for word in command.options]
    saved = folder / "result.json"
    assert main(["evaluate", *given, *options, "--quiet", "--json", str(saved)]) == 0
    result = json.loads(saved.read_text(encoding="utf-8"))
    (run,) = result["runs"]
    lengths = [
        f"{segment['frames']}f" if "frames" in segment
        else f"{segment['duration_s']:g}s" if "duration_s" in segment
        else f"{segment['length_m']:g}m"
        for segment in (run["re"] or {"segments": []})["segments"]
    ]  # fmt: skip
    if lengths and "rpg" in options and "--lengths" not in options:
        lengths = ["10%", "20%", "30%", "40%", "50%"]

    def number(match: re.Match[str]) -> str:
        path = match[0]
        if path == "groundtruth.path_length_m":
            return repr(result["groundtruth"]["path_length_m"])
        return repr(entry(run, lengths, path))

    names = r"(?:ate|re|groundtruth)\.[\w.%]+"
    return [
        float(eval(re.sub(names, number, formula), {"sqrt": math.sqrt})) for formula in formulas
    ]


def axes(pair: str) -> tuple[str, str]:
    truth, estimate = sides(pair)
    return truth.up.name, estimate.up.name


def commands_of(pair: str) -> dict[Command, list[tuple[Definition, float]]]:
    """Return all definitions and their values by their command, whatever the formula."""
    places, numbers = values(pair)
    actual = defaultdict(list)
    for definition, place in places.items():
        command = command_of(definition, axes(pair))
        if isinstance(command, Command):
            actual[command._replace(formula="")].append((definition, numbers[place]))
    return actual


PAIRS = ["drone_loop", "mono_scale", "handheld_gaps", "car_kitti"]


@pytest.mark.slow
def test_commands_give_their_values(tmp_path: Path) -> None:
    """Those with every two of the options that stand together, each on one of its pairs."""
    pairs = defaultdict(list)
    named = {pair: commands_of(pair) for pair in PAIRS}
    for pair in PAIRS:
        for command in named[pair]:
            pairs[command].append(pair)
    assert len(pairs) > 300
    shown: set[tuple[object, object]] = set()
    for number, (command, having) in enumerate(pairs.items()):
        together = {*combinations((*command.options, command.file, command.exchanged), 2)}
        if together <= shown:
            continue
        shown |= together
        pair = having[number % len(having)]
        printed = [command_of(item, axes(pair)) for item, _ in named[pair][command]]
        formulas = [item.formula for item in printed if isinstance(item, Command)]
        got = computed(command, formulas, pair, tmp_path)
        for (definition, value), computed_value in zip(named[pair][command], got, strict=True):
            assert value == pytest.approx(computed_value, rel=1e-9, abs=1e-9), definition


@pytest.mark.slow
@pytest.mark.parametrize(
    ("alignment", "statistic", "reason"),
    [
        ("se3", "last", "it is the last position_m of errors.npz"),
        ("scale of sim3, then se3 by the first state", "rmse", "trajeval trajectory --scale"),
    ],
)
def test_a_definition_without_a_command_is_named_with_the_reason(
    alignment: str, statistic: str, reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    places, numbers = values("handheld_gaps")
    value = numbers[places[Definition("evo", alignment, "position_m", statistic)]]
    call = [*map(str, files("handheld_gaps")), f"{value:.8f}", "--unit", "m"]
    _, text = run_verb(call, capsys)
    assert f"{value:.6g} m  position {statistic}, {alignment}" in text
    first = text.partition(f", {alignment}")[2].splitlines()[2]
    assert "no command gives this number" in first
    assert reason in first
    _, text = run_verb([*call, "--json", "-"], capsys)
    (number,) = json.loads(text)["matches"][0]["numbers"]
    assert number["command"] is None
    assert reason in number["no_command"]


def test_a_protocol_file_is_printed_as_yaml_on_one_line(
    capsys: pytest.CaptureFixture[str],
) -> None:
    places, numbers = values("handheld_gaps")
    definition = Definition("evo", "scale of sim3 alone", "position_m", "rmse")
    command = command_of(definition, axes("handheld_gaps"))
    assert isinstance(command, Command)
    value = f"{numbers[places[definition]]:.8f}"
    call = [*map(str, files("handheld_gaps")), value, "--unit", "m"]
    _, text = run_verb(call, capsys)
    assert f"protocol.yaml: {{{', '.join(command.file.splitlines())}}}" in text
    assert command.file.splitlines()[0] == "base: evo"


def run_verb(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    status = main(["explain", *arguments])
    captured = capsys.readouterr()
    return status, captured.out + captured.err


@pytest.mark.slow
def test_the_verb_prints_definition_and_command(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    pair = [str(file) for file in files("handheld_gaps")]
    places, numbers = values("handheld_gaps")
    rmse = numbers[places[Definition("evo", "se3 by the first state", "position_m", "rmse")]]
    status, text = run_verb([*pair, f"{rmse:.5f}", "--unit", "m"], capsys)
    assert status == 0
    assert "named" in text
    assert f"{rmse:.6g} m  position rmse, se3 by the first state" in text
    assert (
        f"trajeval evaluate {' '.join(pair)} --protocol evo --gauge se3 --align-states 1" in text
    )
    status, text = run_verb([*pair, f"{rmse:.5f}", "--json", "-"], capsys)
    assert status == 0
    assert json.loads(text)["matches"][0]["numbers"][0]["command"]["formula"] == (
        "ate.position_m.rmse"
    )
    status, text = run_verb([*pair, f"{rmse * 1.7:.7f}"], capsys)
    assert status == 3
    assert "no definition gives this" in text
    assert "set --unit" in text
    _, text = run_verb([*pair, f"{rmse:.5f}m", "--with", "1.25deg"], capsys)
    assert "set --unit" not in text
    saved = tmp_path / "found.json"
    assert run_verb([*pair, f"{rmse:.1g}", "--unit=m", f"--json={saved}"], capsys)[0] == 3
    assert json.loads(saved.read_text(encoding="utf-8"))["verdict"] in ("possible", "chance")


@pytest.mark.slow
def test_yaml_keeps_zeros_and_equals_the_options(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (a, b), (c, d) = files("drone_loop"), files("slow_gt")
    runs = tmp_path / "runs.yaml"
    runs.write_text(
        f"unit: m\nruns:\n  - {{groundtruth: {a}, estimate: {b}, number: 0.30}}\n"
        f"  - {{groundtruth: {c}, estimate: {d}, number: [0.20]}}\n",
        encoding="utf-8",
    )
    options = ["--unit", "m", "--run", str(a), str(b), "0.30", "--run", str(c), str(d), "0.20"]
    by_yaml = run_verb([str(runs), "--json", "-"], capsys)
    assert by_yaml == run_verb([*options, "--json", "-"], capsys)
    shorter = [option.replace("0.20", "0.2") for option in options]
    assert by_yaml != run_verb([*shorter, "--json", "-"], capsys)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "the number needs its run"),
        (["a.txt", "b.txt"], "the number needs its run"),
        (["a.txt", "b.txt", "0.2", "--run", "a", "b", "1"], "the number needs its run"),
        (["no.yaml"], "no.yaml can't be read"),
        (["a.txt", "b.txt", "0.2", "--unit", "ft"], "a.txt"),
    ],
)
def test_wrong_calls_are_one_sentence(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    status, text = run_verb(arguments, capsys)
    assert status == 2
    assert message in text
    assert text.count("\n") == 1


@pytest.mark.parametrize(
    "content",
    ["runs: [3]", "runs: [{groundtruth: a, estimate: b}]", "run: []", "unit: m\nruns: []"],
)
def test_wrong_yaml_is_one_sentence(
    content: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "runs.yaml"
    path.write_text(content, encoding="utf-8")
    status, text = run_verb([str(path)], capsys)
    assert status == 2
    assert text.count("\n") == 1
