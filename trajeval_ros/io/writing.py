"""Files written whole or not at all, and what a disk refuses in one sentence."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

from trajeval_ros.exceptions import InputError, reason_of
from trajeval_ros.io.temporary import temporary_file


def write_text(path: Path, text: str, *, follow_link: bool = False) -> None:
    """Write a file whole or not at all, as `write_whole` does."""
    write_whole(
        path,
        lambda temporary: temporary.write_text(text, encoding="utf-8"),
        follow_link=follow_link,
    )


def write_whole(path: Path, write: Callable[[Path], object], *, follow_link: bool = False) -> None:
    """Let `write` make a file under a temporary name beside `path`, then give it that name.

    A pipe or a device is written to as it is.

    Args:
        path: The file.
        write: Called with the temporary name.
        follow_link: For a file that the user named: a link stays one, and what it leads to is
            replaced. In a folder of results a link is replaced itself, since whoever placed it
            must not choose what else is written over.

    Raises:
        InputError: The file can't be written.
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
    """State in one sentence that something can't be written in the block.

    Raises:
        InputError: It can't.
    """
    try:
        yield
    except OSError as error:
        raise InputError(f"{what} can't be written: {reason_of(error)}") from error
