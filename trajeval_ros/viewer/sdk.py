"""Rerun's SDK, an optional package that is imported when it is used."""

from __future__ import annotations

import os
from functools import cache
from importlib.util import find_spec
from typing import Any

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.install_command import extra_command, install_command


def is_installed() -> bool:
    """Return whether rerun-sdk is installed, without importing it, which is slow."""
    return find_spec("rerun") is not None


@cache
def sdk() -> tuple[Any, Any]:
    """Return the modules `rerun` and `rerun.blueprint`."""
    # It reads this at import. Its log is verbose; this package reports one sentence instead.
    is_ours = "RUST_LOG" not in os.environ
    os.environ.setdefault("RUST_LOG", "off")
    try:
        import rerun
        import rerun.blueprint
    except ImportError as error:
        if is_installed():
            raise InputError(
                f"rerun-sdk can't be imported ({error}); with numpy 1, install an older pyarrow: "
                f"{install_command('pyarrow>=18,<26')}"
            ) from error
        raise InputError(
            f"output for Rerun needs rerun-sdk; install it: {extra_command('rerun')}"
        ) from error
    finally:
        if is_ours:
            del os.environ["RUST_LOG"]
    # It flushes all recordings when Python ends, which hangs where a viewer doesn't read. Ours
    # are closed one by one.
    rerun.unregister_shutdown()
    return rerun, rerun.blueprint
