"""What all programs have: exit status, errors as one line, closed pipes, ROS arguments.

The live evaluator's program is here, too: `ros2 run trajeval_ros evaluator` runs on machines with
only ROS packages, so this module does not import click.
"""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from trajeval_ros.exceptions import SettingsError, TrajevalError, reason_of

INTERRUPTED = 130
_ROS_ARGUMENTS = "--ros-args"


def exit_status(work: Callable[[], int | None]) -> int:
    """Run a program, which returns its status or None for 0, and return its exit status.

    The status is 2 after an error of the input or of a file, and 130 after Ctrl-C.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed, as by `>&-`
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115
    status = None
    try:
        with may_break():
            status = work()
    except TrajevalError as error:
        _write_traceback(error)
        return _fail(str(error))
    except OSError as error:
        _write_traceback(error)
        where = f"{error.filename}: " if error.filename else ""
        return _fail(f"{where}{reason_of(error)}")
    except KeyboardInterrupt:
        status = INTERRUPTED
    except (RuntimeError, ImportError) as error:
        # An interrupt during an import: Python 3.11 wraps it for classes, pybind11 for modules.
        if not isinstance(error.__cause__, KeyboardInterrupt):
            raise
        status = INTERRUPTED
    if status == INTERRUPTED:  # also returned by `cli.app`, because click catches Ctrl-C
        print("trajeval: interrupted", file=sys.stderr)
    return status or 0


class Debugging:
    """Where the traceback of an error is written."""

    path: Path | None = None  # file of --debug


def _write_traceback(error: Exception) -> None:
    """Write where an error comes from, if --debug names a file; causes are included."""
    if Debugging.path is None:
        return
    import traceback

    from trajeval_ros.formatting.escaping import without_secrets
    from trajeval_ros.io.writing import write_text

    cause: BaseException | None = error
    known = set()
    while cause is not None and id(cause) not in known:  # causes can form a circle
        known.add(id(cause))
        cause.__suppress_context__ = False
        cause = cause.__cause__ or cause.__context__
    text = "".join(traceback.format_exception(error))
    try:
        write_text(Debugging.path, without_secrets(text), follow_link=True)
    except TrajevalError as refusal:
        _fail(str(refusal))


def _fail(sentence: str) -> int:
    from trajeval_ros.formatting.escaping import without_secrets
    from trajeval_ros.report.console import ERROR, console

    with may_break():
        text = without_secrets(f"trajeval: {' '.join(sentence.split())}")
        console(sys.stderr).print(text, ERROR, soft_wrap=True)
    return 2


@contextmanager
def may_break() -> Iterator[None]:
    """Continue after the block if the reader of its output closes the pipe, as `head` does.

    Then stdout, and stderr if it has the same reader (`2>&1 | head`), are redirected to /dev/null.
    """
    try:
        yield
        sys.stdout.flush()
    except (BrokenPipeError, SystemExit) as error:
        # rich raises SystemExit after a BrokenPipeError.
        if isinstance(error, SystemExit) and not isinstance(error.__context__, BrokenPipeError):
            raise
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for stream in (sys.stdout, sys.stderr):
            if _has_no_reader(stream.fileno()):
                os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def write_json(target: str | None, content: dict[str, Any]) -> None:
    """Write JSON to a file that the user named, or to stdout for `-`; nothing for None."""
    from trajeval_ros.io.json_file import json_text

    if target == "-":
        with may_break():
            sys.stdout.write(json_text(content, indent=2))
    elif target is not None:
        from trajeval_ros.io.writing import write_text

        write_text(Path(target), json_text(content, indent=2), follow_link=True)


def _has_no_reader(file: int) -> bool:
    poll = select.poll()
    poll.register(file, 0)
    return bool(poll.poll(0))


def evaluator_main(arguments: Sequence[str]) -> int:
    """Run the live evaluator and return its exit status."""
    return exit_status(lambda: _run(arguments))


def evaluator(ros_arguments: Sequence[str]) -> int:
    """Run the live evaluator and return its exit status."""
    from trajeval_ros.ros.run import evaluate_live

    return evaluate_live(ros_arguments)


def split_ros_arguments(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the arguments before `--ros-args`, and the ROS arguments from there on."""
    given = list(arguments)
    cut = given.index(_ROS_ARGUMENTS) if _ROS_ARGUMENTS in given else len(given)
    return given[:cut], given[cut:]


def _run(arguments: Sequence[str]) -> int:
    from trajeval_ros.ros.parameter_table import HELP

    words, ros_arguments = split_ros_arguments(arguments)
    if words in (["--help"], ["-h"]):
        print(HELP)
        return 0
    if words:
        raise SettingsError(
            f"evaluator: unknown argument {' '.join(words)}; give all settings as ROS parameters, "
            "as in --ros-args -p groundtruth_topic:=/mocap/pose (see evaluator --help)"
        )
    return evaluator(ros_arguments)
