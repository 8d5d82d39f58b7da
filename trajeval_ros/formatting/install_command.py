"""The command that installs what is missing, for whatever way this package was installed."""

from __future__ import annotations

import sys
from pathlib import Path

_DISTRIBUTION = "trajeval-ros"
# What still works with numpy 1, which ROS 2 Jazzy's message packages are built for.
_PYARROW_BESIDE_NUMPY_1 = "pyarrow<26"
_BESIDE_NUMPY_1 = dict.fromkeys(("compare", "cluster"), (_PYARROW_BESIDE_NUMPY_1,))
_RERUN_BESIDE_NUMPY_1 = (
    "--no-deps",
    "rerun-sdk==0.39.*" if sys.version_info < (3, 11) else "rerun-sdk>=0.41",
    *("pyarrow>=18,<26", "attrs>=23.1", "pillow>=8", "psutil>=7", "typing-extensions>=4.5"),
)


def extra_command(extra: str) -> str:
    """Return the command that installs an extra of this package, such as `plot`.

    Pip takes the requirements from the package that is installed: from a checkout, from a wheel,
    or in a ROS workspace, where it is on `PYTHONPATH`.
    """
    beside_numpy_1 = _has_numpy_1()
    if extra == "rerun" and beside_numpy_1:
        return install_command(*_RERUN_BESIDE_NUMPY_1)
    more = _BESIDE_NUMPY_1.get(extra, ()) if beside_numpy_1 else ()
    return install_command(f"{_installed()}[{extra}]", *more)


def pyarrow_command() -> str:
    """Return the command that installs a pyarrow that works beside the numpy that is here."""
    return install_command(_PYARROW_BESIDE_NUMPY_1 if _has_numpy_1() else "pyarrow")


def install_command(*arguments: str) -> str:
    """Return the command that installs requirements for the Python that runs this."""
    import shlex

    options = ["--user", "--break-system-packages"] if _is_managed_by_system() else []
    words = [sys.executable, "-m", "pip", "install", *options, *arguments]
    return shlex.join(words)


def _installed() -> str:
    """Return what pip calls this package: its name, or the checkout where it isn't installed."""
    from importlib.metadata import PackageNotFoundError, distribution

    try:
        distribution(_DISTRIBUTION)
    except PackageNotFoundError:
        return str(Path(__file__).resolve().parents[2])
    return _DISTRIBUTION


def _is_managed_by_system() -> bool:
    """Return whether pip refuses to install beside the system's packages (PEP 668)."""
    import sysconfig

    marker = Path(sysconfig.get_path("stdlib")) / "EXTERNALLY-MANAGED"
    return sys.prefix == sys.base_prefix and marker.exists()


def _has_numpy_1() -> bool:
    import numpy as np

    return np.__version__.startswith("1.")
