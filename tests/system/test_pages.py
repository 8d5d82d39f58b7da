"""README and the pages in docs: their sentences, links and commands."""

from __future__ import annotations

import re
import shlex
import statistics
import subprocess
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import pytest
from comparison_runs import here
from page_commands import (
    NOT_RUN,
    ROOT,
    commands,
    environment_with_programs,
    make_files,
    outputs,
    pages,
    typed,
    why_not_run,
)
from prose import WIDTH, length, sentences, wrapped

from trajeval_ros.batch import executors, planned_figures
from trajeval_ros.batch.planned_figures import FigureChoice
from trajeval_ros.cli.app import VERBS, main, verb
from trajeval_ros.report import figures

LONGEST, MEDIAN, README_WORDS = 35, 16, 1500
PAGES = {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in pages()}
SOURCES = ("flight", "run")  # of commands without a verb
TYPED = {name: list(commands(text)) for name, text in PAGES.items()}
RUN = {
    name: [item for item in typed if why_not_run(item) is None] for name, typed in TYPED.items()
}


def test_readme_is_short() -> None:
    assert len(PAGES["README.md"].split()) <= README_WORDS


@pytest.mark.parametrize("name", PAGES)
def test_sentences_are_short(name: str) -> None:
    lengths = {sentence: length(sentence) for sentence in sentences(PAGES[name])}
    assert not {item: number for item, number in lengths.items() if number > LONGEST}
    # Fragments of one or two words, such as labels, would make the median look better.
    assert statistics.median(number for number in lengths.values() if number > 2) <= MEDIAN


def test_a_sentence_is_counted_as_a_reader_would() -> None:
    text = (
        "# A heading. With a stop\n\nThe file `a b.txt` has 3.5 m [of path](docs/x.md#y).\n"
        "It ends, e.g. here.\n\n| a | table |\n\n* An item\n  of six words in all\n\n"
        "```console\n$ no prose.\n```\n"
    )
    result = sentences(text)
    assert [length(item) for item in result] == [8, 4, 7]


@pytest.mark.parametrize("name", PAGES)
def test_prose_is_wrapped(name: str) -> None:
    assert wrapped(PAGES[name]) == PAGES[name], "run `make format`"


def test_wrapped_changes_prose_alone() -> None:
    words = "word " * 30
    kept = f"# {words}\n\n| {words}|\n\n    {words}\n\n    code\n\n```text\n{words}\n```\n"
    assert wrapped(kept) == kept
    short = f"* {words}\n  {words}\n\n    1. {words}\n\n{words}\n{words}\n"
    lines = wrapped(short).splitlines()
    assert max(map(len, lines)) <= WIDTH
    assert [line[:6] for line in lines if line] == [
        "* word", "  word", "  word", "    1.", "      ", "word w", "word w", "word w",
    ]  # fmt: skip
    assert wrapped(short).split() == short.split()


def test_no_line_breaks_in_code_or_before_a_sign_of_markdown() -> None:
    code = "`" + "word " * 9 + "word`"
    for text in (
        f"{'word ' * 14}{code} end",
        f"{'word ' * 21}word 12. Next",
        f"{'w ' * 54}- minus",
    ):
        before, after = wrapped(text).splitlines()
        assert not after.startswith(("12.", "- "))
        assert before.count("`") in (0, 2)


@pytest.mark.parametrize("name", PAGES)
def test_links_lead_to_files_and_headings(name: str) -> None:
    broken = []
    for target in re.findall(r"\]\((?!https?:|mailto:)([^)\s]+)\)", PAGES[name]):
        file, _, anchor = target.partition("#")
        path = (ROOT / name).parent / file if file else ROOT / name
        if not path.exists() or (anchor and anchor not in _anchors(path)):
            broken.append(target)
    assert not broken


@pytest.mark.parametrize("name", PAGES)
def test_lists_and_tables_are_seen_by_the_site(name: str) -> None:
    """Python-Markdown wants an empty line before them, and four spaces for a list in a list."""
    text = re.sub(r"^```.*?^```", "", PAGES[name], flags=re.MULTILINE | re.DOTALL)
    blocks = [block.splitlines() for block in re.split(r"\n\s*\n", text)]
    begins = re.compile(r"([*-]|\d+\.) |\|")
    joined = [
        line
        for lines in blocks
        for before, line in pairwise(lines)
        if begins.match(line) and not re.match(r"([*-]|\d+\.) |\||    |  ", before)
    ]
    shallow = re.findall(r"^ {1,3}(?:[*-]|\d+\.) .*", text, re.MULTILINE)
    headless = [
        lines[0]
        for lines in blocks
        if lines and lines[0].startswith("|") and not "".join(lines[1:2]).startswith("|--")
    ]
    assert not joined + shallow + headless


def _anchors(path: Path) -> set[str]:
    headings = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_every_page_is_on_the_site() -> None:
    listed = set(re.findall(r": ([\w/]+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE))
    written = {name.removeprefix("docs/") for name in PAGES if name != "README.md"}
    assert {item for item in listed if not item.startswith("generated/")} == written


@pytest.mark.parametrize("name", [name for name, typed in TYPED.items() if typed])
def test_every_command_can_be_typed(name: str) -> None:
    """Whether it has a verb and options that exist; this runs nothing."""
    assert len(TYPED[name]) > 0
    for command in TYPED[name]:
        words = shlex.split(command, comments=True)
        if words[0] == "trajeval":
            if words[1].partition(".")[0] in SOURCES:
                words.insert(1, "evaluate")
            count = 2 if words[1] in VERBS else 3
            name = " ".join(words[1:count])
            assert name in VERBS, command
            context = verb(name).make_context(name, words[count:], resilient_parsing=False)
            assert context.params
        elif why_not_run(command) is None:
            assert words[0] in ("cp", "sed"), f"{command}: no test runs it, and no reason is given"


def test_an_output_belongs_to_the_commands_before_it() -> None:
    text = "```console\n$ a b \\\n    c\n$ d\n```\nIt prints:\n\n```text\none\ntwo\n```\n"
    assert list(outputs(text)) == [(["a b c", "d"], ["one", "two"])]
    assert list(outputs(text.replace("text", "yaml"))) == []
    assert list(outputs(PAGES["README.md"]))


def test_reasons_are_of_commands_that_stand_somewhere() -> None:
    typed = [item for result in TYPED.values() for item in result]
    assert not [begin for begin in NOT_RUN if not any(item.startswith(begin) for item in typed)]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("files")
    make_files(folder)
    return folder


# What a command ends with, where that isn't 0.
STATUS = {"--fail-on": (0, 1), "--fail-if": (0, 1)}
# A process takes a second to start, so commands without a pipe and the like run in this one.
FOR_A_SHELL = re.compile(r"[|<>;&$*?~{]")


def _run_here(command: str, capsys: pytest.CaptureFixture[str], allowed: Sequence[int]) -> str:
    """Run a command of `trajeval` in this process, and return what it prints."""
    status = main(shlex.split(command, comments=True)[1:])
    message = "".join(capsys.readouterr())
    assert status in allowed, f"{command}\n{message}"
    return message


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, typed in RUN.items() if typed])
def test_commands_run_as_they_stand(
    name: str,
    files: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """One after the other, in a folder with the files that they name; they print what is shown."""
    for package in ("matplotlib", "pyarrow", "jinja2"):
        pytest.importorskip(package, reason=f"{package} is missing")
    folder = tmp_path / "work"
    subprocess.run(["cp", "-r", str(files), str(folder)], check=True)
    environment = environment_with_programs(tmp_path / "bin")
    monkeypatch.chdir(folder)
    # Workers of comparisons start slowly, and figures of all runs take most of the time.
    monkeypatch.setattr(executors, "local_pool", lambda _: here())
    monkeypatch.setattr(planned_figures, "FigureChoice", lambda _, kinds: FigureChoice(1, kinds))
    if name != "docs/figures.md":
        monkeypatch.setattr(figures, "outcome_drawings", lambda _: {})
    printed = {}
    assert len(RUN[name]) > 0
    for command in RUN[name]:
        allowed = next((item for word, item in STATUS.items() if word in command), (0,))
        if command.startswith("trajeval ") and not FOR_A_SHELL.search(command):
            printed[command] = _run_here(command, capsys, allowed)
        else:
            printed[command] = typed(command, folder, environment, allowed)
    for shown_after, lines in outputs(PAGES[name]):
        result = "".join(printed.get(command, "") for command in shown_after)
        assert not result or not [line for line in lines if line not in result], result
