"""Commands that install missing packages, for the way in which this package was installed."""

from __future__ import annotations

import sys
from pathlib import Path

_DISTRIBUTION = "trajeval-ros"
# Versions for numpy 1, which the message packages of ROS 2 Jazzy need.
_PYARROW_BESIDE_NUMPY_1 = "pyarrow<26"
_BESIDE_NUMPY_1 = dict.fromkeys(("compare", "cluster"), (_PYARROW_BESIDE_NUMPY_1,))
_RERUN_BESIDE_NUMPY_1 = (
    "--no-deps",
    "rerun-sdk==0.39.*" if sys.version_info < (3, 11) else "rerun-sdk>=0.41",
    *("pyarrow>=18,<26", "attrs>=23.1", "pillow>=8", "psutil>=7", "typing-extensions>=4.5"),
)


def extra_command(extra: str) -> str:
    """Return the command that installs an extra of this package, such as `plot`.

    Pip takes the requirements from the installed package: a checkout, a wheel, or a ROS workspace
    on `PYTHONPATH`.
    """
    beside_numpy_1 = _has_numpy_1()
    if extra == "rerun" and beside_numpy_1:
        return install_command(*_RERUN_BESIDE_NUMPY_1)
    more = _BESIDE_NUMPY_1.get(extra, ()) if beside_numpy_1 else ()
    return install_command(f"{_installed()}[{extra}]", *more)


def pyarrow_command() -> str:
    """Return the command that installs a pyarrow compatible with the installed numpy."""
    return install_command(_PYARROW_BESIDE_NUMPY_1 if _has_numpy_1() else "pyarrow")


def install_command(*arguments: str) -> str:
    """Return the command that installs requirements for the running Python."""
    import shlex

    options = ["--user", "--break-system-packages"] if _is_managed_by_system() else []
    words = [sys.executable, "-m", "pip", "install", *options, *arguments]
    return shlex.join(words)


def _installed() -> str:
    """Return this package's name for pip: the distribution, or the path of the checkout."""
    from importlib.metadata import PackageNotFoundError, distribution

    try:
        distribution(_DISTRIBUTION)
    except PackageNotFoundError:
        return str(Path(__file__).resolve().parents[2])
    return _DISTRIBUTION


def _is_managed_by_system() -> bool:
    """Return whether pip refuses to install into the system's Python (PEP 668)."""
    import sysconfig

    marker = Path(sysconfig.get_path("stdlib")) / "EXTERNALLY-MANAGED"
    return sys.prefix == sys.base_prefix and marker.exists()


def _has_numpy_1() -> bool:
    import numpy as np

    return np.__version__.startswith("1.")
