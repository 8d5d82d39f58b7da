"""Count of the bytes that are fetched from remote stores."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar


class FetchedBytes:
    """A thread-safe counter of bytes.

    Attributes:
        total: Bytes of objects, without protocol headers and listings.
    """

    def __init__(self) -> None:
        self.total = 0
        self._lock = threading.Lock()

    def add(self, count: int) -> None:
        """Add `count` bytes to the total."""
        with self._lock:
            self.total += count


_COUNTER: ContextVar[FetchedBytes] = ContextVar("fetched_bytes", default=FetchedBytes())  # noqa: B039


def current_counter() -> FetchedBytes:
    """Return the counter of the innermost block of `counting_fetched_bytes`."""
    return _COUNTER.get()


@contextmanager
def counting_fetched_bytes() -> Iterator[FetchedBytes]:
    """Count the bytes of the remote objects that this thread opens in the block."""
    counter = FetchedBytes()
    token = _COUNTER.set(counter)
    try:
        yield counter
    finally:
        _COUNTER.reset(token)
