"""Files and folders that are not finished yet, and what killed processes left of them.

Each is called `.NAME.trajeval-` and eight random digits, and its writer holds a lock on it. One
whose lock is free has lost its writer, and is removed when a process writes there for the first
time.
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

from trajeval_ros.io.file_lock import is_at, lock

_NAME = re.compile(r"\..*\.trajeval-[0-9a-f]{8}", re.DOTALL)


@contextlib.contextmanager
def temporary_file(path: Path) -> Iterator[Path]:
    """Yield an empty file beside `path`, removed after the block unless it was renamed."""
    with _locked(path.parent, path.name, _make_file) as file:
        try:
            yield file
        finally:
            with contextlib.suppress(OSError):
                file.unlink()


@contextlib.contextmanager
def temporary_folder(name: str, parent: Path | None = None) -> Iterator[Path]:
    """Yield an empty folder, removed after the block with all that is in it.

    Args:
        name: What it is for; part of its name.
        parent: Where; by default where the system has temporary files.
    """
    with _locked(parent or Path(tempfile.gettempdir()), name, _make_folder) as folder:
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def collect_leftovers(folder: Path) -> None:
    """Remove what processes that are gone had not finished in a folder."""
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for name in [each.name for each in entries if _NAME.fullmatch(each.name)]:
            _remove_if_left(folder / name)


# A folder of ten thousand records is not to be looked through for each of them.
_collect_once = functools.cache(collect_leftovers)


@contextlib.contextmanager
def _locked(parent: Path, name: str, make: Callable[[Path], int]) -> Iterator[Path]:
    _collect_once(parent.resolve())
    while True:
        path = parent / f".{name}.trajeval-{secrets.token_hex(4)}"
        file = make(path)
        try:
            # Where the disk knows no locks, nobody takes it for left over either.
            with contextlib.suppress(OSError):
                lock(file, wait=True)
            # Before it had its lock, another process may have taken it for left over.
            if is_at(path, file):
                yield path
                return
        finally:
            os.close(file)


def _make_file(path: Path) -> int:
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)


def _make_folder(path: Path) -> int:
    path.mkdir(0o700)
    return os.open(path, os.O_RDONLY)


def _remove_if_left(path: Path) -> None:
    """Remove a file or folder whose lock is free; what belongs to other users stays."""
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
