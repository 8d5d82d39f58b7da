"""Packages of pip and ROS: one version, dependencies that resolve, archives that install."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from paths import ROOT
from ruamel.yaml import YAML

from trajeval_ros import __version__

# Where distributions of ROS 2 are built for.
UBUNTU = {
    "humble": "jammy",
    "jazzy": "noble",
    "kilted": "noble",
    "lyrical": "resolute",
    "rolling": "resolute",
}


def _read_yaml(path: Path) -> Any:
    return YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))


def _ros_package() -> ElementTree.Element:
    return ElementTree.parse(ROOT / "package.xml").getroot()


def test_all_descriptions_name_one_version() -> None:
    assert _ros_package().findtext("version") == __version__
    citation = _read_yaml(ROOT / "CITATION.cff")
    assert citation["version"] == __version__
    assert _recipe()["package"] == {"name": "trajeval-ros", "version": __version__}
    changelog = (ROOT / "CHANGELOG.md").read_text()
    assert f"## {__version__} ({citation['date-released']})\n" in changelog


def _recipe() -> Any:
    """The draft for conda-forge, as conda-build renders it."""
    jinja2 = pytest.importorskip("jinja2", reason="the recipe is rendered by jinja2")
    template = jinja2.Environment(undefined=jinja2.StrictUndefined).from_string(
        (ROOT / "recipe/meta.yaml").read_text()
    )
    return YAML(typ="safe", pure=True).load(template.render(PYTHON="python", python_min="3.10"))


def test_the_recipe_requires_what_pip_does() -> None:
    described = (ROOT / "pyproject.toml").read_text()
    table = described.partition("\ndependencies = [")[2].partition("\n]")[0]
    by_pip = {item.replace("mcap", "python-mcap") for item in re.findall(r'"(.+?)"', table)}
    by_conda = {requirement.replace(" ", "") for requirement in _recipe()["requirements"]["run"]}
    assert by_conda == {"python>=3.10,<3.15", *by_pip}


@pytest.mark.parametrize(
    "path",
    sorted([*(ROOT / ".github").rglob("*.yml"), ROOT / "action.yml"]),
    ids=lambda path: path.name,
)
def test_workflows_and_forms_can_be_parsed(path: Path) -> None:
    assert _read_yaml(path)


WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_actions_are_pinned_by_commit(path: Path) -> None:
    uses = re.findall(r"uses: (\S+)", path.read_text())
    assert all(re.fullmatch(r"[\w./-]+@[0-9a-f]{40}", action) for action in uses)


def test_the_tools_of_a_release_are_pinned_by_hash() -> None:
    for path in WORKFLOWS:
        if "-m build" in (text := path.read_text()):
            assert "pip install --require-hashes" in text
            assert "build --no-isolation" in text
    requirements = (ROOT / ".ci" / "release-requirements.txt").read_text()
    assert re.search(r'requires = \["(.*)"\]', (ROOT / "pyproject.toml").read_text())[1] in (  # type: ignore[index]
        requirements
    )
    pins = re.split(r"\n(?=\S)", requirements.strip())
    assert all("==" in pin and "--hash=sha256:" in pin for pin in pins)


@pytest.mark.parametrize("path", sorted((ROOT / "docker").glob("*ockerfile")), ids=str)
def test_images_do_not_run_as_root(path: Path) -> None:
    lines = path.read_text().splitlines()
    assert [line for line in lines if line.startswith("USER ")]


def test_the_ros_package_says_where_its_developers_are() -> None:
    package = _ros_package()
    assert {url.get("type") for url in package.iter("url")} == {
        "website", "repository", "bugtracker",
    }  # fmt: skip
    people = [*package.iter("maintainer"), *package.iter("author")]
    assert len(people) == 2
    assert not [person for person in people if person.get("email", "").endswith(".example")]


def _rules(path: Path, names: set[str]) -> dict[str, Any]:
    """Return the rules of rosdep for some names, the rest of which would take seconds to parse."""
    blocks = re.split(r"\n(?=\w)", path.read_text(encoding="utf-8"))
    chosen = [block for block in blocks if block.partition(":")[0] in names]
    rules: dict[str, Any] = YAML(typ="safe", pure=True).load("\n".join(chosen)) or {}
    return rules


def _installs_by_apt(rule: Any, codename: str) -> bool:
    """Whether a rule of rosdep names packages of Ubuntu, and not of pip."""
    if isinstance(rule, dict) and "pip" not in rule:
        rule = rule.get(codename, rule.get("*"))
    return isinstance(rule, list) and bool(rule)


@pytest.mark.parametrize("distribution", UBUNTU)
def test_dependencies_of_the_ros_package_resolve_by_apt(
    distribution: str, shared_data: Path
) -> None:
    lists = shared_data.parent / "rosdistro"
    released = set(json.loads((lists / "released_packages.json").read_text())[distribution])
    names = {
        element.text or ""
        for element in _ros_package()
        if element.tag == "depend" or element.tag.endswith("_depend")
    }
    keys = {**_rules(lists / "base.yaml", names), **_rules(lists / "python.yaml", names)}
    assert len(names) > 15
    missing = [
        name
        for name in sorted(names)
        if name not in released
        and not _installs_by_apt(keys.get(name, {}).get("ubuntu"), UBUNTU[distribution])
    ]
    assert missing == []


def test_a_key_of_pip_is_no_package_of_ubuntu() -> None:
    assert _installs_by_apt(["python3-numpy"], "noble")
    assert _installs_by_apt({"*": ["python3-rich"], "focal": {"pip": {}}}, "noble")
    assert not _installs_by_apt({"pip": {"packages": ["rosbags"]}}, "noble")
    assert not _installs_by_apt({"*": ["python3-rich"], "noble": None}, "noble")
    assert not _installs_by_apt(None, "noble")


def _run(*command: object, **environment: str) -> str:
    done = subprocess.run(
        [str(word) for word in command], cwd=ROOT, env={**os.environ, **environment},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def archives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The source distribution and the wheel that is built from it.

    In a copy of the checkout: setuptools writes into it, also what metadata other tests read.
    """
    folder = tmp_path_factory.mktemp("dist")
    pytest.importorskip("build", reason="archives need the extra `release`")
    with tempfile.TemporaryDirectory() as copied:
        checkout = Path(copied) / "checkout"
        left_out = shutil.ignore_patterns(".*", "__pycache__", "*.egg-info", "build", "data")
        shutil.copytree(ROOT, checkout, ignore=left_out)
        command = [sys.executable, "-m", "build", "--outdir", folder, checkout]
        _run(*command, SOURCE_DATE_EPOCH="1700000000")
    return folder


@pytest.mark.slow
def test_archives_are_what_an_index_accepts(archives: Path) -> None:
    files = sorted(archives.iterdir())
    assert [re.sub(r".*?(-py3-none-any\.whl|\.tar\.gz)$", r"\1", file.name) for file in files] == [
        "-py3-none-any.whl",
        ".tar.gz",
    ]
    _run(sys.executable, "-m", "twine", "check", "--strict", *files)
    _run(sys.executable, "-m", "check_wheel_contents", "--toplevel", "trajeval_ros", files[0])


@pytest.mark.slow
def test_a_wheel_is_built_to_the_same_bytes(archives: Path, tmp_path: Path) -> None:
    (archive,), (first,) = archives.glob("*.tar.gz"), archives.glob("*.whl")
    shutil.unpack_archive(archive, tmp_path / "sources")
    (sources,) = (tmp_path / "sources").iterdir()
    command = [sys.executable, "-m", "build", "--wheel", "--outdir", tmp_path, sources]
    _run(*command, SOURCE_DATE_EPOCH="1700000000")
    (again,) = tmp_path.glob("*.whl")
    digests = [hashlib.sha256(item.read_bytes()).hexdigest() for item in (again, first)]
    assert digests[0] == digests[1]


@pytest.mark.slow
def test_the_sources_work_in_an_empty_environment(archives: Path, tmp_path: Path) -> None:
    """pip builds the wheel from them."""
    (archive,) = archives.glob("*.tar.gz")
    _run(sys.executable, "-m", "venv", tmp_path / "empty")
    programs = tmp_path / "empty" / "bin"
    constraints = ["--constraint", ROOT / "constraints.txt"]
    _run(programs / "python", "-m", "pip", "install", "--quiet", *constraints, archive)
    trajeval, flight = programs / "trajeval", tmp_path / "flight"
    assert _run(trajeval, "--version") == f"trajeval_ros {__version__}\n"
    _run(trajeval, "simulate", flight, "--duration", "10")
    sources = ["-g", f"{flight}:/groundtruth/pose", "-e", f"{flight}:/vio/odometry"]
    assert "ATE" in _run(trajeval, "evaluate", *sources)
    assert (programs.parent / "share/trajeval_ros/package.xml").is_file()


WITHOUT_PIP = """
import sys

class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {missing!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Refuse())
sys.argv = ["evaluator", *{arguments!r}]
from trajeval_ros.__main__ import {program}
sys.exit({program}())
"""
# Which Ubuntu has too old, or not at all.
BY_PIP = [
    "click",
    "rich_click",
    "rosbags",
    "mcap",
    "lz4",
    "zstandard",
    "jinja2",
    "pyarrow",
    "rerun",
]


def _without_pip(
    *arguments: str, program: str = "ros_evaluator"
) -> subprocess.CompletedProcess[str]:
    code = WITHOUT_PIP.format(missing=BY_PIP, arguments=list(arguments), program=program)
    return subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )


def test_the_nodes_program_needs_no_package_of_pip() -> None:
    done = _without_pip("--help")
    assert done.returncode == 0, done.stderr
    assert "estimate_topics" in done.stdout


def test_the_nodes_program_takes_ros_arguments_alone() -> None:
    done = _without_pip("--gauge", "se3")
    assert done.returncode == 2
    assert "unknown argument --gauge se3" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_program_without_its_packages_says_so() -> None:
    done = _without_pip(program="ros_replay")
    assert done.returncode == 2
    assert "No module named 'click'" in done.stderr
    assert "pip install trajeval-ros" in done.stderr
