"""Escaping of foreign text, with one rule per output format.

Names of files, topics and algorithms, and sentences that quote them, are untrusted. They can
contain terminal control sequences, Markdown, LaTeX, or spreadsheet formulas.
"""

from __future__ import annotations

import re

# C0, DEL and C1; line and paragraph separators; characters that change the direction of text;
# bytes of file names that are not UTF-8.
_CONTROL = re.compile(
    "[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)
# CommonMark ignores an underscore within a word; a bracket only matters before a link. GitHub
# makes links of URLs, of `www.` and of addresses.
_MARKDOWN = re.compile(
    r"[\\`*<>|&~#$]|\](?=[(\[:])|(?<![^\W_])_|_(?![^\W_])|:(?=//)|(?<=www)\.|@", re.IGNORECASE
)
_LATEX = {
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "–": "--", "†": r"$^\dagger$", "‡": r"$^\ddagger$", "§": r"$^\S$", "¶": r"$^\P$",
    "×": r"$\times$", "−": "$-$", "±": r"$\pm$", "∞": r"$\infty$", "σ": r"$\sigma$",
    "φ": r"$\varphi$", "…": r"\dots{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}",
    **{special: f"\\{special}" for special in "&%$#_{}"},
}  # fmt: skip
# Two hyphens become a dash. At the start of a cell, a star or bracket is an argument of `\\\\`.
_LATEX_PLACE = re.compile(r"^[\[*]|-(?=-)|.", re.DOTALL)
_FORMULA = ("=", "+", "-", "@")
SECRET = re.compile(r"(?i)[?&;#][^=&]*(token|secret|sig|pass|pwd|credential|key|auth)[^=&]*=")
_USER = re.compile(r"(?<=:/)(/?)[^/?#\s]*@")  # a Path of a URL has one slash


def visible(text: str) -> str:
    r"""Return a text with control characters shown, such as `\x1b`; line breaks are kept."""
    return "\n".join(_CONTROL.sub(_code, line) for line in text.split("\n"))


def one_line(text: str) -> str:
    """Return a text with visible control characters on one line, for cells and messages."""
    return visible(text.replace("\n", " "))


def without_secrets(text: str) -> str:
    """Return a sentence without the users, passwords and tokens of its URLs."""
    words = (_USER.sub(r"\1…@", word) for word in text.split(" "))
    return " ".join(
        word[: secret.end()] + "…" if ":/" in word and (secret := SECRET.search(word)) else word
        for word in words
    )


def markdown_text(text: str) -> str:
    """Return a text on one line that Markdown shows unchanged."""
    return _MARKDOWN.sub(r"\\\g<0>", one_line(text))


def latex_text(text: str) -> str:
    """Return a text on one line that LaTeX prints unchanged."""
    return _LATEX_PLACE.sub(_latex, one_line(text))


def csv_text(text: str) -> str:
    """Return a text that spreadsheets take as text or number, not as a formula."""
    line = one_line(text)
    return f"'{line}" if line.startswith(_FORMULA) and not _is_number(line) else line


def part_of_topic(name: str, *, kept: str = "") -> str:
    """Return a name of letters, digits and underscores for a part of a ROS topic's name.

    `kept`: another character to keep.
    """
    word = re.sub(rf"[^\w{kept}]+", "_", name.strip("/"), flags=re.ASCII)
    return f"topic_{word}" if word[:1].isdigit() else word


def _latex(match: re.Match[str]) -> str:
    text = match[0]
    if match.start() == 0 and text in "[*":
        return f"{{}}{text}"
    is_pair = text == "-" and match.string.startswith("-", match.end())
    return "-{}" if is_pair else _LATEX.get(text, text)


def _code(match: re.Match[str]) -> str:
    code = ord(match[0])
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
