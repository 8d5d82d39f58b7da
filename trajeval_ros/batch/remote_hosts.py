"""Remote hosts that the file of a comparison may name: those that the command line allows.

Otherwise an untrusted file makes this machine contact any host with the user's credentials.
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
        SettingsError: One has another form.
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
    """Return the host of a URL in the form of `parse_hosts`; empty if it has none."""
    match = _HOST.match(url)
    return frozenset() if match is None else frozenset({_name(match)})


def require_allowed(url: str, allowed: Collection[str], where: str) -> None:
    """Check that a URL refers to this machine or to an allowed host.

    Args:
        url: The URL, which may have placeholders.
        allowed: Allowed hosts, as `parse_hosts` returns them.
        where: The place that names the URL.

    Raises:
        InputError: The host is not allowed.
    """
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
