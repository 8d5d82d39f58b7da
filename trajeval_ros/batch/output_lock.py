"""One comparison at a time writes to an output folder, on this machine or another."""

from __future__ import annotations

import contextlib
import os
import platform
from collections.abc import Callable, Iterator
from pathlib import Path

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.io.file_lock import is_at, lock
from trajeval_ros.io.temporary import collect_leftovers
from trajeval_ros.io.writing import refused_by_disk

LOCK = ".compare.lock"
_MOST_READ = 200


@contextlib.contextmanager
def only_writer(
    folder: Path, subfolder: str, wait: Callable[[str], object] | None = None
) -> Iterator[None]:
    """Make a comparison's folders and lock them during the block.

    Unfinished files of killed comparisons are removed.

    Args:
        folder: Folder of the comparison.
        subfolder: Its folder of records.
        wait: Called with the holder of the lock before waiting for it; None to raise an error
            instead of waiting.

    Raises:
        InputError: Another comparison holds the lock, the folder can't be made, or the folder of
            records is a symbolic link.
    """
    records = folder / subfolder
    if records.is_symlink():
        raise InputError(f"{records} is a symbolic link; remove it")
    with refused_by_disk(f"the folder {folder}"):
        records.mkdir(parents=True, exist_ok=True)
    if not os.access(folder, os.W_OK):  # read-only: only a finished comparison can be shown
        yield
        return
    path = folder / LOCK
    while True:
        with refused_by_disk(str(path)):
            file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        try:
            _hold(file, folder, wait)
            if not is_at(path, file):  # its previous holder has removed it
                continue
            with refused_by_disk(str(path)):
                os.truncate(file, 0)
                os.write(file, f"process {os.getpid()} on {platform.node()}".encode())
            for each in (folder, records):
                collect_leftovers(each)
            try:
                yield
            finally:
                with contextlib.suppress(OSError):
                    path.unlink()
            return
        finally:
            os.close(file)


def _hold(file: int, folder: Path, wait: Callable[[str], object] | None) -> None:
    """Lock the open file, or raise an error."""
    with contextlib.suppress(OSError):  # a file system without locks
        if lock(file, wait=False):
            return
        holder = one_line(os.pread(file, _MOST_READ, 0).decode(errors="replace"))
        held = f"{folder} is in use by {holder or 'another process'}"
        if wait is None:
            raise InputError(f"{held}; wait with --wait, or choose another --output")
        wait(held)
        lock(file, wait=True)
