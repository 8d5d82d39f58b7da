"""Atomic writing of files, by temporary files that killed processes may leave behind.

A temporary file is named `.NAME.trajeval-` and eight random hexadecimal digits. Its writer holds
a lock on it. If the lock is free, the writer has ended. A process removes such files the first
time that it writes to their folder. Files that can't be written give a message of one sentence.
"""

from __future__ import annotations

import contextlib
import functools
import os
import re
import secrets
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from trajeval_ros.exceptions import InputError, reason_of

try:
    import fcntl
except ImportError:  # not a POSIX system
    fcntl = None  # type: ignore[assignment]

_MOST_REMOVED = 100  # folders in succession that other processes remove
_NAME = re.compile(r"\..*\.trajeval-[0-9a-f]{8}", re.DOTALL)


def lock(file: int, *, wait: bool) -> bool:
    """Take an exclusive lock on an open file or folder; return whether it was taken."""
    if fcntl is None:
        raise OSError("this system does not support file locks")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        return False
    return True


def is_at(path: Path, file: int) -> bool:
    """Return whether `path` is still the open file or folder `file`.

    During the wait for a lock, another process can remove the file.
    """
    try:
        return os.path.samestat(path.lstat(), os.fstat(file))
    except FileNotFoundError:
        return False


@contextlib.contextmanager
def temporary_file(path: Path) -> Iterator[Path]:
    """Yield an empty file next to `path`; it is removed after the block if it is still there."""
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL
    with _locked(path.parent, path.name, lambda made: os.open(made, flags, 0o666)) as file:
        try:
            yield file
        finally:
            with contextlib.suppress(OSError):
                file.unlink()


@contextlib.contextmanager
def temporary_folder(name: str, parent: Path | None = None) -> Iterator[Path]:
    """Yield an empty folder; it is removed with its contents after the block.

    `parent`: parent folder; by default the system's folder for temporary files.
    """
    with _locked(parent or Path(tempfile.gettempdir()), name, _make_folder) as folder:
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def collect_leftovers(folder: Path) -> None:
    """Remove the temporary files in a folder whose writers have ended."""
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for name in [entry.name for entry in entries if _NAME.fullmatch(entry.name)]:
            _remove_if_left(folder / name)


# A folder can have ten thousand records: it is listed once, not at every write.
_collect_once = functools.cache(collect_leftovers)


@contextlib.contextmanager
def _locked(parent: Path, name: str, make: Callable[[Path], int]) -> Iterator[Path]:
    _collect_once(parent.resolve())
    removed = 0
    while True:
        path = parent / f".{name}.trajeval-{secrets.token_hex(4)}"
        try:
            file = make(path)
        except FileNotFoundError:
            # Another process can remove a folder before it is opened and locked. In /proc, no
            # folder can be made.
            removed += 1
            if removed < _MOST_REMOVED and parent.is_dir():
                continue
            raise
        try:
            # If the file system has no locks, no process removes the file either.
            with contextlib.suppress(OSError):
                lock(file, wait=True)
            # Another process can remove the file before it is locked.
            if is_at(path, file):
                yield path
                return
        finally:
            os.close(file)


def _make_folder(path: Path) -> int:
    path.mkdir(0o700)
    return os.open(path, os.O_RDONLY)


def _remove_if_left(path: Path) -> None:
    """Remove a file or folder if its lock is free; files that can't be opened are kept."""
    with contextlib.suppress(OSError):
        is_folder = stat.S_ISDIR(path.lstat().st_mode)
        how = os.O_RDONLY if is_folder else os.O_RDWR
        file = os.open(path, how | os.O_NOFOLLOW | os.O_NONBLOCK)
        try:
            if lock(file, wait=False) and is_at(path, file):
                if is_folder:
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    path.unlink()
        finally:
            os.close(file)


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
