"""Output to a pipe that its reader closes early."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def may_break() -> Iterator[None]:
    """Continue after the block if the reader of its output closes the pipe, as `head` does.

    Then stdout, and stderr if it has the same reader (`2>&1 | head`), are redirected to /dev/null.
    """
    try:
        yield
        sys.stdout.flush()
    except (BrokenPipeError, SystemExit) as error:
        # rich, which prints tables and help, raises SystemExit after a BrokenPipeError.
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
