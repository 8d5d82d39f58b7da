"""Names in the code are the field's terms, spelled out."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
from paths import ROOT

# A loop variable is named after its values; what is listed behind a name replaced it.
FORBIDDEN = {
    "each": "the name of the thing, such as estimate",
    "Reading": "SourceInfo",
    "Receptions": "ReceiveTimes",
    "judge_poses": "valid_mask",
    "judge_rotations": "check_rotations",
    "StampTrust": "OutlierStamps",
    "RotationFreedom": "RotationUncertainty",
    "Seen": "Detection",
    "Examined": "TestResult",
    "Tried": "Verification",
    "Peaks": "MaxSinceLast",
    "Standing": "ActiveAlarms",
    "about_gravity": "rot_z",
    "turns_freely": "has_so3",
    "turned": "rotated, or what the rotation is of",
    "found": "the name of the thing, such as result",
    "said": "the name of the thing, such as message",
    "wanted": "required or expected",
    "ours": "actual, or the name of the thing",
    "receptions": "receive_times",
    "untrustworthy": "why_withheld",
    "ink": "text_color",
    "say_instead": "annotate",
    "house_style": "apply_style",
    "make_way": "remove_existing",
    "give_way": "lower_priority",
    "begins_anew": "starts_new_run",
}


def names_in(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the lines and names of variables, parameters, functions and classes."""
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Name):
            yield node.lineno, node.id
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.lineno, node.name


@pytest.mark.parametrize("folder", ["trajeval_ros", "tests", "benchmarks", "examples"])
def test_names_are_terms_of_the_field(folder: str) -> None:
    wrong = [
        f"{path.relative_to(ROOT)}:{line}: {name}; use {FORBIDDEN[name]}"
        for path in sorted((ROOT / folder).rglob("*.py"))
        for line, name in names_in(path)
        if name in FORBIDDEN
    ]
    assert not wrong, "\n".join(wrong[:20])
