"""Locks on files and folders that the system releases when their process ends.

A stored process id is not reliable: the system may have given it to another process. A lock is
released by the system at the end of its process, also after `kill -9`.
"""

from __future__ import annotations

import os
from pathlib import Path

try:
    import fcntl
except ImportError:  # not a POSIX system
    fcntl = None  # type: ignore[assignment]


def lock(file: int, *, wait: bool) -> bool:
    """Take an exclusive lock on an open file or folder.

    Args:
        file: Open descriptor. The lock is held until it is closed.
        wait: Whether to wait until another process releases the lock.

    Returns:
        Whether the lock was taken.

    Raises:
        OSError: The system or the file system does not support locks.
    """
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
