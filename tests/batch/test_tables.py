"""Tables of algorithms by columns: what is best, and what LaTeX and Markdown make of names."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.batch.summary_tables import definition
from trajeval_ros.formatting.escaping import latex_text
from trajeval_ros.report.console import console, show
from trajeval_ros.report.matrix import (
    Cell,
    Matrix,
    ranked,
    to_csv,
    to_latex,
    to_markdown,
    to_terminal,
    with_equal_decimals,
)

VALUES = st.none() | st.just(math.inf) | st.floats(1e-6, 1e6)


def matrix(values: list[list[float | None]], name: str = "vio_{}") -> Matrix:
    rows = tuple(
        (name.format(row), tuple(Cell(cell) for cell in cells)) for row, cells in enumerate(values)
    )
    columns = tuple(f"MH_0{place}" for place in range(len(values[0])))
    count = len(values)
    return Matrix("t", "ATE [%]", ("By 100 %.",), columns, rows, ("1/2",) * count, (0.5,) * count)


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
        known = sorted({cell for cell in cells if cell is not None and cell < math.inf})
        among = sum(cell is not None for cell in cells)
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
    show(console(stream), to_terminal(table))
    assert "failed" in stream.getvalue()
    rows = list(csv.reader(io.StringIO(to_csv(table))))
    assert rows[1:] == [
        ["vio_0", "0.2", "3.0", "1/2", "0.5", ""],
        ["vio_1", "0.1", "", "1/2", "0.5", ""],
        ["vio_2", "inf", "2.0", "1/2", "0.5", ""],
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


@pytest.mark.parametrize("transpose", [False, True])
@pytest.mark.parametrize("columns", [2, 4, 11])
def test_latex_compiles_as_pasted_and_fits_the_page(
    columns: int, transpose: bool, tmp_path: Path
) -> None:
    program = shutil.which("tectonic") or shutil.which("pdflatex")
    if program is None:
        pytest.skip("there is no LaTeX")
    values = [[0.1 * row + place for place in range(columns)] for row in range(4)]
    values[3][-1], values[2][0] = math.inf, None
    table = matrix(values, r"odd_na&me%{}\~^#$–†" if columns == 2 else "vio_{}")
    euroc = [f"MH_0{place}_difficult" for place in range(columns)]
    table = dataclasses.replace(table, columns=tuple(euroc), has_average=True)
    text = to_latex(table, transpose=transpose)
    packages = re.findall(r"\\usepackage\{.*?\}", text)
    # As IEEE's pages: two columns, 7.16 inches together.
    head = (
        "\\documentclass[twocolumn,10pt]{article}\\usepackage[textwidth=7.16in]{geometry}"
        f"{''.join(packages)}\\begin{{document}}"
    )
    (tmp_path / "a.tex").write_text(f"{head}\n{text}\\end{{document}}\n")
    command = [program, *(["-interaction=nonstopmode"] if "pdflatex" in program else []), "a.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert "Overfull" not in done.stdout


def test_eleven_sequences_take_both_columns_or_are_rows() -> None:
    table = dataclasses.replace(
        matrix([[float(index) for index in range(11)]] * 3), has_average=True
    )
    wide, tall = to_latex(table), to_latex(table, transpose=True)
    assert r"\begin{table*}" in wide
    assert r"\begin{tabularx}{\textwidth}{l*{14}" in wide
    assert r"\begin{table}" in tall
    assert len([line for line in tall.splitlines() if line.endswith(r"\\")]) == 15
    assert r"MH\_05 & \textbf{5.000} & \textbf{5.000} & \textbf{5.000}" in tall
    assert "average & " in tall


def test_a_table_that_is_too_wide_for_a_column_spans_the_page_and_then_omits_spreads() -> None:
    def to_latex_of(columns: int) -> str:
        values: list[float | None] = [0.1 * index for index in range(1, columns + 1)]
        table = matrix([values] * 3)
        rows = tuple(
            (name, tuple(dataclasses.replace(cell, extremes=(0.05, 0.32)) for cell in cells))
            for name, cells in table.rows
        )
        return to_latex(dataclasses.replace(table, rows=rows))

    for columns, is_wide, has_spread in ((1, False, True), (3, True, True), (9, True, False)):
        text = to_latex_of(columns)
        assert ("table*" in text, "0.05" in text) == (is_wide, has_spread)


def test_the_average_is_of_all_columns_or_none() -> None:
    table = matrix([[1.0, 3.0], [2.0, None], [1.0, math.inf]])
    assert [cell.value for cell in table.averages()] == [2.0, None, math.inf]


def test_what_leaves_out_more_of_the_way_is_no_winner() -> None:
    cells = [Cell(0.1, "†", is_ranked=False), Cell(0.3), Cell(0.2)]
    assert ranked(cells) == [0, 2, 1]


def test_numbers_that_are_printed_alike_share_a_rank() -> None:
    cells = [Cell(item) for item in (0.12312, 0.12284, 0.1251, 0.12549, 0.3)]
    assert [cell.text for cell in cells[:4]] == ["0.123", "0.123", "0.125", "0.125"]
    assert ranked(cells) == [1, 1, 2, 2, 0]
    unranked = Cell(0.12271, is_ranked=False, why_unranked="covers 20 %")
    assert ranked([*cells, unranked]) == [1, 1, 0, 0, 0, 0]


@pytest.mark.parametrize(
    ("time_offset", "hand_eye", "message"),
    [
        ("0", "none", "gaps up to 0.5 s."),
        ("auto", "none", "and applied if statistically significant: clock offset."),
        ("auto", "auto", "and applied if statistically significant: clock offset and body."),
        ("0", [1.0, 0.0], "gaps up to 0.5 s. With a given hand-eye transform."),
    ],
)
def test_a_caption_names_the_applied_calibration(
    time_offset: str, hand_eye: Any, message: str
) -> None:
    settings = {
        "modality": None,
        "align_states": "all",
        "align_with": "positions",
        "gauge": "se3",
        "common_time_span": False,
        "association": "linear",
        "max_time_difference": 0.01,
        "max_gap": 0.5,
        "continuous_model": "auto",
        "protocol": "default",
    }
    text = definition({**settings, "time_offset": time_offset, "hand_eye": hand_eye})
    assert text.endswith(message)


def test_numbers_of_a_table_have_one_number_of_decimals() -> None:
    for values, texts in (
        ([[0.157, 51.98], [0.0063, None]], ["0.15700", "51.98000", "0.00630", "-"]),
        ([[1234.5, 0.5], [math.inf, 0.0]], ["1234.500", "0.500", "failed", "0.000"]),
        ([[1e-9, 0.2], [0.1, 3.0]], ["1e-09", "0.200", "0.100", "3.000"]),
    ):
        rows = [(str(row), tuple(map(Cell, cells))) for row, cells in enumerate(values)]
        shown = [cell.text for _, cells in with_equal_decimals(rows) for cell in cells]
        assert shown == texts
