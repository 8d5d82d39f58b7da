"""Computations that are too slow for a tick, on a thread with limited CPU time."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

Found = TypeVar("Found")


class BackgroundTask(Generic[Found]):
    """Runs one computation at a time on its own thread."""

    def __init__(self, most_share: float) -> None:
        self._threads = ThreadPoolExecutor(1, thread_name_prefix="background")
        self._share = most_share
        self._running: Future[tuple[Found, float]] | None = None
        self._next_at = 0.0

    @property
    def is_due(self) -> bool:
        """Whether a computation may be started now."""
        return self._running is None and time.monotonic() >= self._next_at

    def start(self, compute: Callable[[], Found]) -> None:
        """Start a computation. It must not use data that other threads change."""

        def timed() -> tuple[Found, float]:
            begin = time.thread_time()
            return compute(), time.thread_time() - begin

        self._running = self._threads.submit(timed)

    def take(self) -> Found | None:
        """Return the result of a finished computation; None if there is none."""
        return self.wait() if self._running is not None and self._running.done() else None

    def wait(self) -> Found | None:
        """Wait for the running computation and return its result; None if there is none."""
        if self._running is None:
            return None
        (found, took_s), self._running = self._running.result(), None
        self._next_at = time.monotonic() + took_s / self._share
        return found

    def close(self) -> None:
        """Stop the thread after the running computation, without waiting for it."""
        self._threads.shutdown(wait=False)
