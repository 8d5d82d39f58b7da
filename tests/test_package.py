"""The laws of the package: which module may import which, and what its files must agree on."""

from __future__ import annotations

import ast
import re
import runpy
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

import pytest

import trajeval_ros

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "trajeval_ros"

# A file imports only from floors below its own, or from its own folder.
FLOORS = {
    "exceptions": 0,
    "lie": 0,
    "block_tridiagonal": 1,
    "chain": 1,
    "se3": 1,
    "trajectory": 1,
    "statistics": 1,
    "gauge": 2,
    "similarity": 2,
    "continuous_time": 2,
    "coverage": 2,
    "no_match": 2,
    "degradation": 3,
    "association": 3,
    "span_alignment": 3,
    "score": 2,
    "moments": 3,
    "alignment": 4,
    "errors": 4,
    "sub_trajectories": 4,
    "likelihood": 5,
    "consistency": 5,
    "calibration": 5,
    "protocol": 5,
    "diagnosis": 5,
    "jumps": 4,
    "evaluation": 6,
    "calibrated": 7,
    "requirement": 6,
    "settings": 6,
    "simulation": 5,
    "visual_inertial": 6,
    "association_study": 7,
    "io": 7,
    "online": 7,
    "report": 7,
    "viewer": 7,
    "batch": 8,
    "ros": 8,
    "cli": 9,
    "__main__": 10,
}
LAST_FLOOR_OF_CORE = 6

# Packages that only some rooms may open.
ROOMS = {
    "rclpy": {"ros"},
    "rerun": {"viewer"},
    "matplotlib": {"report"},
    "typer": {"cli"},
    "rich": {"cli", "report"},
    "rosbags": {"io"},
    "mcap": {"io"},
    "zstandard": {"io"},
    "lz4": {"io"},
    "ruamel": {"io"},
    "upath": {"io"},
    "foxglove_schemas_protobuf": {"io"},
    "google": {"io"},
    "distributed": {"batch"},
    "fsspec": {"batch"},
    "pyarrow": {"batch"},
    "jinja2": {"report"},
}
HEAVY = {
    "distributed",
    "fsspec",
    "google.protobuf",
    "jinja2",
    "matplotlib",
    "mcap",
    "pandas",
    "pyarrow",
    "rclpy",
    "rerun",
    "rosbags",
    "ruamel",
    "upath",
}


def sources() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


def room_of(path: Path) -> str:
    """Return the module or folder, right under the package, that a file belongs to."""
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imports_at_run_time(tree: ast.AST) -> Iterator[str]:
    """Yield the full names that a file imports, those in `if TYPE_CHECKING` left out."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            assert node.module is not None
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        else:
            yield from imports_at_run_time(node)


def rooms_used_by(path: Path) -> set[str]:
    """Return the modules and folders of this package that a file imports."""
    names = imports_at_run_time(ast.parse(path.read_text(encoding="utf-8")))
    split = [name.split(".") for name in names]
    return {
        parts[1]
        for parts in split
        if parts[0] == PACKAGE.name and len(parts) > 1 and parts[1] in FLOORS
    }


@pytest.mark.parametrize("path", sources(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_come_from_floors_below(path: Path) -> None:
    room = room_of(path)
    if room == "__init__":
        return
    assert room in FLOORS, f"give {room} a floor in {Path(__file__).name}"
    too_high = {
        used for used in rooms_used_by(path) if used != room and FLOORS[used] >= FLOORS[room]
    }
    assert not too_high


@pytest.mark.parametrize("path", sources(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_outside_packages_are_imported_in_their_rooms_only(path: Path) -> None:
    room = room_of(path)
    names = imports_at_run_time(ast.parse(path.read_text(encoding="utf-8")))
    outside = {name.split(".")[0] for name in names} & ROOMS.keys()
    assert not {package for package in outside if room not in ROOMS[package]}


def test_core_is_what_the_package_itself_offers() -> None:
    used = rooms_used_by(PACKAGE / "__init__.py")
    assert {room for room in used if FLOORS[room] > LAST_FLOOR_OF_CORE} == set()


@pytest.mark.parametrize(
    "arguments", [[], ["--help"], ["evaluate", "--help"], ["compare", "--help"]]
)
def test_command_line_starts_without_heavy_imports(arguments: list[str]) -> None:
    code = (
        "import sys; from trajeval_ros.cli.app import main; "
        f"arguments = {arguments!r}; status = main(arguments) if arguments else 0; "
        f"loaded = {HEAVY!r} & set(sys.modules); "
        "sys.exit(', '.join(sorted(loaded)) or status)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_bag_script_turns_topics_into_sources(monkeypatch: pytest.MonkeyPatch) -> None:
    handed_over: list[str] = []
    monkeypatch.setattr("trajeval_ros.cli.app.main", lambda given: handed_over.extend(given) or 0)
    script = str(ROOT / "launch_free_scripts" / "evaluate_bag.py")
    given = "flight --groundtruth /truth --estimate /a --gauge yaw --estimate=/b --quiet"
    monkeypatch.setattr(sys, "argv", [script, *given.split()])
    monkeypatch.setattr(sys, "path", list(sys.path))
    with pytest.raises(SystemExit, match="0"):
        runpy.run_path(script, run_name="__main__")
    expected = (
        "evaluate --groundtruth flight:/truth --estimate flight:/a --estimate flight:/b "
        "--gauge yaw --quiet"
    )
    assert handed_over == expected.split()


def test_compare_script_hands_its_options_over(monkeypatch: pytest.MonkeyPatch) -> None:
    handed_over: list[str] = []
    monkeypatch.setattr("trajeval_ros.cli.app.main", lambda given: handed_over.extend(given) or 0)
    script = str(ROOT / "launch_free_scripts" / "compare_runs.py")
    monkeypatch.setattr(sys, "argv", [script, "euroc.yaml", "--quiet"])
    monkeypatch.setattr(sys, "path", list(sys.path))
    with pytest.raises(SystemExit, match="0"):
        runpy.run_path(script, run_name="__main__")
    assert handed_over == ["compare", "euroc.yaml", "--quiet"]


def test_package_xml_has_the_same_version() -> None:
    stated = ElementTree.parse(ROOT / "package.xml").findtext("version")
    assert stated == trajeval_ros.__version__


def test_changelog_has_an_entry_for_the_version() -> None:
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(rf"^## {re.escape(trajeval_ros.__version__)}\b", changelog, re.MULTILINE)
