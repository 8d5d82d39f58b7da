"""Escaping of foreign text, with one rule per output format.

Names of files, topics and algorithms, and sentences that quote them, are untrusted. They can
contain terminal control sequences, Markdown, LaTeX, or spreadsheet formulas.
"""

from __future__ import annotations

import re

# C0, DEL and C1; line and paragraph separators; characters that change the direction of text;
# bytes of file names that are not UTF-8.
_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
# CommonMark ignores an underscore within a word; a bracket only matters before a link.
_MARKDOWN = re.compile(r"[\\`*<>|&~#$]|\](?=[(\[:])|(?<![^\W_])_|_(?![^\W_])")
_LATEX = {
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "–": "--", "†": r"$^\dagger$", "‡": r"$^\ddagger$", "§": r"$^\S$", "×": r"$\times$",
    "−": "$-$", "±": r"$\pm$", "∞": r"$\infty$", "σ": r"$\sigma$", "φ": r"$\varphi$",
    "…": r"\dots{}",
    **{special: f"\\{special}" for special in "&%$#_{}"},
}  # fmt: skip
_FORMULA = ("=", "+", "-", "@")


def visible(text: str) -> str:
    r"""Return a text with control characters shown, such as `\x1b`; line breaks are kept."""
    return "\n".join(_CONTROL.sub(_code, line) for line in text.split("\n"))


def one_line(text: str) -> str:
    """Return a text with visible control characters on one line, for cells and messages."""
    return visible(text.replace("\n", " "))


def markdown_text(text: str) -> str:
    """Return a text on one line that Markdown shows unchanged."""
    return _MARKDOWN.sub(r"\\\g<0>", one_line(text))


def latex_text(text: str) -> str:
    """Return a text on one line that LaTeX prints unchanged."""
    return "".join(_LATEX.get(character, character) for character in one_line(text))


def csv_text(text: str) -> str:
    """Return a text that spreadsheets take as text or number, not as a formula."""
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
