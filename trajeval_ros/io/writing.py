"""Atomic writing of files, and one-sentence messages about files that can't be written."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

from trajeval_ros.exceptions import InputError, reason_of
from trajeval_ros.io.temporary import temporary_file


def write_text(path: Path, text: str, *, follow_link: bool = False) -> None:
    """Write a text in UTF-8 completely or not at all, as `write_whole` does."""
    write_whole(
        path,
        lambda temporary: temporary.write_text(text, encoding="utf-8"),
        follow_link=follow_link,
    )


def write_whole(path: Path, write: Callable[[Path], object], *, follow_link: bool = False) -> None:
    """Write a file under a temporary name in the same folder, then rename it to `path`.

    A pipe or a device is written directly.

    Args:
        write: Function that writes the file; called with the temporary path.
        follow_link: Whether to replace the target of a link. Use it only for files that the
            user named. Otherwise the link itself is replaced: a link in a folder of results is
            untrusted and must not select another file to overwrite.
    """
    if follow_link or not path.is_symlink():
        if path.is_dir():
            raise InputError(f"{path} can't be written: is a directory; give a file")
        if path.exists() and not path.is_file():
            with refused_by_disk(str(path)):
                write(path)
            return
        if path.is_symlink():
            path = path.resolve()
    with refused_by_disk(str(path)), temporary_file(path) as temporary:
        write(temporary)
        temporary.replace(path)


@contextlib.contextmanager
def refused_by_disk(what: str) -> Iterator[None]:
    """Convert an OSError in the block to a one-sentence InputError."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{what} can't be written: {reason_of(error)}") from error
