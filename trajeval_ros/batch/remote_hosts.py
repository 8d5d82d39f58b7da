"""Hosts that the file of a comparison may make this machine ask: those that its user names.

Else a file from elsewhere could make this machine ask any host, with its user's credentials.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable

from trajeval_ros.exceptions import InputError, SettingsError

_HOST = re.compile(r"([a-zA-Z][a-zA-Z0-9+.-]*)://([^/]+)")
_OF_THIS_MACHINE = ("file", "local", "memory")


def parse_hosts(texts: Iterable[str]) -> frozenset[str]:
    """Return hosts, or buckets, as `SCHEME://HOST`.

    Raises:
        SettingsError: One is written otherwise.
    """
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
    """Return the host of a URL that the user's own command names; nothing if it has none."""
    match = _HOST.match(url)
    return frozenset() if match is None else frozenset({_name(match)})


def require_allowed(url: str, allowed: Collection[str], where: str) -> None:
    """Check that a URL is of this machine, or of a host that is allowed.

    Args:
        url: May hold placeholders, but none in an allowed host.
        allowed: As of `parse_hosts`.
        where: What names the URL.

    Raises:
        InputError: It is of another host.
    """
    if "::" in url:  # fsspec would ask each of them
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
