"""Foreign text in what is written: shown as it is, never obeyed. One rule for each format.

Names of files, topics and algorithms, and sentences that quote them, come from elsewhere: they may
hold a terminal's control sequences, Markdown, LaTeX, or a spreadsheet's formula.
"""

from __future__ import annotations

import re

# C0, DEL and C1; separators of lines and paragraphs; what embeds, overrides or isolates a
# direction of writing, so that a text looks like another; a file name's bytes that are no UTF-8.
_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
# An underscore within a word means nothing to CommonMark, a bracket only before a link.
_MARKDOWN = re.compile(r"[\\`*<>|&~#$]|\](?=[(\[:])|(?<![^\W_])_|_(?![^\W_])")
_LATEX = {
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "–": "--", "†": r"$^\dagger$", "‡": r"$^\ddagger$", "§": r"$^\S$", "×": r"$\times$",
    "−": "$-$", "±": r"$\pm$", "∞": r"$\infty$", "σ": r"$\sigma$", "φ": r"$\varphi$",
    "…": r"\dots{}",
    **{each: f"\\{each}" for each in "&%$#_{}"},
}  # fmt: skip
_FORMULA = ("=", "+", "-", "@")


def visible(text: str) -> str:
    r"""Return a text with its control characters shown, as `\x1b`; its lines stay lines."""
    return "\n".join(_CONTROL.sub(_code, line) for line in text.split("\n"))


def one_line(text: str) -> str:
    """Return the same in one line, for a cell of a table or a message."""
    return visible(text.replace("\n", " "))


def markdown_text(text: str) -> str:
    """Return a text that Markdown shows as it is, in one line: in a cell, a title or a list."""
    return _MARKDOWN.sub(r"\\\g<0>", one_line(text))


def latex_text(text: str) -> str:
    """Return a text that LaTeX prints as it is, in one line."""
    return "".join(_LATEX.get(each, each) for each in one_line(text))


def csv_text(text: str) -> str:
    """Return a text that a spreadsheet takes as text or number, and never as a formula."""
    line = one_line(text)
    return f"'{line}" if line.startswith(_FORMULA) and not _is_number(line) else line


def _code(match: re.Match[str]) -> str:
    code = ord(match[0])
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
