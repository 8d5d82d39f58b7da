"""The public API: its names, the examples of their docstrings, and the scripts of docs/api."""

from __future__ import annotations

import ast
import doctest
import importlib
import inspect
import runpy
import subprocess
import sys
import textwrap
from itertools import pairwise
from pathlib import Path

import pytest
from paths import ROOT

import trajeval_ros

SCRIPTS = sorted((ROOT / "docs" / "api").glob("*.py"))
# What a script or an example needs beside numpy and scipy.
EXTRAS = {"compare": ("pyarrow", "jinja2", "matplotlib"), "draw": ("matplotlib",)}
LONGEST_SCRIPT = 40


def require_extras(text: str) -> None:
    for name, packages in EXTRAS.items():
        if f"{name}(" in text:
            for package in packages:
                pytest.importorskip(package, reason=f"{package} is missing")


def docstring_of(name: str) -> str:
    """Return the docstring of a class, of a function, or below a constant."""
    value = getattr(trajeval_ros, name)
    if not isinstance(value, dict):
        return inspect.getdoc(value) or ""
    module = importlib.import_module(f"trajeval_ros.{trajeval_ros._HOMES[name]}")
    body = ast.parse(inspect.getsource(module)).body
    for before, node in pairwise(body):
        target = before.target if isinstance(before, ast.AnnAssign) else None
        if isinstance(target, ast.Name) and target.id == name:
            assert isinstance(node, ast.Expr)
            assert isinstance(node.value, ast.Constant)
            return inspect.cleandoc(str(node.value.value))
    raise AssertionError(f"{name} is no constant of {module.__name__}")


def test_names_are_few_sorted_and_all_at_home() -> None:
    assert 30 <= len(trajeval_ros.__all__) <= 41
    assert len(set(trajeval_ros.__all__)) == len(trajeval_ros.__all__)
    assert trajeval_ros._HOMES.keys() == set(trajeval_ros.__all__)
    assert set(trajeval_ros.__all__) <= set(dir(trajeval_ros))


def test_type_checkers_see_the_same_names_at_the_same_homes() -> None:
    tree = ast.parse((ROOT / "trajeval_ros" / "__init__.py").read_text(encoding="utf-8"))
    (checking,) = (node for node in tree.body if isinstance(node, ast.If))
    seen = {
        alias.name: str(node.module).removeprefix("trajeval_ros.")
        for node in checking.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == trajeval_ros._HOMES


@pytest.mark.parametrize("name", trajeval_ros.__all__)
def test_a_name_is_defined_where_the_table_says(name: str) -> None:
    value = getattr(trajeval_ros, name)
    if not isinstance(value, dict):
        inspected = inspect.unwrap(value) if callable(value) else value
        assert inspected.__module__ == f"trajeval_ros.{trajeval_ros._HOMES[name]}"
        assert inspected.__name__ == name


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'evalute'"):
        trajeval_ros.evalute  # noqa: B018


@pytest.mark.slow
@pytest.mark.parametrize("name", ["__init__", *trajeval_ros.__all__])
def test_every_name_has_an_example_that_runs(name: str) -> None:
    text = inspect.getdoc(trajeval_ros) if name == "__init__" else docstring_of(name)
    assert text is not None
    require_extras(text)
    _, result, example = text.partition("Example:\n")
    assert result, f"{name} has no example"
    test = doctest.DocTestParser().get_doctest(textwrap.dedent(example), {}, name, None, 0)
    assert test.examples, f"{name} has no example"
    message: list[str] = []
    runner = doctest.DocTestRunner(verbose=False, optionflags=doctest.ELLIPSIS)
    assert runner.run(test, out=message.append).failed == 0, "".join(message)


def test_the_page_on_python_lists_every_name() -> None:
    page = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    assert not {name for name in trajeval_ros.__all__ if f"`{name}`" not in page}


def test_there_are_ten_scripts_or_more() -> None:
    assert len(SCRIPTS) >= 10


@pytest.mark.slow
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_script_runs_from_anywhere_and_uses_the_api_alone(
    script: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    text = script.read_text(encoding="utf-8")
    require_extras(text)
    assert len(text.splitlines()) <= LONGEST_SCRIPT
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("trajeval_ros"):
            assert node.module == "trajeval_ros"
            assert {alias.name for alias in node.names} <= set(trajeval_ros.__all__)
    monkeypatch.chdir(tmp_path)
    if "__main__" in text:  # its processes import it
        done = subprocess.run([sys.executable, str(script)], capture_output=True, check=True)
        out, err = done.stdout.decode(), done.stderr.decode()
    else:
        runpy.run_path(str(script), run_name="__main__")
        out, err = capsys.readouterr()
    assert out.strip()
    assert not err.strip()
    assert not list(tmp_path.iterdir()), "a script leaves nothing behind"


def test_every_name_is_in_a_script() -> None:
    shown = "\n".join(script.read_text(encoding="utf-8") for script in SCRIPTS)
    functions = {
        name for name in trajeval_ros.__all__ if inspect.isroutine(getattr(trajeval_ros, name))
    }
    assert not {name for name in functions if f"{name}(" not in shown}
