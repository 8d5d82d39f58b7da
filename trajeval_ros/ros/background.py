"""Computations that are too slow for a tick, on a thread with limited CPU time."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

from trajeval_ros.exceptions import describe_defect

Result = TypeVar("Result")


class BackgroundTask(Generic[Result]):
    """Runs one computation at a time on its own thread.

    An exception ends the computation, but not the node: it has no result, and `trouble` is set.
    """

    def __init__(self, most_share: float) -> None:
        self.trouble = ""  # why the newest computation has failed; empty if it has not
        self._threads = ThreadPoolExecutor(1, thread_name_prefix="background")
        self._share = most_share
        self._running: Future[tuple[Result | None, str, float]] | None = None
        self._next_at = 0.0

    @property
    def is_due(self) -> bool:
        """Whether a computation may be started now."""
        return self._running is None and time.monotonic() >= self._next_at

    def start(self, compute: Callable[[], Result]) -> None:
        """Start a computation. It must not use data that other threads change."""

        def guarded() -> tuple[Result | None, str, float]:
            begin, result, trouble = time.thread_time(), None, ""
            try:
                result = compute()
            except Exception as error:
                trouble = describe_defect(error)
            return result, trouble, time.thread_time() - begin

        self._running = self._threads.submit(guarded)

    def take(self) -> Result | None:
        """Return the result of a finished computation; None if there is none."""
        return self.wait() if self._running is not None and self._running.done() else None

    def wait(self) -> Result | None:
        """Wait for the running computation and return its result; None if there is none."""
        if self._running is None:
            return None
        (result, self.trouble, took_s), self._running = self._running.result(), None
        self._next_at = time.monotonic() + took_s / self._share
        return result

    def close(self) -> None:
        """Stop the thread after the running computation, without waiting for it."""
        self._threads.shutdown(wait=False)
