"""Locks on files and folders that the system drops with the process that holds them.

A number of a process that is written somewhere may belong to another process by now. A lock can't:
whatever ends its holder, `kill -9` included, ends the lock as well.
"""

from __future__ import annotations

import os
from pathlib import Path

try:
    import fcntl
except ImportError:  # not a POSIX system
    fcntl = None  # type: ignore[assignment]


def lock(file: int, *, wait: bool) -> bool:
    """Lock an open file or folder against all who open it on their own.

    Args:
        file: Its descriptor, which holds the lock until it is closed.
        wait: Whether to wait until whoever holds the lock drops it.

    Returns:
        Whether the lock is ours.

    Raises:
        OSError: The system or the disk knows no locks.
    """
    if fcntl is None:
        raise OSError("this system does not support file locks")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        return False
    return True


def is_at(path: Path, file: int) -> bool:
    """Return whether an open file or folder still has a name.

    Who waited for a lock may hold that of a file which was removed meanwhile.
    """
    try:
        return os.path.samestat(path.lstat(), os.fstat(file))
    except FileNotFoundError:
        return False
