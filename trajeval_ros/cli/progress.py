"""A progress bar for what takes longer than a second, on a terminal only."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

PATIENCE_S = 1.0


@contextmanager
def progress(description: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a function `advance(done, total)`; silent in a pipe and for quick work."""
    if not sys.stderr.isatty():
        yield _ignore
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress

    from trajeval_ros.formatting.escaping import visible

    bar = Progress(console=Console(stderr=True), transient=True)
    task = bar.add_task(escape(visible(description)), total=None, visible=True)
    begin = time.monotonic()

    def advance(done: int, total: int) -> None:
        if time.monotonic() - begin > PATIENCE_S:
            bar.start()
            bar.update(task, completed=done, total=total)

    try:
        yield advance
    finally:
        bar.stop()


def _ignore(done: int, total: int) -> None:
    pass
