"""Names as they come from elsewhere: every format shows them, and obeys none."""

from __future__ import annotations

import csv
import io
import re
from html.parser import HTMLParser

import pytest
from control_characters import controls
from hypothesis import example, given
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from trajeval_ros.formatting.escaping import csv_text, latex_text, markdown_text, one_line, visible
from trajeval_ros.formatting.numbers import (
    change_percent,
    data_size,
    degrees,
    metres,
    one_digit,
    significant,
    three_decimals,
    whole_percent,
    with_unit,
)
from trajeval_ros.formatting.text_tables import (
    BOLD,
    MarkedText,
    csv_table,
    html_table,
    latex_table,
    markdown_table,
)
from trajeval_ros.report.console import WARNING, Console, Table, console, show

ATTACK = "\x1b]0;x\x07\x9b31m\u202egnp.exe\u2028\x7f"
SHOWN = r"\x1b]0;x\x07\x9b31m\u202egnp.exe\u2028\x7f"
SPECIAL = "\\`*_{}[]()<>#+-.!|&~$=@'\"\t\r\n\x00\x1b\x85\u202e\u2066 \udc80aé1"
NAMES = st.text(st.one_of(st.sampled_from(SPECIAL), st.characters()), max_size=20)


def paragraphs(line: str) -> list[str]:
    """Return the texts that Markdown shows of a line, whatever they are in."""
    return [
        "".join(child.content for child in token.children or ())
        for token in MarkdownIt("gfm-like", {"linkify": False}).parse(line)
        if token.type == "inline"
    ]


@given(NAMES)
def test_nothing_is_left_to_obey(name: str) -> None:
    assert not controls(one_line(name))
    assert set(controls(visible(name))) <= {"\n"}
    assert visible(name).count("\n") == name.count("\n")


def test_control_characters_are_shown() -> None:
    assert visible(ATTACK) == SHOWN
    assert one_line("a\nb\tc") == r"a b\x09c"
    assert visible("ünïcödé – φ † 軌跡 /vio/odometry") == "ünïcödé – φ † 軌跡 /vio/odometry"


@given(st.lists(st.tuples(NAMES, NAMES), min_size=1, max_size=4))
@example([("a_b_", "[x](http://y)")])
@example([("![x][y]", "<b>&amp;</b>")])
def test_markdown_shows_what_a_cell_holds(rows: list[tuple[str, str]]) -> None:
    lines = markdown_table(["name", "text"], rows)
    assert len(lines) == 2 + len(rows)
    read = paragraphs("\n".join(lines))
    cells = [one_line(cell).strip() for row in rows for cell in row]
    assert [item.strip() for item in read[2:]] == cells


@given(NAMES)
def test_markdown_shows_what_a_title_holds(name: str) -> None:
    read = paragraphs(f"### x {markdown_text(name)} x")
    assert read == [f"x {one_line(name)} x"]


def test_markdown_of_plain_names_is_plain() -> None:
    for name in ("MH_01_easy", "position [m]", "vio-2 (0.05–0.32)", "SE(3), 4/5", "30 %"):
        assert markdown_text(name) == name


@given(st.lists(st.tuples(NAMES, st.none() | st.floats(allow_nan=False)), min_size=1))
def test_csv_is_read_back(rows: list[tuple[str, float | None]]) -> None:
    text = csv_table(["name", "value"], rows)
    read = list(csv.reader(io.StringIO(text, newline="")))
    assert len(read) == 1 + len(rows)
    for (name, value), (name_read, value_read) in zip(rows, read[1:], strict=True):
        assert name_read.removeprefix("'") == one_line(name).removeprefix("'")
        assert value_read == "" if value is None else float(value_read) == value


@pytest.mark.parametrize("name", ["=1+1", "+1+1", "-a", "@SUM(A1)", "-1_0x"])
def test_csv_holds_no_formula(name: str) -> None:
    assert csv_text(name) == f"'{name}"


@pytest.mark.parametrize("name", ["-1.5", "+2", "-1e-05", "vio", "a=b", "29/30"])
def test_csv_leaves_numbers_and_words(name: str) -> None:
    assert csv_text(name) == name


@given(NAMES)
def test_latex_has_one_line_for_each_row(name: str) -> None:
    lines = latex_table("a_b", name, ["name", "value"], [[name, MarkedText("1", BOLD)]])
    assert len(lines) == 16
    assert lines[6] == "  \\label{tab:a-b}"
    assert not any(controls(line) for line in lines)
    assert len(re.findall(r"(?<!\\)&", lines[11].replace(r"\textbackslash{}", ""))) == 1
    assert lines[11].endswith("\\textbf{1} \\\\")


@given(NAMES)
def test_html_shows_what_a_cell_holds(name: str) -> None:
    class Reader(HTMLParser):
        def handle_starttag(self, tag: str, attrs: object) -> None:
            del attrs
            assert tag in {"table", "caption", "thead", "tbody", "tr", "th", "td"}

        def handle_data(self, data: str) -> None:
            texts.append(data)

    texts: list[str] = []
    Reader(convert_charrefs=True).feed(html_table("caption", ["heading"], [[name]]))
    assert "".join(texts) == f"captionheading{one_line(name)}"


@given(NAMES)
@example(ATTACK)
@example("[red]x[/] :cat:")
def test_terminal_shows_lines_and_tables(name: str) -> None:
    stream = io.StringIO()
    terminal = console(stream)
    terminal.print(f"line {name}", soft_wrap=True)
    assert stream.getvalue() == f"line {visible(name)}\n"
    table = Table(name, ["name", name], ["value"])
    table.add([name, MarkedText(name, BOLD, name), "1"])
    show(terminal, table)
    assert set(controls(stream.getvalue())) <= {"\n"}


def test_lines_of_a_table_end_without_blanks() -> None:
    stream = io.StringIO()
    table = Table("title", ["name"], ["value"])
    for row in (["a", "10000"], ["longer", ""]):
        table.add(row)
    show(console(stream), table)
    lines = stream.getvalue().splitlines()
    assert lines == [line.rstrip() for line in lines]
    assert lines == ["title", "name    value", "a       10000", "longer"]


@given(st.floats(1e-9, 1e9))
def test_numbers_keep_three_digits(value: float) -> None:
    assert float(three_decimals(value)) == pytest.approx(value, rel=0.05)
    assert float(three_decimals(value)) == pytest.approx(value, rel=5e-3, abs=5.001e-4)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (123456.78, "123456.8"),
        (1000.0, "1000.0"),
        (999.9, "999.900"),
        (0.01, "0.010"),
        (0.0059, "0.00590"),
        (-7.53e-06, "-0.00000753"),
        (7.53e-07, "7.53e-07"),
        (0.0, "0.000"),
    ],
)
def test_tables_have_no_exponents(value: float, text: str) -> None:
    assert three_decimals(value) == text


def test_large_numbers_have_no_exponent() -> None:
    large = [significant(item, 3) for item in (999.4, 1234.5, -2e8, 0.0686)]
    assert large == ["999", "1234", "-200000000", "0.0686"]
    assert with_unit(12345.6, "m") == "12346 m"


def test_a_small_length_or_angle_is_not_zero() -> None:
    assert [metres(1e-5), metres(1.5), metres(None)] == ["0.0000100 m", "1.500 m", "-"]
    assert [degrees(2e-4), degrees(None)] == ["0.000200°", "-"]


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (0.0, "0 %"),
        (1e-9, "1 %"),
        (0.29, "29 %"),
        (0.524, "52 %"),
        (0.868, "87 %"),
        (0.995, "99 %"),
        (0.9999, "99 %"),
        (1.0, "100 %"),
    ],
)
def test_whole_percent(share: float, text: str) -> None:
    assert whole_percent(share) == text


@given(st.integers(0, 100), st.floats(1e-6, 1.0 - 1e-6))
def test_whole_percent_is_all_or_nothing_only_if_it_is(percent: int, more: float) -> None:
    assert whole_percent(percent / 100) == f"{percent} %"
    if percent < 100:
        nearest = percent + (more >= 0.5)
        assert whole_percent((percent + more) / 100) == f"{min(max(nearest, 1), 99)} %"


def test_changes_have_signs_and_sizes_none() -> None:
    assert [change_percent(item) for item in (0.051, -0.5)] == ["+5.1 %", "-50 %"]
    assert change_percent(0.24, sign="") == "24 %"


def test_one_digit_has_an_exponent_from_a_thousand_on() -> None:
    weights = [0.0, 1.0, 500.0, 1e3, 5e3, 1e5, 1e8]
    assert [one_digit(weight) for weight in weights] == [
        "0", "1", "500", "1e3", "5e3", "1e5", "1e8",
    ]  # fmt: skip


@given(
    st.lists(st.tuples(NAMES, st.lists(NAMES, min_size=2, max_size=2)), max_size=4),
    st.integers(10, 90),
)
def test_columns_are_aligned_and_nothing_is_cut(
    rows: list[tuple[str, list[str]]], width: int
) -> None:
    stream = io.StringIO()
    table = Table("", ["name"], ["first number", "second"])
    for name, numbers in rows:
        table.add([name, *numbers])
    show(Console(stream, width, is_terminal=True), table)
    shown = "".join(stream.getvalue().split())
    for name, numbers in rows:
        for cell in (name, *numbers):
            assert all(word in shown for word in one_line(cell).split())


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("variables", "shown"),
    [
        ({"TERM": "xterm"}, "\x1b[33mwarning: late\x1b[0m\n"),
        ({"TERM": "xterm", "NO_COLOR": "1"}, "warning: late\n"),
        ({"TERM": "dumb"}, "warning: late\n"),
    ],
)
def test_warnings_are_yellow_in_a_terminal_that_has_and_may_have_colours(
    variables: dict[str, str], shown: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("TERM", "NO_COLOR"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    for stream, expected in ((Terminal(), shown), (io.StringIO(), "warning: late\n")):
        console(stream).remark(WARNING, "late")
        assert stream.getvalue() == expected


def test_a_narrow_terminal_wraps_numbers_and_marks_what_is_marked() -> None:
    stream = io.StringIO()
    table = Table("", ["name"], ["first", "with blank"])
    table.add(["vio", "1", MarkedText("0.1", BOLD, " (0.05 0.2)")])
    table.add(["自動車", "", "2"])
    table.add_section()
    show(Console(stream, 20, is_terminal=True, is_styled=True), table)
    assert stream.getvalue().replace("\x1b[1m", "<").replace("\x1b[0m", ">").splitlines() == [
        "                <with>",
        "<name>    <first>  <blank>",
        "--------------------",
        "vio         1    <0.1>",
        "               (0.05",
        "                0.2)",
        "自動車             2",
        "--------------------",
    ]


@pytest.mark.parametrize(
    ("text", "printed"),
    [
        ("[9cm]lead", "{}[9cm]lead"),
        ("*star", "{}*star"),
        ("a[1]*", "a[1]*"),
        ("--help", "-{}-help"),
        ("a---b", "a-{}-{}-b"),
        ("1–2", "1--2"),
        ("<b>|", r"\textless{}b\textgreater{}\textbar{}"),
    ],
)
def test_names_are_no_arguments_and_no_ligatures_of_latex(text: str, printed: str) -> None:
    assert latex_text(text) == printed


@pytest.mark.parametrize("name", ["https://evil.org", "WWW.evil.org", "me@evil.org"])
def test_a_name_is_no_link_in_markdown(name: str) -> None:
    shown = markdown_text(name)
    assert shown.replace("\\", "") == name
    assert not re.search(r"\w://|www\.|\w@", shown, re.IGNORECASE)


@given(st.integers(0, 10**16))
def test_sizes_have_three_digits_of_the_number(count: int) -> None:
    number, unit = data_size(count).split()
    power = ("B", "kB", "MB", "GB", "TB").index(unit)
    assert float(number) < 1000.0 or unit == "TB"
    assert float(number) >= 1.0 or count == 0
    assert abs(float(number) * 1000.0**power - count) <= 0.005 * count
