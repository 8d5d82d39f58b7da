"""The texts that users read: plain technical English, as docs/style.md describes it.

All string literals of the package are collected from the source: messages of exceptions, warnings,
help texts, headings and reports. Placeholders of f-strings count as one word.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest
from paths import ROOT

from trajeval_ros.cli.app import VERBS, verb
from trajeval_ros.formatting.numbers import counted

PACKAGE = ROOT / "trajeval_ros"
HOLE = "\N{MEDIUM SHADE}"  # stands for a placeholder
LONGEST_ERROR = 240
MOST_WORDS = 35

# What plain technical English has a better word for; the second column says which.
AVOIDED = {
    r"\bsays?\b|\bsaid\b": "report, print, state",
    r"\btells?\b|\btold\b": "report, show",
    r"\bsomebody\b|\bnobody\b|\banybody\b": "the user, or the passive voice",
    r"\banew\b": "again",
    r"\bbeside\b": "next to, with",
    r"\bbegins?\b|\bbeginning\b|\bbegan\b|\bbegun\b": "start",
    r"\bmend(s|ed|ing)?\b": "fix, correct",
    r"\bhonest\b|\bdishonest\b": "consistent",
    r"\bsurer?\b": "consistent, confident",
    r"\b(over|under)-confident\b": "overconfident, conservative",
    r"\bso many\b|\bas many\b": "a number",
    r"\b(is|are) no [a-z]+": "is not a",
    r"\bthere (is|are)\b.* no\b|^there (is|are) no\b": "unknown, no",
    r"\bseems?\b": "is probably",
    r"\bto blame\b|\bmust be known\b": "caused by",
    r"\bhardly\b|\bof late\b|\bin turns\b|\bby turns\b": "a number",
    r"\bto the letter\b|\bout of this world\b": "plain words",
    r"\bworth (nothing|of)\b|\bworth\b": "equivalent to, scored",
    r"\bby chance\b|\btell .* from chance\b": "p-value, statistically significant",
    r"\b(can|could|might|would) bear\b": "acceptable",
    r"\bwould\b|\bmight\b|\bcould be\b": "the present tense",
    r"\bwhoever\b|\bwhatever\b|\bstranger\b": "user, any",
    r"\bknown to\b|\bknows\b|\bremember(s|ed)?\b|\bwants?\b|\bhears?\b": "has, stores, requires",
    r"\bnot to be trusted\b|\bsay nothing\b|\bsays nothing\b": "unreliable",
    r"\bstands still\b|\bstand beside\b": "does not move",
    r"\bcompares? only with\b": "compare only",
    r"\bleave (it |them )?out\b|\bleft out\b": "remove, dropped",
    r"\bwhat (is|was|could be|remains)\b": "a noun",
    r"\bof its own\b|\bof your own\b|\bof one's own\b": "separate",
    r"\bor so\b|\ba little\b|\bfar too\b": "a number",
    r"\bcan't be told\b|\bcan't be seen\b|\bcan't be known\b": "is not detected, is unknown",
    r"\bcut short\b|\bcut off\b": "truncated",
    r"\bcan't read the\b": "is not valid",
    r"(?<!after )(?<![\w-])stamps?\b(?!=)": "timestamp",
    r"\beach\b(?! other)": "every, per",
    r"\bhole\b|\bstretch(es)?\b": "gap, interval",
    r"\bdidn't\b|\bhasn't\b|\bwasn't\b|\baren't\b|\bisn't\b": "is not",
}
# Records that other programs read, and texts of other tools.
_EXEMPT = {
    "io/bags/message_definitions.py",
    "io/bags/sqlite_bag.py",  # SQL
    "formatting/text_tables.py",  # LaTeX
}
_KEEP = {
    "not judged alone",  # a verdict in gates.json
}


@dataclass(frozen=True)
class Text:
    """A literal with its place.

    Attributes:
        file: Relative to the package.
        line: Its first line.
        text: Its characters, with HOLE for placeholders.
        raised: Whether it is the message of an exception.
        number: Whether a count stands before a plural that does not follow it.
    """

    file: str
    line: int
    text: str
    raised: bool
    number: bool

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.text}"


def _docstrings(tree: ast.Module) -> set[int]:
    return {
        id(item.value)
        for node in ast.walk(tree)
        if isinstance(body := getattr(node, "body", None), list)
        for item in body
        if isinstance(item, ast.Expr) and isinstance(item.value, ast.Constant)
    }


def _literal(node: ast.AST) -> str | None:
    """Return the text of a literal, of a sum of literals, or of one of two; None for others."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return re.sub(r"\{[a-z_0-9.]*(:[^{}]*)?\}", HOLE, node.value)  # of `format`
    if isinstance(node, ast.JoinedStr):
        return "".join(_literal(value) or HOLE for value in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return (_literal(node.left) or HOLE) + (_literal(node.right) or HOLE)
    return None


def _counts(node: ast.JoinedStr) -> bool:
    """Return whether a length stands before a plural noun: "1 runs", but not "1 of 2 runs"."""
    before = (None, *node.values)
    for earlier, number, after in zip(before, node.values, node.values[1:], strict=False):
        if (
            not (isinstance(earlier, ast.Constant) and str(earlier.value).endswith(" of "))
            and isinstance(number, ast.FormattedValue)
            and isinstance(number.value, ast.Call)
            and isinstance(number.value.func, ast.Name)
            and number.value.func.id == "len"
            and isinstance(after, ast.Constant)
            and re.match(r" [a-z]+(?<!s)s\b", str(after.value))
        ):
            return True
    return False


def _texts_of(path: Path) -> Iterator[Text]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    inside = _docstrings(tree)
    raised: set[int] = set()
    nodes = list(ast.walk(tree))
    for node in nodes:
        if isinstance(node, ast.JoinedStr):
            inside |= {id(item) for item in ast.walk(node)} - {id(node)}
        if isinstance(node, ast.Call) and _name(node.func).endswith("Error"):
            raised |= {id(end) for argument in node.args for end in _ends(argument)}
    for node in nodes:
        if isinstance(node, ast.JoinedStr | ast.Constant) and id(node) not in inside:
            text = _literal(node)
            if text is not None:
                number = isinstance(node, ast.JoinedStr) and _counts(node)
                yield Text(
                    path.relative_to(PACKAGE).as_posix(),
                    node.lineno,
                    text,
                    id(node) in raised,
                    number,
                )


def _ends(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the literals that an argument can be, or is put together of."""
    if isinstance(node, ast.IfExp):
        yield from _ends(node.body)
        yield from _ends(node.orelse)
    elif isinstance(node, ast.Constant | ast.JoinedStr):
        yield node


def _name(node: ast.AST) -> str:
    return node.id if isinstance(node, ast.Name) else getattr(node, "attr", "")


@cache
def catalogue() -> tuple[Text, ...]:
    """Return all texts that are sentences, or parts of some: three words at least."""
    return tuple(
        text
        for path in sorted(PACKAGE.rglob("*.py"))
        if path.relative_to(PACKAGE).as_posix() not in _EXEMPT
        for text in _texts_of(path)
        if len(re.findall(r"[A-Za-z']{2,}", text.text)) >= 3
        and " " in text.text.strip()
        and text.text not in _KEEP
    )


def raised() -> tuple[Text, ...]:
    """Return the messages of exceptions."""
    return tuple(item for item in catalogue() if item.raised)


def sentences(text: str) -> list[str]:
    """Return the sentences of a text; a semicolon ends one, too."""
    return re.split(r"(?<=[.!?])\s|;\s|\n\n|:\n", text)


def listed(outcome: list[str]) -> str:
    """Return what is wrong, a line each."""
    return "\n" + "\n".join(outcome)


@pytest.mark.slow
def test_there_is_a_catalogue() -> None:
    assert len(catalogue()) > 1000
    assert len(raised()) > 300


@pytest.mark.parametrize("avoided", AVOIDED)
def test_words_to_avoid(avoided: str) -> None:
    pattern = re.compile(avoided, re.IGNORECASE)
    result = [
        f"{item}  <- write: {AVOIDED[avoided]}"
        for item in catalogue()
        if pattern.search(item.text)
    ]
    assert not result, listed(result)


def test_sentences_are_short() -> None:
    result = [
        f"{len(sentence.split())} words: {item}"
        for item in catalogue()
        for sentence in sentences(item.text)
        if len(sentence.split()) > MOST_WORDS
    ]
    assert not result, listed(result)


def test_errors_are_short() -> None:
    result = [
        f"{len(plain)} characters: {item}"
        for item in raised()
        if len(plain := item.text.replace(HOLE, "")) > LONGEST_ERROR
    ]
    assert not result, listed(result)


def test_errors_are_one_sentence_without_a_stop() -> None:
    result = [str(item) for item in raised() if re.search(r"[.?!]$|\?|!$|[^.]\. [A-Z]", item.text)]
    assert not result, listed(result)


def test_errors_start_small() -> None:
    """A message follows a name or the program's: only names and options start otherwise."""
    result = [
        str(item)
        for item in raised()
        if re.match(r"[A-Z][a-z]", item.text)
        and not re.match(r"(Rerun|Dask|La[Tt]e[Xx])", item.text)
    ]
    assert not result, listed(result)


@pytest.mark.slow
def test_examples_of_the_style_guide_are_messages_of_the_program() -> None:
    guide = (PACKAGE.parent / "docs/style.md").read_text(encoding="utf-8")
    section = guide.partition("## Messages")[2].partition("\n## ")[0]
    examples = re.findall(r"^\| [\w ]+ \| `(.*)` \|$", section, re.MULTILINE)
    parts = [part for example in examples for part in example.split("; ")]
    known = [
        re.escape(part).replace(HOLE, ".+")
        for item in catalogue()
        for part in item.text.split("; ")
        if len(re.findall(r"[A-Za-z']{2,}", part)) >= 3
    ]
    install = re.escape("install it: ")
    unknown = [
        part for part in parts if not any(re.search(item, part) for item in [*known, install])
    ]
    assert len(examples) > 3
    assert not unknown, listed(unknown)


def test_numbers_and_nouns_agree() -> None:
    result = [str(item) for item in catalogue() if item.number]
    assert not result, listed(result)


@pytest.mark.parametrize("name", VERBS)
def test_help_of_commands(name: str) -> None:
    command = verb(name)
    first = command.help.split("\n\n")[0]
    assert re.match(r"[A-Z][a-z]+s\b", first), first
    assert first.endswith("."), first
    for paragraph in command.help.split("\n\n"):
        if not paragraph.startswith("    "):
            for sentence in sentences(paragraph):
                assert len(sentence.split()) <= MOST_WORDS, sentence
    for parameter in command.params:
        text = getattr(parameter, "help", None)
        if text and parameter.name not in ("help", "install_completion", "show_completion"):
            assert re.match(r"[A-Z][A-Za-z0-9-]*[ ,.:;]", text), text
            assert text.endswith("."), text
            assert not re.search(r"\beach\b|\bso many\b|\bthose\b|\bbegin\b", text), text


@pytest.mark.parametrize(
    ("count", "expected"), [(0, "0 fixes"), (1, "1 fix"), (2, "2 fixes"), (-1, "-1 fixes")]
)
def test_a_count_and_its_noun(count: int, expected: str) -> None:
    assert counted(count, "fix", "fixes") == expected
    assert counted(count, "run") == expected.replace("fixes", "runs").replace("fix", "run")
