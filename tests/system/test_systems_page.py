"""The commands in the table of docs/systems.md, and its length."""

from __future__ import annotations

import re

from paths import ROOT

from trajeval_ros.cli.app import verb

PAGE = (ROOT / "docs" / "systems.md").read_text(encoding="utf-8")


def test_every_row_is_a_command() -> None:
    rows = re.findall(r"^\| ([\w -]+?) \| (`/.*?) \| `(--.*?)` \|", PAGE, re.MULTILINE)
    assert len(rows) == 14
    for _, topics, options in rows:
        for topic in re.findall(r"`(/\S+)`", topics):
            words = ["-g", "run.mcap:/mocap/pose", "-e", f"run.mcap:{topic}", *options.split()]
            context = verb("evaluate").make_context("evaluate", words)
            assert context.params["estimate"] == (f"run.mcap:{topic}",)


def test_the_page_is_short() -> None:
    assert len(PAGE.split()) <= 900
