"""The command line. User errors are printed in one line, without a traceback."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Annotated

import typer

from trajeval_ros import __version__
from trajeval_ros.cli.exit_status import INTERRUPTED, exit_status
from trajeval_ros.cli.verbs import MARKUP, VERBS, VerbGroup, verb
from trajeval_ros.exceptions import SettingsError

app = typer.Typer(
    name="trajeval",
    no_args_is_help=True,
    cls=VerbGroup,
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode=MARKUP,
    pretty_exceptions_enable=False,
)

_COMPLETION = "_TRAJEVAL_COMPLETE"
_NO_ARGUMENTS = 2
# click's class of usage errors: newer versions of typer contain a copy of click, older ones import
# it.
_UsageError: type[Exception] = typer.BadParameter.__mro__[1]


@app.callback(invoke_without_command=True)
def _version(
    version: Annotated[bool, typer.Option("--version", help="Prints the version.")] = False,
) -> None:
    """Measures the error of VIO and SLAM trajectories, live on the robot or from recordings."""
    if version:
        print(f"trajeval_ros {__version__}")
        raise typer.Exit


def load(arguments: Sequence[str]) -> None:
    """Import the requested verb, or all verbs if the help lists them.

    Nothing is imported for an unknown verb, or for shell completion, which reads the options of at
    most one verb.
    """
    first = next(iter(arguments), "--help")
    if _COMPLETION not in os.environ:
        for name in VERBS if first.startswith("-") else VERBS.keys() & {first}:
            verb(name)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status: 0, 1 unmet requirement, 2 bad input."""
    return exit_status(lambda: _run(arguments))


def _run(arguments: Sequence[str] | None) -> int | None:
    try:
        status = app(args=arguments, standalone_mode=False, prog_name="trajeval")
    except _UsageError as error:
        message: str = error.format_message().rstrip(".")  # type: ignore[attr-defined]
        if not message:  # no arguments: the help is printed instead
            return _NO_ARGUMENTS
        context = getattr(error, "ctx", None)
        command = context.command_path if context else "trajeval"
        lower = message[0].lower() + message[1:]
        raise SettingsError(f"{lower} (try {command} --help)") from error
    except typer.Abort:
        status = INTERRUPTED
    return status if isinstance(status, int) else None
