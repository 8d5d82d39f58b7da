"""The verbs, and one line instead of a traceback for a user's mistake."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from trajeval_ros import __version__
from trajeval_ros.cli.compare import compare
from trajeval_ros.cli.compare_association import compare_association
from trajeval_ros.cli.demo import demo
from trajeval_ros.cli.edit_trajectories import trajectory
from trajeval_ros.cli.evaluate import evaluate
from trajeval_ros.cli.finish import finish
from trajeval_ros.cli.gauge_study import gauge_study
from trajeval_ros.cli.info import info
from trajeval_ros.cli.live_evaluator import HELP as EVALUATOR_HELP
from trajeval_ros.cli.live_evaluator import evaluator
from trajeval_ros.cli.pipes import may_break
from trajeval_ros.cli.replay import RosCommand, replay
from trajeval_ros.cli.simulate import simulate
from trajeval_ros.cli.view import view
from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.formatting.escaping import visible

app = typer.Typer(
    name="trajeval",
    no_args_is_help=True,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
)
app.command()(compare)
app.command()(evaluate)
app.command()(compare_association)
app.command()(demo)
app.command(cls=RosCommand, help=EVALUATOR_HELP)(evaluator)
app.command()(finish)
app.command()(gauge_study)
app.command()(info)
app.command(cls=RosCommand)(replay)
app.command()(simulate)
app.command()(trajectory)
app.command()(view)

_INTERRUPTED = 130
# click's class of usage errors, which newer typer bundles and older typer imports.
_UsageError: type[Exception] = typer.BadParameter.__mro__[1]


@app.callback(invoke_without_command=True)
def _version(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    """Evaluate VIO and SLAM trajectories: how wrong, by which definition, over how much."""
    if version:
        print(f"trajeval_ros {__version__}")
        raise typer.Exit


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status: 0, 1 unmet requirement, 2 bad input."""
    status = None
    if sys.stdout is None:  # closed, as by `>&-`
        sys.stdout = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 - till the end
    try:
        with may_break():
            status = app(args=arguments, standalone_mode=False, prog_name="trajeval")
    except TrajevalError as error:
        return _fail(str(error))
    except _UsageError as error:
        message: str = error.format_message()  # type: ignore[attr-defined]
        context = getattr(error, "ctx", None)
        command = context.command_path if context else "trajeval"
        return _fail(f"{message.rstrip('.')} (try {command} --help)")
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _fail(f"{where}{(error.strerror or str(error)).lower()}")
    except (KeyboardInterrupt, typer.Abort):
        status = _INTERRUPTED
    if status == _INTERRUPTED:  # or so says typer, which catches Ctrl-C itself
        print("trajeval: interrupted", file=sys.stderr)
    return status if isinstance(status, int) else 0


def _fail(sentence: str) -> int:
    with may_break():
        print(f"trajeval: {visible(' '.join(sentence.split()))}", file=sys.stderr)
    return 2
