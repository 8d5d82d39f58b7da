"""The command line: the verbs, and what replaces options and verbs of earlier versions.

A verb is imported only if it is requested, because its libraries load slowly. User errors are
printed in one line, without a traceback.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, Final

import click

from trajeval_ros import __version__
from trajeval_ros.cli.programs import INTERRUPTED, Debugging, exit_status
from trajeval_ros.exceptions import SettingsError

# By the end of the error message: verbs, options, and options of a verb.
_WORDS = {
    # Version 0.3.
    "use trajeval evaluate GROUNDTRUTH ESTIMATE --diagnosis": ("diagnose",),
    "Rerun's viewer has a map: trajeval view FILE.rrd": (
        "trajectory --map", "trajectory --map-bounds", "trajectory --ros_map_yaml",
    ),
    # evo; docs/coming_from.md has a table.
    "formats are detected by content: trajeval evaluate GROUNDTRUTH ESTIMATE, or trajeval "
    "trajectory FILE": ("tum", "kitti", "euroc", "bag", "bag2"),
    "use trajeval evaluate, with --protocol evo for evo's numbers": (
        "ape", "rpe", "evo_ape", "evo_rpe",
    ),
    "use trajeval trajectory": ("traj", "evo_traj"),
    "use trajeval compare RESULT...": ("res", "evo_res"),
    "give a style sheet of matplotlib: --style FILE.mplstyle": ("config",),
    "figures are not saved for later changes; draw them again": ("fig",),
    "use --gauge se3, or --gauge sim3 for -as, and --protocol evo for evo's numbers": (
        "-a", "--align",
    ),
    "use --gauge sim3 for evo's -as; for -s alone, give a file with base: evo, gauge: sim3 and "
    "apply: scale as --protocol FILE.yaml": ("-s", "--correct_scale"),
    "all details are printed; remove it": ("-v", "--verbose"),
    "use --align-states 1": ("--align_origin",),
    "use --align-states": ("--n_to_align",),
    "use --lengths, as in 8, 10f or 5deg, and --protocol evo for evo's numbers": (
        "-d", "--delta", "-u", "--delta_unit",
    ),
    "write base: evo and sub_trajectories: all to a YAML file, and give the file as --protocol "
    "FILE.yaml": ("--all_pairs",),
    "use trajeval info FILE": ("trajectory --full_check",),
    "--plot xy draws the path": ("trajectory -p",),
    "--output DIR draws figures into a folder": (
        "-p", "--save_plot", "evaluate --plot", "evaluate --plot_mode",
    ),
    "use --output DIR": ("--save_results",),
    "trajeval compare RESULT... --output DIR writes the tables": ("--save_table",),
    "use --plot xy, xz, yz or 3d": ("trajectory --plot_mode",),
    "evaluate prints errors of positions and rotations": ("-r", "--pose_relation"),
    "use --max-time-difference": ("--t_max_diff",),
    "use --time-offset": ("--t_offset",),
    "use --reference": ("trajectory --ref",),
    "give the groundtruth first, or as -g": ("evaluate --ref",),
    "use --synchronise": ("trajectory --sync",),
    "use --save-as tum": ("trajectory --save_as_tum",),
    "use --save-as kitti": ("trajectory --save_as_kitti",),
    # Options of another verb, and of other programs.
    "use trajeval evaluate --require for a run, or --baseline and --fail-if": (
        "compare --require",
    ),
    "use trajeval compare --common-time-span": ("evaluate --common-time-span",),
    "the alignment is that of the live run; for another one, use trajeval evaluate with a bag": (
        "finish --modality", "finish --gauge",
    ),
    'add to ~/.bashrc: eval "$(_TRAJEVAL_COMPLETE=bash_source trajeval)"': (
        "--install-completion",
    ),
    "run _TRAJEVAL_COMPLETE=bash_source trajeval": ("--show-completion",),
}  # fmt: skip
REPLACED: Final[dict[str, str]] = {
    word: answer for answer, words in _WORDS.items() for word in words
}
_COMPLETION = "_TRAJEVAL_COMPLETE"
_NO_ARGUMENTS = 2
# Verbs in the order of the help: module of `cli` with a command of the verb's name. A verb of two
# words is in a group.
VERBS: dict[str, str] = {
    "info": "info",
    "trajectory": "edit_trajectories",
    "evaluate": "evaluate",
    "explain": "print_explanation",
    "view": "view",
    "compare": "compare",
    "evaluator": "programs",
    "finish": "finish",
    "replay": "replay",
    "watch": "watch",
    "groundtruth": "examine_groundtruth",
    "simulate": "simulate",
    "demo": "demo",
    "study gauge": "study_gauge",
    "study association": "study_association",
}
_GROUPS = {"study": "Repeats the experiments of the papers."}


@cache
def verb(name: str) -> click.Command:
    """Import a verb of `VERBS` and return its command."""
    command: Any = getattr(
        import_module(f"trajeval_ros.cli.{VERBS[name]}"), name.replace(" ", "_")
    )
    if isinstance(command, click.Command):
        return command
    # The program of the node also runs on machines without click, so it is a function.
    from trajeval_ros.cli.command import RosCommand, ros_arguments
    from trajeval_ros.ros.parameter_table import HELP

    return RosCommand(name, params=[], callback=lambda: command(ros_arguments()), help=HELP)


class VerbGroup(click.Group):
    """All verbs, or those of a group such as `trajeval study`."""

    def __init__(self, name: str, before: str = "", **settings: Any) -> None:
        """Create it; `before` are the words before the names of its verbs in `VERBS`."""
        super().__init__(name, **settings)
        self._before = before
        names = [item.removeprefix(before) for item in VERBS if item.startswith(before)]
        # click suggests names from this dictionary for a misspelt one; `get_command` imports.
        self.commands: Any = dict.fromkeys(item.split()[0] for item in names)

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Return the verbs' names in the order of the help."""
        return list(self.commands)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """Return the verb of a name; None if there is none."""
        if self._before + cmd_name in VERBS:
            return verb(self._before + cmd_name)
        if cmd_name not in self.commands:
            return None
        return VerbGroup(cmd_name, f"{cmd_name} ", help=_GROUPS[cmd_name])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the verb, and refuse verbs of earlier versions with what replaces them."""
        if args and args[0] in REPLACED:
            raise SettingsError(f"no verb {args[0]}; {REPLACED[args[0]]}")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the verb; click would print an empty line for Ctrl-C."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            return INTERRUPTED

    def get_help(self, ctx: click.Context) -> str:
        """Return the help with the first sentence of every verb."""
        from trajeval_ros.cli.help_pages import help_of_group

        commands = {name: self.get_command(ctx, name) for name in self.commands}
        return help_of_group(self, ctx, {name: item for name, item in commands.items() if item})


def _print_version(ctx: click.Context, _: click.Parameter, is_set: bool) -> None:
    if is_set and not ctx.resilient_parsing:
        print(f"trajeval_ros {__version__}")
        ctx.exit()


def _keep_traceback(_: click.Context, __: click.Parameter, path: str | None) -> None:
    Debugging.path = None if path is None else Path(path)


app = VerbGroup(
    name="trajeval",
    help="Measures the error of VIO and SLAM trajectories, live on the robot or from recordings.",
    params=[
        click.Option(
            ["--version"],
            is_flag=True,
            is_eager=True,
            expose_value=False,
            callback=_print_version,
            help="Prints the version.",
        ),
        click.Option(
            ["--debug"],
            metavar="FILE",
            expose_value=False,
            callback=_keep_traceback,
            help="Writes the traceback of an error to FILE, for a report of a defect.",
        ),
    ],
    context_settings={"help_option_names": ["-h", "--help"]},
)


def load(arguments: Sequence[str]) -> None:
    """Import the requested verb, or all verbs if the help lists them.

    Nothing is imported for an unknown verb, or for shell completion, which reads the options of at
    most one verb.
    """
    arguments = _after_debug(arguments)
    first = next(iter(arguments), "--help")
    if _COMPLETION in os.environ:
        return
    named = VERBS.keys() & {first, " ".join(arguments[:2])}
    in_group = [name for name in VERBS if name.startswith(f"{first} ")]
    for name in VERBS if first.startswith("-") else named or in_group:
        verb(name)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status: 0, 1 unmet requirement, 2 bad input."""
    return exit_status(lambda: _run(sys.argv[1:] if arguments is None else arguments))


def _run(arguments: Sequence[str]) -> int | None:
    words = _after_debug(arguments)
    if words and words[0] not in app.commands and _is_source(words[0]):
        arguments = [*arguments[: len(arguments) - len(words)], "evaluate", *words]
    has_verb = arguments and list(arguments) not in [[name] for name in _GROUPS]
    if not has_verb and _COMPLETION not in os.environ:
        _run([*arguments, "--help"])
        return _NO_ARGUMENTS
    try:
        status = app.main(args=list(arguments), standalone_mode=False, prog_name="trajeval")
    except click.UsageError as error:
        raise SettingsError(_sentence(error)) from error
    except click.Abort:
        status = INTERRUPTED
    except SystemExit as error:  # click's answer to a closed pipe
        raise BrokenPipeError from error
    return status if isinstance(status, int) else None


def _after_debug(arguments: Sequence[str]) -> Sequence[str]:
    """Return the arguments after --debug FILE, which stands before the verb."""
    if arguments[:1] == ["--debug"]:
        return arguments[2:]
    is_joint = bool(arguments) and arguments[0].startswith("--debug=")
    return arguments[1:] if is_joint else arguments


def _is_source(word: str) -> bool:
    """Return whether a word names a file or folder, or a topic of one; verbs have no ending."""
    paths = [Path(name) for name in (word, word.partition(":")[0]) if name]
    return any(path.exists() or path.suffix for path in paths)


def _sentence(error: click.UsageError) -> str:
    """Return a usage error as one sentence, with what replaces a removed option."""
    name = error.ctx.info_name if error.ctx else ""
    if isinstance(error, click.NoSuchOption):
        option = error.option_name
        replacement = REPLACED.get(f"{name} {option}", REPLACED.get(option))
        if replacement is not None:
            return f"{name} has no option {option}; {replacement}"
        near = f"did you mean {error.possibilities[0]}? " if error.possibilities else ""
        return f"no such option: {option} ({near}try {_path(error)} --help)"
    message = error.format_message().rstrip(".")
    return f"{message[0].lower()}{message[1:]} (try {_path(error)} --help)"


def _path(error: click.UsageError) -> str:
    return error.ctx.command_path if error.ctx else "trajeval"
