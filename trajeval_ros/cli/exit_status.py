"""How programs end: with a status, and one line instead of a traceback for a user's mistake.

The library of the command line isn't imported: the node starts without it.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

from trajeval_ros.cli.pipes import may_break
from trajeval_ros.exceptions import TrajevalError, reason_of
from trajeval_ros.formatting.escaping import visible

INTERRUPTED = 130


def exit_status(work: Callable[[], int | None]) -> int:
    """Run a program and return its exit status.

    Args:
        work: Does it, and returns a status or None for 0.
    """
    if sys.stdout is None:  # closed, as by `>&-`
        sys.stdout = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 - till the end
    status = None
    try:
        with may_break():
            status = work()
    except TrajevalError as error:
        return _fail(str(error))
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _fail(f"{where}{reason_of(error)}")
    except KeyboardInterrupt:
        status = INTERRUPTED
    if status == INTERRUPTED:  # or so says the command line's library, which catches Ctrl-C itself
        print("trajeval: interrupted", file=sys.stderr)
    return status or 0


def _fail(sentence: str) -> int:
    with may_break():
        print(f"trajeval: {visible(' '.join(sentence.split()))}", file=sys.stderr)
    return 2
