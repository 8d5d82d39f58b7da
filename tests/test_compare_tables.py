"""Tables of algorithms by columns: what is best, and what LaTeX and Markdown make of names."""

from __future__ import annotations

import csv
import io
import math
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.formatting.escaping import latex_text
from trajeval_ros.report.console import console
from trajeval_ros.report.matrix import (
    Cell,
    Matrix,
    to_csv,
    to_latex,
    to_markdown,
    to_terminal,
)

VALUES = st.none() | st.just(math.inf) | st.floats(1e-6, 1e6)


def matrix(values: list[list[float | None]], name: str = "vio_{}") -> Matrix:
    rows = tuple(
        (name.format(row), tuple(Cell(each) for each in cells)) for row, cells in enumerate(values)
    )
    columns = tuple(f"MH_0{place}" for place in range(len(values[0])))
    count = len(values)
    return Matrix("t", "ATE [%]", "By 100 %.", columns, rows, ("1/2",) * count, (0.5,) * count)


@given(
    st.integers(1, 4).flatmap(
        lambda n: st.lists(st.lists(VALUES, min_size=n, max_size=n), min_size=1, max_size=6)
    )
)
def test_the_least_number_is_the_best_and_the_next_the_second(
    values: list[list[float | None]],
) -> None:
    ranks = matrix(values).ranks()
    for column, cells in enumerate(zip(*values, strict=True)):
        known = sorted({each for each in cells if each is not None and each < math.inf})
        among = sum(each is not None for each in cells)
        for row, value in enumerate(cells):
            rank = ranks[row][column]
            if among < 2 or value is None or math.isinf(value):
                assert rank == 0
            else:
                assert rank == {0: 1, 1: 2}.get(known.index(value), 0)


def test_marks_are_bold_and_underlined_in_every_form() -> None:
    table = matrix([[0.2, 3.0], [0.1, None], [math.inf, 2.0]])
    latex = to_latex(table)
    assert r"\textbf{0.100} & -" in latex
    assert r"\underline{0.200} & \underline{3.000}" in latex
    assert r"failed & \textbf{2.000}" in latex
    markdown = to_markdown(table)
    assert "**0.100** | -" in markdown
    assert "<u>0.200</u> | <u>3.000</u>" in markdown
    stream = io.StringIO()
    console(stream).print(to_terminal(table))
    assert "failed" in stream.getvalue()
    rows = list(csv.reader(io.StringIO(to_csv(table))))
    assert rows[1:] == [
        ["vio_0", "0.2", "3.0", "1/2", "0.5"],
        ["vio_1", "0.1", "", "1/2", "0.5"],
        ["vio_2", "inf", "2.0", "1/2", "0.5"],
    ]


NAMES = st.text(st.characters(codec="ascii", exclude_categories=["Cc"]), min_size=1, max_size=20)


@given(NAMES)
def test_no_name_breaks_a_latex_table(name: str) -> None:
    table = matrix([[0.1], [0.2]], "{}")
    table = Matrix(**{**vars(table), "rows": ((name, table.rows[0][1]), table.rows[1])})
    rows = [line for line in to_latex(table).splitlines() if line.endswith(r"\\")]
    assert len(rows) == 3
    for row in rows:
        assert len(re.findall(r"(?<!\\)&", row.replace("\\\\", ""))) == 3
        assert not re.search(r"(?<!\\)[%#_$]", re.sub(r"\$\^\\dagger\$", "", row))


def test_all_that_means_something_to_latex_is_escaped() -> None:
    assert latex_text(r"a_b%&#${}~^\–†‡") == (
        r"a\_b\%\&\#\$\{\}\textasciitilde{}\textasciicircum{}\textbackslash{}--$^\dagger$$^\ddagger$"
    )


@given(NAMES)
def test_no_name_breaks_a_markdown_table(name: str) -> None:
    table = matrix([[0.1]], "{}")
    table = Matrix(**{**vars(table), "rows": ((name, table.rows[0][1]),)})
    lines = [line for line in to_markdown(table).splitlines() if line.startswith("|")]
    assert len(lines) == 3
    assert {len(re.findall(r"(?<!\\)\|", line)) for line in lines} == {5}


def test_latex_compiles_as_pasted(tmp_path: Path) -> None:
    program = shutil.which("tectonic") or shutil.which("pdflatex")
    if program is None:
        pytest.skip("there is no LaTeX")
    text = to_latex(matrix([[0.1, None], [0.2, math.inf]], r"odd_na&me%{}\~^#$–†"))
    head = "\\documentclass{article}\\usepackage{booktabs}\\begin{document}"
    (tmp_path / "a.tex").write_text(f"{head}\n{text}\\end{{document}}\n")
    command = [program, *(["-interaction=nonstopmode"] if "pdflatex" in program else []), "a.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
