"""What a comparison prints and writes: its tables, its page and its figures, as they were kept."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from comparison_runs import compare, write_run, write_runs
from kept import assert_kept

pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
pytest.importorskip("jinja2", reason="Jinja2 is missing, the extra `compare`")

pytestmark = pytest.mark.slow


def without_style(page: str) -> str:
    """Return a page with a tag per line, without styles and figures."""
    text = re.sub(r"<(style|script|svg)\b.*?</\1>", "", page, flags=re.DOTALL)
    return re.sub(r">\s*<", ">\n<", text)


def test_a_comparison_prints_and_writes_what_it_did(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_runs(Path())
    write_run(Path("bad/yard_trial1.txt"), 1.1, count=150, seconds=10.0)
    Path("bad/hall_trial1.txt").unlink()
    assert compare("runs.yaml", figures=2, output=Path("out")) == 0
    written = ["out/tables.md", "out/tables.tex", "out/report.html"]
    texts = [without_style(Path(item).read_text(encoding="utf-8")) for item in written]
    assert_kept("comparison", "\n".join([*capsys.readouterr(), *texts]))


def test_gates_print_what_they_did(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_runs(Path(), ["hall"], ["good"], trials=6)
    assert compare("runs.yaml", "-q", output=Path("old")) == 0
    for trial in range(6):
        write_run(Path(f"good/hall_trial{trial}.txt"), 1.02 + 0.001 * trial)
    gates = ["--fail-if", "ate.position_m.rmse worse than 5 %", "--fail-if", "re.8m.position_"
             "percent.mean worse than 5 %", "--baseline", "old/runs.parquet"]  # fmt: skip
    assert compare("runs.yaml", "-q", *gates, output=Path("new")) == 1
    written = ["new/gates.md", "new/gates.json"]
    texts = [Path(item).read_text(encoding="utf-8") for item in written]
    text = "\n".join([*capsys.readouterr(), *texts])
    assert_kept("gates", text)
