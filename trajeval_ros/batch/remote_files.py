"""Files in remote stores, which fsspec reads by their URLs, and the hosts that they may name.

Only hosts that the command line allows are contacted. Otherwise an untrusted file makes this
machine contact any host with the user's credentials.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.formatting.install_command import extra_command
from trajeval_ros.io.sources import require_no_password

_HOST = re.compile(r"([a-zA-Z][a-zA-Z0-9+.-]*)://([^/]+)")
_OF_THIS_MACHINE = ("file", "local", "memory")
_MOST_QUOTED = 200  # characters of a store's own message


@contextmanager
def open_store(url: str) -> Iterator[tuple[Any, str]]:
    """Yield the file system of a URL, and the path in it; errors in the block name the URL."""
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
    """Check that fsspec reads URLs of this scheme, without contacting a host."""
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


def parse_hosts(texts: Iterable[str]) -> frozenset[str]:
    """Return hosts, or buckets, as `SCHEME://HOST`."""
    hosts = set()
    for text in texts:
        match = _HOST.fullmatch(text.removesuffix("/"))
        if match is None:
            raise SettingsError(
                f"--allow-remote {text} is not a host; write SCHEME://HOST, as in s3://bucket"
            )
        hosts.add(_name(match))
    return frozenset(hosts)


def host_of(url: str) -> frozenset[str]:
    """Return the host of a URL in the form of `parse_hosts`; empty if it has none."""
    match = _HOST.match(url)
    return frozenset() if match is None else frozenset({_name(match)})


def require_allowed(url: str, allowed: Collection[str], where: str) -> None:
    """Check that a URL has no secret and refers to this machine or to an allowed host.

    `url`: the URL, which may have placeholders.
    """
    require_no_password(url)
    if "::" in url:  # fsspec contacts all of them
        raise InputError(f"{where}: {url} is a chain of URLs; give one URL without '::'")
    if url.partition("://")[0].lower() in _OF_THIS_MACHINE:
        return
    match = _HOST.match(url)
    if match is None:
        raise InputError(f"{where}: {url} has no host; write it as in s3://bucket/file")
    if _name(match) not in allowed:
        raise InputError(
            f"{where} has the remote URL {url}; if you trust the file, add --allow-remote "
            f"{_name(match)}"
        )


def _name(match: re.Match[str]) -> str:
    return f"{match[1].lower()}://{match[2]}"
