"""Exit status of programs, and errors as one line instead of a traceback.

This module does not import typer, because the live evaluator runs without it.
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

    The status is 2 after an error of the input or of a file, and 130 after Ctrl-C.

    Args:
        work: The program. It returns its status, or None for 0.
    """
    if sys.stdout is None:  # closed, as by `>&-`
        sys.stdout = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 - open until exit
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
    if status == INTERRUPTED:  # also returned by `cli.app`, because typer catches Ctrl-C
        print("trajeval: interrupted", file=sys.stderr)
    return status or 0


def _fail(sentence: str) -> int:
    with may_break():
        print(f"trajeval: {visible(' '.join(sentence.split()))}", file=sys.stderr)
    return 2
