"""The prose of a Markdown page: its sentences, without code, tables and addresses, and its lines.

`python tests/support/prose.py FILE...` wraps the lines of pages, as `make format` does.
"""

from __future__ import annotations

import re
import sys
import textwrap
from pathlib import Path

WIDTH = 110

_FENCE = re.compile(r"^ *(```|~~~).*?^ *\1 *$", re.MULTILINE | re.DOTALL)
_INDENTED = re.compile(r"(?<=\n\n)(?: {4}(?![*\d-]).*\n)+")
_LINE_TO_SKIP = re.compile(r"^\s*(#|\||!\[|:::|<|\$\$|\[[^\]]+\]:|(---|===)+$)")
_LIST_ITEM = re.compile(r"^\s*([*+-]|\d+\.)\s+")
_LINK = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")
# A full stop ends a sentence, but not in a number, a file's name or these abbreviations.
_ABBREVIATIONS = r"(?<!e\.g)(?<!i\.e)(?<!\beq)(?<!\bvs)(?<!\bet al)(?<!\b[A-Z])"
_UNIT = re.compile(r"`[^`]*`|\$[^$ ][^$]*\$")  # code, or a formula
_GLUE = "\0"  # a space at which no line breaks
_END = re.compile(_ABBREVIATIONS + r"[.?!]['\")*_]*(?=\s|$)")


def paragraphs(text: str) -> list[str]:
    """Return the paragraphs and items of lists, each as one line."""
    text = _INDENTED.sub("", _FENCE.sub("", text))
    result: list[list[str]] = [[]]
    for line in text.splitlines():
        if not line.strip() or _LINE_TO_SKIP.match(line):
            result.append([])
        elif _LIST_ITEM.match(line):
            result.append([_LIST_ITEM.sub("", line)])
        else:
            result[-1].append(line.strip())
    return [" ".join(lines) for lines in result if lines]


def sentences(text: str) -> list[str]:
    """Return the sentences of a page; code in backticks and a formula count as one word each."""
    result = []
    for paragraph in paragraphs(text):
        plain = _UNIT.sub("CODE", _LINK.sub(r"\1", paragraph))
        result += [word.strip() for word in _END.split(plain) if word and word.strip()]
    return result


def length(sentence: str) -> int:
    """Return the number of words and numbers; signs alone are none."""
    return len([word for word in sentence.split() if re.search(r"\w", word)])


def wrapped(text: str) -> str:
    """Return a page with its paragraphs and items of lists wrapped at WIDTH columns.

    Tables, headings and code stay as they are. Lines break neither in code and formulas nor
    before what Markdown takes for the start of a list or a heading.
    """
    result: list[str] = []
    lines: list[str] = []  # of the paragraph that is being read

    def end() -> None:
        if lines:
            result.extend(_filled(lines))
            lines.clear()

    fence, is_code = "", False
    for line in text.splitlines():
        mark = re.match(r" *(```|~~~)", line)
        if line.strip():
            is_code = line.startswith("    ") and not lines and (is_code or _starts_code(result))
        if fence or mark or is_code or not line.strip() or _LINE_TO_SKIP.match(line):
            end()
            result.append(line)
            fence = "" if mark and fence else fence or (mark[1] if mark else "")
        else:
            if _LIST_ITEM.match(line):
                end()
            lines.append(line)
    end()
    return "\n".join(result) + "\n"


def _starts_code(before: list[str]) -> bool:
    """Return whether an indented line is code: after an empty line, and in no list."""
    paragraphs = [line for line in before if line.strip()]
    in_list = paragraphs and (paragraphs[-1].startswith("  ") or _LIST_ITEM.match(paragraphs[-1]))
    return bool(before and not before[-1].strip() and not in_list)


def _filled(lines: list[str]) -> list[str]:
    item = _LIST_ITEM.match(lines[0])
    indent = re.match(r" *", lines[0])[0]  # type: ignore[index]
    hanging = " " * len(item[0]) if item else indent
    start = item[0] if item else indent
    text = " ".join(line.strip() for line in [lines[0][len(start) :], *lines[1:]])
    text = _UNIT.sub(lambda code: code[0].replace(" ", _GLUE), text)
    text = re.sub(r" (?=([*+#>|=-]+|\d+[.)])(\s|$))", _GLUE, text)
    filled = textwrap.wrap(
        text,
        WIDTH,
        initial_indent=start,
        subsequent_indent=hanging,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [line.replace(_GLUE, " ") for line in filled]


if __name__ == "__main__":
    for name in sys.argv[1:]:
        page = Path(name)
        page.write_text(wrapped(page.read_text(encoding="utf-8")), encoding="utf-8")
