"""Output that nobody reads to its end."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def may_break() -> Iterator[None]:
    """Print in the block, and go on where whoever reads has seen enough, as `head` does.

    What is said on stderr may end there as well, as with `2>&1 | head`.
    """
    try:
        yield
        sys.stdout.flush()
    except (BrokenPipeError, SystemExit) as error:
        # rich, which prints tables and help, makes the one into the other.
        if isinstance(error, SystemExit) and not isinstance(error.__context__, BrokenPipeError):
            raise
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for stream in (sys.stdout, sys.stderr):
            if _has_no_reader(stream.fileno()):
                os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def _has_no_reader(file: int) -> bool:
    poll = select.poll()
    poll.register(file, 0)
    return bool(poll.poll(0))
