"""The laws of the package: which module may import which, and what its files must agree on."""

from __future__ import annotations

import ast
import functools
import graphlib
import re
import runpy
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

import pytest
from paths import ROOT

import trajeval_ros

PACKAGE = ROOT / "trajeval_ros"

# A file imports only from lower layers, or from its own folder. Folders of one layer know
# nothing of each other.
LAYERS = {
    "exceptions": 0,
    "formatting": 0,
    "linear_algebra_threads": 0,
    "geometry": 1,
    "continuous_time": 2,
    "simulation": 2,
    "metrics": 3,
    "calibration": 4,
    "consistency": 4,
    "likelihood": 4,
    "diagnosis": 5,
    "watchdog": 5,
    "explanation": 6,
    "pipeline": 6,
    "online": 6,
    "io": 7,
    "report": 8,
    "viewer": 8,
    "batch": 9,
    "ros": 9,
    "papers": 9,
    "cli": 10,
    "__main__": 11,
}
ARRAYS = ("Booleans", "Bytes", "Floats", "Indices", "NDArray", "Stamps")
# Dataclasses that count, or that are filled in steps.
CHANGING = {
    "Chunk",
    "Event",
    "Loss",
    "McapContents",
    "MessageIndex",
    "PlaybackResult",
    "Progress",
    "Registry",
    "Repeats",
    "StateCounts",
    "StreamStatus",
    "TopicReading",
    "TopicSelection",
    "WatchAlarm",
    "_Candidate",
    "_Kind",
    "_Leaves",
    "_RepeatedPart",
}
MODULES_AT_THE_TOP = {"__init__", "__main__", "exceptions", "linear_algebra_threads"}

# Packages that only some subpackages may import.
IMPORTED_ONLY_IN = {
    "rclpy": {"ros"},
    "rerun": {"viewer"},
    "matplotlib": {"report", "papers"},
    "PIL": {"io", "viewer"},
    "click": {"cli"},
    "rich_click": {"cli"},
    "rich": {"cli"},
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
    "pandas": {"metrics", "geometry", "io"},  # types of tables that users give
    "pyarrow": {"batch", "metrics", "io"},
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


@functools.cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def subpackage_of(path: Path) -> str:
    """Return the module or folder, right under the package, that a file belongs to."""
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported_names(tree: ast.AST) -> Iterator[str]:
    """Yield the full names that a file imports, those in `if TYPE_CHECKING` as well."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            assert node.module is not None
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def subpackages_used_by(path: Path) -> set[str]:
    """Return the modules and folders of this package that a file imports."""
    names = imported_names(parsed(path))
    split = [name.split(".") for name in names if name.startswith(f"{PACKAGE.name}.")]
    return {parts[1] for parts in split} - {"__version__"}


def test_imports_come_from_layers_below() -> None:
    for path in sources():
        subpackage = subpackage_of(path)
        if subpackage == "__init__":
            continue
        assert subpackage in LAYERS, f"give {subpackage} a layer in {Path(__file__).name}"
        others = subpackages_used_by(path) - {subpackage}
        assert others <= LAYERS.keys(), f"{path}: import from where a name is defined"
        assert not {used for used in others if LAYERS[used] >= LAYERS[subpackage]}, path


def modules_used_by(path: Path, known: dict[str, Path]) -> set[str]:
    """Return the modules that a file imports, also in functions and `if TYPE_CHECKING`."""
    names = set(imported_names(parsed(path)))
    names |= {name.rpartition(".")[0] for name in names}
    return {name for name in names & known.keys() if known[name] != path}


@pytest.mark.slow
def test_no_modules_import_one_another() -> None:
    known = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts): path
        for path in sources()
        if path != PACKAGE / "__init__.py"
    }
    sorter = graphlib.TopologicalSorter(
        {name: modules_used_by(path, known) for name, path in known.items()}
    )
    sorter.prepare()  # raises CycleError with the modules of a circle


def test_dataclasses_do_not_change_and_arrays_are_not_compared() -> None:
    """`==` of two dataclasses with arrays raises; so these are compared by identity."""
    changing = set()
    for path in sources():
        for node in parsed(path).body:
            for decorator in node.decorator_list if isinstance(node, ast.ClassDef) else ():
                written = ast.unparse(decorator)
                if not written.startswith("dataclass"):
                    continue
                assert isinstance(node, ast.ClassDef)
                if "frozen=True" not in written:
                    changing.add(node.name)
                kinds = [item.annotation for item in node.body if isinstance(item, ast.AnnAssign)]
                if re.search(rf"\b({'|'.join(ARRAYS)})\b", " ".join(map(ast.unparse, kinds))):
                    assert "eq=False" in written, node.name
    assert changing == CHANGING


def test_modules_at_the_top_are_few() -> None:
    assert {path.stem for path in PACKAGE.glob("*.py")} <= MODULES_AT_THE_TOP


def test_no_two_modules_have_one_name() -> None:
    places: dict[str, list[Path]] = {}
    for path in sources():
        if path.stem != "__init__":
            places.setdefault(path.stem, []).append(path.relative_to(PACKAGE))
    assert not {name: paths for name, paths in places.items() if len(paths) > 1}


def test_no_two_public_classes_have_one_name() -> None:
    places: dict[str, list[Path]] = {}
    for path in sources():
        for node in parsed(path).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(path.relative_to(PACKAGE))
    assert not {name: paths for name, paths in places.items() if len(paths) > 1}


@pytest.mark.slow
def test_outside_packages_are_imported_in_their_subpackages_only() -> None:
    for path in sources():
        subpackage = subpackage_of(path)
        names = imported_names(parsed(path))
        outside = {name.split(".")[0] for name in names} & IMPORTED_ONLY_IN.keys()
        assert not {name for name in outside if subpackage not in IMPORTED_ONLY_IN[name]}, path


@pytest.mark.parametrize(
    "writer", [r'"---"', r"csv\.writer\(", r"begin{+tabular", r"class Table\b"]
)
def test_tables_of_a_format_are_written_in_one_place(writer: str) -> None:
    result = [path.stem for path in sources() if re.search(writer, path.read_text("utf-8"))]
    assert result == ["console" if "Table" in writer else "text_tables"]


def test_package_itself_imports_nothing_until_it_is_asked() -> None:
    code = (
        "import sys; before = set(sys.modules); import trajeval_ros; "
        "new = {name for name in set(sys.modules) - before if name != 'trajeval_ros'}; "
        "new = {name for name in new if name.split('.')[0] not in sys.stdlib_module_names}; "
        "sys.exit(', '.join(sorted(new)) or 0)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


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


def test_scripts_are_thin() -> None:
    scripts = sorted((ROOT / "launch_free_scripts").glob("*.py"))
    assert scripts
    for script in scripts:
        assert len(script.read_text(encoding="utf-8").splitlines()) < 30, script.name


def test_bag_script_turns_topics_into_sources(monkeypatch: pytest.MonkeyPatch) -> None:
    handed_over: list[str] = []
    monkeypatch.setattr("trajeval_ros.cli.app.main", lambda given: handed_over.extend(given) or 0)
    script = str(ROOT / "launch_free_scripts" / "evaluate_bag.py")
    given = "flight --groundtruth /truth --estimate /a --gauge yaw --estimate /b --quiet"
    monkeypatch.setattr(sys, "argv", [script, *given.split()])
    monkeypatch.setattr(sys, "path", list(sys.path))
    with pytest.raises(SystemExit, match="0"):
        runpy.run_path(script, run_name="__main__")
    expected = (
        "evaluate --groundtruth flight:/truth --estimate flight:/a --gauge yaw "
        "--estimate flight:/b --quiet"
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


def test_docs_name_files_that_exist() -> None:
    known = [
        path.as_posix()
        for path in (
            *PACKAGE.rglob("*.py"),
            *ROOT.glob("*.py"),
            *ROOT.glob("*/*.py"),
            *(ROOT / "examples").rglob("*.py"),
            *(ROOT / "tests").rglob("*.py"),
        )
    ]
    gone = {
        f"{page.name}: {name}"
        for page in (*(ROOT / "docs").glob("*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md")
        for name in re.findall(r"`([\w/]+\.py)`", page.read_text(encoding="utf-8"))
        if not any(path.endswith(f"/{name}") for path in known)
    }
    assert not gone
