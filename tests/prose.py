"""The prose of a Markdown page: its sentences, without code, tables and addresses."""

from __future__ import annotations

import re

_FENCE = re.compile(r"^ *(```|~~~).*?^ *\1 *$", re.MULTILINE | re.DOTALL)
_INDENTED = re.compile(r"(?<=\n\n)(?: {4}(?![*\d-]).*\n)+")
_LINE_TO_SKIP = re.compile(r"^\s*(#|\||!\[|:::|<|\[[^\]]+\]:|(---|===)+$)")
_LIST_ITEM = re.compile(r"^\s*([*+-]|\d+\.)\s+")
_LINK = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")
# A full stop ends a sentence, but not in a number, a file's name or these abbreviations.
_ABBREVIATIONS = r"(?<!e\.g)(?<!i\.e)(?<!\beq)(?<!\bvs)(?<!\bet al)(?<!\b[A-Z])"
_END = re.compile(_ABBREVIATIONS + r"[.?!]['\")*_]*(?=\s|$)")


def paragraphs(text: str) -> list[str]:
    """Return the paragraphs and items of lists, each as one line."""
    text = _INDENTED.sub("", _FENCE.sub("", text))
    found: list[list[str]] = [[]]
    for line in text.splitlines():
        if not line.strip() or _LINE_TO_SKIP.match(line):
            found.append([])
        elif _LIST_ITEM.match(line):
            found.append([_LIST_ITEM.sub("", line)])
        else:
            found[-1].append(line.strip())
    return [" ".join(lines) for lines in found if lines]


def sentences(text: str) -> list[str]:
    """Return the sentences of a page; what stands in backticks counts as one word."""
    found = []
    for paragraph in paragraphs(text):
        plain = re.sub(r"`[^`]*`", "CODE", _LINK.sub(r"\1", paragraph))
        found += [each.strip() for each in _END.split(plain) if each and each.strip()]
    return found


def length(sentence: str) -> int:
    """Return the number of words and numbers; signs alone are none."""
    return len([word for word in sentence.split() if re.search(r"\w", word)])
