"""Files in remote stores, which fsspec reads by their URLs."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.install_command import extra_command

_MOST_QUOTED = 200  # characters of a store's own message


@contextmanager
def open_store(url: str) -> Iterator[tuple[Any, str]]:
    """Yield the file system of a URL, and the path in it; errors in the block name the URL.

    Raises:
        InputError: A package is missing, or the store can't be read.
    """
    try:
        from fsspec.core import url_to_fs

        yield url_to_fs(url)
    except InputError:
        raise
    except ImportError as error:
        raise InputError(f"{url} can't be read: {_missing(error)}") from error
    except FileNotFoundError as error:
        raise InputError(f"{url} does not exist; check the URL") from error
    except Exception as error:  # every kind of store has its own
        reason = " ".join(str(error).split())[:_MOST_QUOTED]
        raise InputError(f"{url} can't be read: {reason}") from error


def require_readable_scheme(url: str, where: str) -> None:
    """Check that fsspec reads URLs of this scheme, without contacting a host.

    Args:
        url: The URL.
        where: The place that names it.

    Raises:
        InputError: The scheme is unknown, or its package is missing.
    """
    problem = _problem_of(url.partition("://")[0].lower())
    if problem:
        raise InputError(f"{where}: {url} can't be read: {problem}")


@functools.cache
def _problem_of(scheme: str) -> str:
    try:
        from fsspec import get_filesystem_class

        get_filesystem_class(scheme)
    except ImportError as error:
        return _missing(error)
    except ValueError:
        return f"the scheme {scheme} is unknown; use one of fsspec, such as s3 or https"
    return ""


def _missing(error: ImportError) -> str:
    return f"{error}; {extra_command('remote')}, or install the fsspec package of that protocol"
