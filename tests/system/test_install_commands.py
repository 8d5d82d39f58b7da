"""What is told to be typed where an extra is missing, typed: in every kind of installation."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import zipfile
from importlib.metadata import requires
from pathlib import Path

import pytest
from paths import ROOT

from trajeval_ros.formatting import install_command as module
from trajeval_ros.formatting.install_command import extra_command, install_command, pyarrow_command


def test_the_command_is_of_the_python_that_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/home/me/a b/python")
    monkeypatch.setattr(module, "_is_managed_by_system", lambda: False)
    assert install_command("pandas") == "'/home/me/a b/python' -m pip install pandas"


def test_the_system_s_python_is_told_to_install_for_the_user(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(sys, "prefix", sys.base_prefix)
    monkeypatch.setattr("sysconfig.get_path", lambda _: str(tmp_path))
    assert "--user" not in install_command("pandas")
    (tmp_path / "EXTERNALLY-MANAGED").touch()
    assert install_command("pandas").endswith("--user --break-system-packages pandas")
    monkeypatch.setattr(sys, "prefix", str(tmp_path))  # an environment
    assert "--user" not in install_command("pandas")


def test_beside_numpy_1_it_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_has_numpy_1", lambda: True)
    assert extra_command("rerun").count("--no-deps") == 1
    assert "trajeval-ros" not in extra_command("rerun")
    assert extra_command("compare").endswith("'trajeval-ros[compare]' 'pyarrow<26'")
    assert pyarrow_command() == install_command("pyarrow<26")
    monkeypatch.setattr(module, "_has_numpy_1", lambda: False)
    assert pyarrow_command() == install_command("pyarrow")
    assert extra_command("rerun").endswith("'trajeval-ros[rerun]'")


def test_every_extra_that_is_named_exists() -> None:
    described = (ROOT / "pyproject.toml").read_text("utf-8")
    table = described.partition("[project.optional-dependencies]")[2].partition("\n[tool")[0]
    extras = set(re.findall(r"^(\w+) = \[", table, re.MULTILINE))
    sources = [path.read_text("utf-8") for path in (ROOT / "trajeval_ros").rglob("*.py")]
    named = {item for text in sources for item in re.findall(r"extra_command\(['\"](\w+)", text)}
    assert {"plot", "compare", "cluster", "remote", "rerun"} <= named <= extras
    assert "foxglove" in extras


def test_no_sentence_of_the_program_has_a_command_of_its_own() -> None:
    """`pip` alone may be another Python's; a wheel that lacks numpy can't import the command."""
    paths = set((ROOT / "trajeval_ros").rglob("*.py")) - {ROOT / "trajeval_ros/__main__.py"}
    assert len(paths) > 100
    for path in paths:
        assert "pip install" not in path.read_text("utf-8"), path


def make_wheel(folder: Path, name: str, version: str) -> None:
    """Write the wheel of a package with nothing in it."""
    stem = f"{name.replace('.', '_').replace('-', '_')}-{version}"
    info = f"{stem}.dist-info"
    with zipfile.ZipFile(folder / f"{stem}-py3-none-any.whl", "w") as file:
        file.writestr(f"{name.replace('.', '_')}.py", f"__version__ = {version!r}\n")
        header = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n"
        file.writestr(f"{info}/METADATA", header)
        tags = "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
        file.writestr(f"{info}/WHEEL", tags)
        file.writestr(f"{info}/RECORD", "")


def run(command: str, folder: Path, **more: str) -> str:
    done = subprocess.run(
        ["bash", "-c", command],
        capture_output=True,
        text=True,
        env={**os.environ, **more},
        cwd=folder,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def offline_index(index: Path) -> dict[str, str]:
    """Return the environment variables for which a folder is the package index."""
    return {"PIP_NO_INDEX": "1", "PIP_FIND_LINKS": str(index), "PYTHONPATH": ""}


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with an index of empty wheels, and an environment with the numpy of it."""
    folder = tmp_path_factory.mktemp("prepared")
    index = folder / "index"
    index.mkdir()
    needed = {re.split("[<>=;[ ]", require)[0] for require in requires("trajeval-ros") or ()}
    for name in {*needed, "matplotlib"}:
        make_wheel(index, name, "99.0")
    run(f"{sys.executable} -m venv environment", folder)
    python = folder / "environment" / "bin" / "python"
    run(f"{python} -m pip install -q numpy", folder, **offline_index(index))
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("way", ["checkout", "wheel", "workspace"])
def test_the_command_works_as_it_is_printed(way: str, prepared: Path, tmp_path: Path) -> None:
    """A folder of empty wheels stands for the package index."""
    pytest.importorskip("build" if way == "wheel" else "setuptools")
    environment, checkout = tmp_path / "environment", tmp_path / "checkout"
    prefix = tmp_path / "install" / "trajeval_ros"
    checkout.mkdir()
    shutil.copytree(prepared / "environment", environment, symlinks=True)
    for name in ("trajeval_ros", "resource", "launch", "config"):
        shutil.copytree(ROOT / name, checkout / name)
    for name in ("setup.py", "setup.cfg", "pyproject.toml", "README.md", "package.xml"):
        shutil.copy(ROOT / name, checkout)
    python = environment / "bin" / "python"
    offline = offline_index(prepared / "index")
    setup = f"{sys.executable} setup.py -q"
    if way == "wheel":
        run(f"{sys.executable} -m build --wheel --outdir {tmp_path} {checkout}", tmp_path)
        run(f"{python} -m pip install -q --no-deps {tmp_path}/*.whl", tmp_path, **offline)
    elif way == "workspace":  # as colcon does it
        unmanaged = "--single-version-externally-managed --record log"
        run(f"{setup} install --prefix {prefix} {unmanaged}", checkout)
        [offline["PYTHONPATH"]] = map(str, prefix.glob("lib/python*/site-packages"))
    else:
        run(f"{setup} egg_info", checkout)
        offline["PYTHONPATH"] = str(checkout)
    of_module = f"from {module.__name__} import extra_command"
    code = f"{of_module}; print(extra_command('plot'))"
    command = run(f'{python} -c "{code}"', tmp_path, **offline)
    assert command == f"{python} -m pip install 'trajeval-ros[plot]'"
    run(command, tmp_path, **offline)
    result = run(f"{python} -c 'import matplotlib; print(matplotlib.__version__)'", tmp_path)
    assert result == "99.0"
