"""What takes longer than a tick may: on a thread of its own, at a bounded share of a core."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

Found = TypeVar("Found")


class BackgroundTask(Generic[Found]):
    """Runs one computation at a time on a thread of its own."""

    def __init__(self, most_share: float) -> None:
        """Create it idle.

        Args:
            most_share: Of a core, which all computations together take at the most.
        """
        self._threads = ThreadPoolExecutor(1, thread_name_prefix="background")
        self._share = most_share
        self._running: Future[tuple[Found, float]] | None = None
        self._next_at = 0.0

    @property
    def is_due(self) -> bool:
        """Whether something may be started."""
        return self._running is None and time.monotonic() >= self._next_at

    def start(self, compute: Callable[[], Found]) -> None:
        """Start a computation, which must touch nothing that changes meanwhile."""

        def timed() -> tuple[Found, float]:
            begin = time.thread_time()
            return compute(), time.thread_time() - begin

        self._running = self._threads.submit(timed)

    def take(self) -> Found | None:
        """Return what has been found since the last call; None if nothing has."""
        return self.wait() if self._running is not None and self._running.done() else None

    def wait(self) -> Found | None:
        """Return what is being computed, when it is there; None if nothing is."""
        if self._running is None:
            return None
        (found, took_s), self._running = self._running.result(), None
        self._next_at = time.monotonic() + took_s / self._share
        return found

    def close(self) -> None:
        """Start nothing more, and wait for nothing."""
        self._threads.shutdown(wait=False)
