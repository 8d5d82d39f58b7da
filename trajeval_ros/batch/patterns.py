"""File patterns with placeholders for sequence and trial."""

from __future__ import annotations

import glob
import re
from collections.abc import Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from trajeval_ros.batch.remote_files import open_store
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.io.sources import require_no_password

SEQUENCE, TRIAL = "sequence", "trial"
_PLACEHOLDER = re.compile(r"\{(\w*)\}")
_PARTS = re.compile(r"((?:\w[\w+.-]*://)?.*?)(:/.*)?", re.DOTALL)


def split_topic(source: str) -> tuple[str, str]:
    """Return a SOURCE's path or URL, and its topic with the colon, "" if there is none."""
    match = _PARTS.fullmatch(source)
    assert match is not None
    return match[1], match[2] or ""


def is_url(path: str) -> bool:
    """Return whether a path is a URL, which fsspec reads."""
    return "://" in path


@dataclass(frozen=True)
class Pattern:
    """A SOURCE with `{sequence}`, `{trial}` and `*` in it."""

    text: str  # as the user wrote it
    path: str  # its path or URL
    topic: str  # its topic with the colon, "" if there is none

    @classmethod
    def parse(cls, text: str) -> Pattern:
        """Parse a pattern."""
        require_no_password(text)
        for name in _PLACEHOLDER.findall(text):
            if name not in (SEQUENCE, TRIAL):
                near = get_close_matches(name, (SEQUENCE, TRIAL), n=1)
                hint = f"did you mean {{{near[0]}}}?" if near else "use {sequence} and {trial}"
                raise SettingsError(f"the pattern {text!r} has an unknown {{{name}}}; {hint}")
        if "\0" in text:
            raise SettingsError(
                f"the pattern {text!r} has a character that is not valid in a path"
            )
        path, topic = split_topic(text)
        if SEQUENCE not in _PLACEHOLDER.findall(path):
            raise SettingsError(
                f"the pattern {text!r} has no {{sequence}}; write it in place of the sequence "
                "name, as in groundtruth/{sequence}.txt, or list the files in a manifest"
            )
        return cls(text, path, topic)

    @property
    def has_trials(self) -> bool:
        """Whether it has `{trial}`."""
        return TRIAL in _PLACEHOLDER.findall(self.path)

    def find(self, folder: Path) -> dict[tuple[str, str], str]:
        """Return the SOURCE of every sequence and trial ("" without trials).

        `folder`: start of relative paths.
        """
        sources: dict[tuple[str, str], str] = {}
        for match, path in _existing(folder, self.path):
            named = {SEQUENCE: match[SEQUENCE], TRIAL: match[TRIAL] if self.has_trials else ""}
            run = (named[SEQUENCE], named[TRIAL])
            if run in sources:
                which = " ".join(filter(None, run))
                raise InputError(
                    f"two files are {which} of {self.text!r}: {split_topic(sources[run])[0]} and "
                    f"{path}; make the pattern unique"
                )
            sources[run] = path + _filled(self.topic, *run)
        return sources

    def require(self, sources: dict[tuple[str, str], str], folder: Path) -> None:
        """Check that a pattern matches a file."""
        if not sources:
            raise InputError(
                f"no file matches the pattern {self.text!r}{_how_far(folder, self.path)}"
            )

    def path_of(self, folder: Path, sequence: str, trial: str) -> str:
        """Return the path of a run's file, which may not exist."""
        path = _filled(self.path, sequence, trial)
        return path if is_url(path) else str(folder / path)


def _filled(text: str, sequence: str, trial: str) -> str:
    return text.replace("{sequence}", sequence).replace("{trial}", trial)


def _expression(path: str) -> str:
    """Return the regular expression of a pattern; placeholders match as much as possible."""
    parts, seen = [], set()
    for place, piece in enumerate(re.split(r"\{(\w+)\}|(\*)", path)):
        if place % 3 == 0:
            parts.append(re.escape(piece))
        elif piece == "*":
            parts.append("[^/]*")
        elif piece is not None:
            parts.append(f"(?P={piece})" if piece in seen else f"(?P<{piece}>[^/]+)")
            seen.add(piece)
    return "".join(parts)


def _existing(folder: Path, pattern: str) -> Iterator[tuple[re.Match[str], str]]:
    """Yield the matches of a pattern and their paths, in order of names."""
    if is_url(pattern):
        yield from _existing_at(pattern)
        return
    pattern = str(Path(pattern))
    begin = "" if Path(pattern).is_absolute() else f"{folder}/"
    expression = re.compile(re.escape(begin) + _expression(pattern))
    wildcards = glob.escape(begin) + "*".join(map(glob.escape, _fixed_parts(pattern)))
    for path in sorted(glob.glob(wildcards)):  # noqa: PTH207 - of escaped, whole paths
        if match := expression.fullmatch(path):
            yield match, path


def _existing_at(url: str) -> list[tuple[re.Match[str], str]]:
    """Return the same as `_existing` for a pattern in a remote store."""
    with open_store(url) as (files, pattern):
        expression = re.compile(_expression(pattern))
        paths = sorted(files.glob("*".join(_fixed_parts(pattern))))
        return [
            (match, files.unstrip_protocol(path))
            for path in paths
            if (match := expression.fullmatch(path))
        ]


def _fixed_parts(pattern: str) -> list[str]:
    """Return the parts between the placeholders."""
    return re.split(r"\{\w+\}|\*", pattern)


def _how_far(folder: Path, pattern: str) -> str:
    """Return the end of a message: the part of a path that exists."""
    if is_url(pattern):
        return "; check the URL"
    if not folder.is_dir():
        return f"; the folder {folder} does not exist"
    fixed = (folder / f"{_fixed_parts(pattern)[0]}x").parent
    while not fixed.is_dir():
        fixed = fixed.parent
    names = sorted(path.name for path in fixed.iterdir())[:5]
    inside = f", which contains {', '.join(names)}" if names else ", which is empty"
    return f"; the path exists up to {fixed}{inside}"
