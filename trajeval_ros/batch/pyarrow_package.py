"""pyarrow, an optional package that is imported where tables are read or written."""

from __future__ import annotations

from typing import Any

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.install_command import extra_command, pyarrow_command


def load_pyarrow() -> tuple[Any, Any]:
    """Return pyarrow and its Parquet part.

    Raises:
        InputError: It is not installed, or needs another version of numpy.
    """
    try:
        import pyarrow
        from pyarrow import parquet
    except ModuleNotFoundError as error:
        raise InputError(
            f"trajeval compare needs pyarrow; install it: {extra_command('compare')}"
        ) from error
    except ImportError as error:
        raise InputError(
            f"pyarrow is installed but can't be used ({error}): {pyarrow_command()}"
        ) from error
    return pyarrow, parquet
