"""The conformance kit: its files, its page, its scores, and the package's numbers on it."""

from __future__ import annotations

import functools
import hashlib
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paths import ROOT

KIT = ROOT / "conformance"
CASES = {
    file.parent.name: json.loads(file.read_text())["quantities"]
    for file in sorted(KIT.glob("cases/*/expected.json"))
}


def score(result: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(KIT / "score.py"), *options, str(result)]
    return subprocess.run(command, capture_output=True, text=True)


def written(folder: Path, results: dict[str, Any]) -> Path:
    file = folder / "result.json"
    file.write_text(json.dumps({"tool": "page", "version": "1", "results": results}))
    return file


def test_files_are_those_of_the_list() -> None:
    lines = [line.split("  ") for line in (KIT / "SHA256SUMS").read_text().splitlines()]
    files = {path.relative_to(KIT).as_posix() for path in KIT.glob("cases/*/*")}
    assert {name for _, name in lines} == files
    for digest, name in lines:
        assert hashlib.sha256((KIT / name).read_bytes()).hexdigest() == digest
    assert sum((KIT / name).stat().st_size for name in files) < 1_500_000


@pytest.mark.slow
def test_trajevals_numbers_are_right_or_withheld_where_the_kit_allows(tmp_path: Path) -> None:
    command = [sys.executable, str(KIT / "adapters" / "run_trajeval.py")]
    result = tmp_path / "trajeval.json"
    result.write_text(subprocess.run(command, capture_output=True, check=True, text=True).stdout)
    scored = score(result)
    assert scored.returncode == 0, scored.stdout
    assert "0 wrong, 0 refused, 0 not offered" in scored.stdout


def page() -> dict[str, Any]:
    """Return the functions of the page's code."""
    text = (KIT / "README.md").read_text(encoding="utf-8")
    code = "\n".join(re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL))
    names: dict[str, Any] = {}
    exec(code, names)
    return names


def by_page(code: dict[str, Any], folder: Path, quantities: dict[str, Any]) -> dict[str, Any]:
    """Return the answers of the page's code to the quantities of a case."""
    sides = [code["read"](folder / f"{side}.txt") for side in ("groundtruth", "estimate")]
    absolute = functools.cache(lambda rule, kind: code["absolute"](kind, *paired(rule)[1:]))

    @functools.cache
    def paired(rule: str) -> Any:
        return code[rule](*sides) if rule else (sides[0][0], *sides[0][1:], *sides[1][1:])

    @functools.cache
    def relative(form: str, length: str) -> Any:
        stamps, *poses = paired("")
        along, size = (stamps, 10**9) if length == "1s" else (code["path"](poses[0]), 2)
        return np.array(
            [code["at_end"](form, s, e, *poses) for s, e in code["ends"](along, size)]
        ).T

    def answer(quantity: str) -> Any:
        rule, _, rest = quantity.rpartition(":")
        kind, *words = rest.split(".")
        stamps, *poses = paired(rule)
        if kind == "pairs":
            return len(stamps)
        if kind == "nees":
            covariances = np.loadtxt(folder / "covariance.txt")[:, 1:]
            return code["nees"](poses[0], poses[2], covariances)
        if kind == "kitti":
            return code["kitti"](*poses)[int(words[0] == "r_rel_deg_per_m")]
        if kind == "scale":
            return absolute(rule, "sim3")[2]
        if kind == "relative":
            metric, form, length, statistic = words
            errors = relative(form, length)[int(metric == "rotation_deg")]
            return code["statistics"](errors)[statistic]
        return absolute(rule, words[0])[int(kind == "rotation_deg")][words[1]]

    return {quantity: answer(quantity) for quantity in quantities}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # no scale without motion
def test_code_of_the_page_gives_the_values(tmp_path: Path) -> None:
    code = page()
    results = {
        name: {
            quantity: float(value)
            for quantity, value in by_page(code, KIT / "cases" / name, quantities).items()
            if quantities[quantity]["value"] is not None
        }
        for name, quantities in CASES.items()
    }
    scored = score(written(tmp_path, results))
    assert scored.returncode == 0, scored.stdout
    assert "1393 right, 0 undetermined, 0 wrong, 0 refused, 37 not offered" in scored.stdout


@pytest.mark.parametrize(
    ("answer", "outcome"),
    [
        (0.0315197306396, "1 right"),
        ("0.03151973063957", "1 right"),
        (0.0315197307, "1 wrong"),
        ("undetermined", "1 wrong"),
        (float("nan"), "1 wrong"),
        (True, "1 refused"),
        ("too few poses", "1 refused"),
    ],
)
def test_answers_are_judged(answer: Any, outcome: str, tmp_path: Path) -> None:
    scored = score(written(tmp_path, {"generic": {"position_m.se3.rmse": answer}}))
    assert f" {outcome}" in scored.stdout
    assert scored.returncode == ("wrong" in outcome)


def test_undetermined_is_right_where_a_tool_may_withhold(tmp_path: Path) -> None:
    case = {"rotation_deg.se3.rmse": "undetermined", "rotation_deg.se3.mean": 12.0}
    scored = score(written(tmp_path, {"exact_line": case}))
    assert "0 right, 1 undetermined, 1 wrong" in scored.stdout
    assert "the data do not determine it" in scored.stdout


def test_nan_as_c_prints_it_is_a_wrong_number(tmp_path: Path) -> None:
    file = tmp_path / "result.json"
    text = '{"tool": "c", "results": {"generic": {"position_m.se3.rmse": %s, "scale.sim3": %s}}}'
    file.write_text(text % ("-nan", "inf"))
    assert "2 wrong, 0 refused" in score(file).stdout


@pytest.mark.parametrize(
    "content", ["", "[]", '{"tool": "a"}', '{"tool": "a", "results": {"x": {}}}']
)
def test_a_file_that_is_no_result_is_refused(content: str, tmp_path: Path) -> None:
    file = tmp_path / "result.json"
    file.write_text(content)
    scored = score(file)
    assert scored.returncode == 2
    assert "Traceback" not in scored.stderr
