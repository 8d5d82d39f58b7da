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
from typing import Any, Final

import click

from trajeval_ros import __version__
from trajeval_ros.cli.programs import INTERRUPTED, exit_status
from trajeval_ros.exceptions import SettingsError

_COMPLETION = "_TRAJEVAL_COMPLETE"
_NO_ARGUMENTS = 2
# Verbs in the order of the help: module of `cli` with a command of the verb's name. A verb of two
# words is in a group.
VERBS: dict[str, str] = {
    "info": "info",
    "trajectory": "edit_trajectories",
    "evaluate": "evaluate",
    "diagnose": "print_diagnosis",
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

_IN_THE_FILE = "write it as a key to the YAML file, with _ for -: trajeval compare FILE.yaml"
_DETECTED = (
    "formats are detected by content: trajeval evaluate GROUNDTRUTH ESTIMATE, or trajeval "
    "trajectory FILE"
)
_EVO_SCALE = (
    "use --gauge sim3 for evo's -as; for -s alone, give a file with base: evo, gauge: sim3 and "
    "apply: scale as --protocol FILE.yaml"
)
_LENGTHS = "use --lengths, as in 8, 10f or 5deg, and --protocol evo for evo's numbers"
_IN_A_PROTOCOL = "write it to a YAML file, and give the file as --protocol FILE.yaml"
# By option, by verb and option, or by verb, of version 0.2 and of evo: the end of the error
# message.
REMOVED: Final[dict[str, str]] = {
    **dict.fromkeys(("tum", "kitti", "euroc", "bag", "bag2"), _DETECTED),
    **dict.fromkeys(
        ("ape", "rpe"), "use trajeval evaluate, with --protocol evo for evo's numbers"
    ),
    "traj": "use trajeval trajectory",
    "res": "use trajeval compare RESULT...",
    "config": "give a style sheet of matplotlib: --style FILE.mplstyle",
    "fig": "figures are not saved for later changes; draw them again",
    "compare-association": "use trajeval study association",
    "gauge-study": "use trajeval study gauge",
    "evaluate --fix": "use --correct CAUSE",
    "evaluate --estimate-scale": "use --correct CAUSE, or convert the file: trajeval trajectory "
    "--scale",
    "evaluate --groundtruth-scale": "use --correct CAUSE, or convert the file: trajeval "
    "trajectory --scale",
    "evaluate --quaternion-order": "use --correct CAUSE, or convert the file: trajeval trajectory "
    "--quaternion-order",
    "evaluate --inverse": "use --correct CAUSE, or convert the file: trajeval trajectory "
    "--inverse",
    "evaluate --estimate-axes": "use --correct CAUSE, or convert the file: trajeval trajectory "
    "--axes",
    "evaluate --clock-rate": "use --correct CAUSE, or convert the file: trajeval trajectory "
    "--clock-rate",
    "evaluate --swap": "exchange -g and -e",
    "evaluate --apply": _IN_A_PROTOCOL,
    "evaluate --ate-form": _IN_A_PROTOCOL,
    "evaluate --re-form": _IN_A_PROTOCOL,
    "evaluate --pairs": "write it as sub_trajectories to a YAML file, and give the file as "
    "--protocol FILE.yaml",
    "--integrity": "--alert-limit alone requests the test",
    "compare --figure-format": "compare writes SVG to figures/; convert it, as with rsvg-convert "
    "-f pdf",
    "compare --figure-width": "compare writes SVG to figures/, which scales to any width",
    "compare --no-title": "compare writes SVG without titles to figures/",
    "compare --style": "compare writes SVG to figures/; edit it, or draw runs with evaluate "
    "--output",
    "compare --shard": "use --cluster with a Dask cluster",
    "compare --merge": "use compare --cluster with a Dask cluster instead of shards",
    "compare --dataset": "query the files runs.parquet of several comparisons together, as in "
    "DuckDB",
    "compare --label": "name the --output of every comparison, and query their runs.parquet "
    "together",
    "compare --alert-limit": _IN_THE_FILE,
    "compare --risk": _IN_THE_FILE,
    "compare --rotation-covariance-frame": _IN_THE_FILE,
    "compare --continuous-model": _IN_THE_FILE,
    "watch --learn": "limits are fixed; watch a healthy run, and set --factor as it prints",
    "watch --limits": "limits are fixed; set --factor for this robot",
    "watch --groundtruth": "use trajeval evaluate to measure errors",
    "watch -g": "use trajeval evaluate to measure errors",
    "evaluate --watch-limits": "limits are fixed: use --watch-factor 1",
    # Options of evo, for which docs/coming_from.md has a table.
    **dict.fromkeys(
        ("-a", "--align"),
        "use --gauge se3, or --gauge sim3 for -as, and --protocol evo for evo's numbers",
    ),
    **dict.fromkeys(("-s", "--correct_scale"), _EVO_SCALE),
    "--align_origin": "use --align-states 1",
    **dict.fromkeys(("-d", "--delta", "-u", "--delta_unit"), _LENGTHS),
    "--all_pairs": "write base: evo and sub_trajectories: all to a YAML file, and give the file "
    "as --protocol FILE.yaml",
    "trajectory --full_check": "use trajeval info FILE",
    "compare --require": "use trajeval evaluate --require for a run, or --baseline and --fail-if",
    "evaluate --common-time-span": "use trajeval compare --common-time-span",
    **dict.fromkeys(
        ("finish --modality", "finish --gauge"),
        "the alignment is that of the live run; for another one, use trajeval evaluate with a bag",
    ),
    "trajectory -p": "--plot xy draws the path",
    "-p": "--output DIR draws figures into a folder",
    "evaluate --plot": "--output DIR draws figures into a folder",
    "--save_plot": "use --output DIR, which draws figures",
    "--save_results": "use --output DIR",
    "--save_table": "trajeval compare RESULT... --output DIR writes the tables",
    "evaluate --plot_mode": "--output DIR draws the views from above and from the side",
    "trajectory --plot_mode": "use --plot xy, xz, yz or 3d",
    "-r": "evaluate prints errors of positions and rotations",
    "--pose_relation": "evaluate prints errors of positions and rotations",
    "--t_max_diff": "use --max-time-difference",
    "--t_offset": "use --time-offset",
    "--n_to_align": "use --align-states",
    "trajectory --ref": "use --reference",
    "evaluate --ref": "give the groundtruth first, or as -g",
    "trajectory --sync": "use --synchronise",
    "trajectory --save_as_tum": "use --save-as tum",
    "trajectory --save_as_kitti": "use --save-as kitti",
    "--install-completion": 'add to ~/.bashrc: eval "$(_TRAJEVAL_COMPLETE=bash_source trajeval)"',
    "--show-completion": "run _TRAJEVAL_COMPLETE=bash_source trajeval",
}


@cache
def verb(name: str) -> click.Command:
    """Import a verb of `VERBS` and return its command."""
    found: Any = getattr(import_module(f"trajeval_ros.cli.{VERBS[name]}"), name.replace(" ", "_"))
    if isinstance(found, click.Command):
        return found
    # The program of the node also runs on machines without click, so it is a function.
    from trajeval_ros.cli.command import RosCommand, ros_arguments
    from trajeval_ros.ros.evaluator_help import HELP

    return RosCommand(name, params=[], callback=lambda: found(ros_arguments()), help=HELP)


class VerbGroup(click.Group):
    """All verbs, or those of a group such as `trajeval study`."""

    def __init__(self, name: str, before: str = "", **settings: Any) -> None:
        """Create it; `before` are the words before the names of its verbs in `VERBS`."""
        super().__init__(name, **settings)
        self._before = before
        names = [each.removeprefix(before) for each in VERBS if each.startswith(before)]
        # click suggests names from this dictionary for a misspelt one; `get_command` imports.
        self.commands: Any = dict.fromkeys(each.split()[0] for each in names)

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
        if args and args[0] in REMOVED:
            raise SettingsError(f"no verb {args[0]}; {REMOVED[args[0]]}")
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

        found = {name: self.get_command(ctx, name) for name in self.commands}
        return help_of_group(self, ctx, {name: each for name, each in found.items() if each})


def _print_version(ctx: click.Context, _: click.Parameter, is_set: bool) -> None:
    if is_set and not ctx.resilient_parsing:
        print(f"trajeval_ros {__version__}")
        ctx.exit()


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
        )
    ],
    context_settings={"help_option_names": ["-h", "--help"]},
)


def load(arguments: Sequence[str]) -> None:
    """Import the requested verb, or all verbs if the help lists them.

    Nothing is imported for an unknown verb, or for shell completion, which reads the options of at
    most one verb.
    """
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


def _sentence(error: click.UsageError) -> str:
    """Return a usage error as one sentence, with what replaces a removed option."""
    name = error.ctx.info_name if error.ctx else ""
    if isinstance(error, click.NoSuchOption):
        option = error.option_name
        replacement = REMOVED.get(f"{name} {option}", REMOVED.get(option))
        if replacement is not None:
            return f"{name} has no option {option}; {replacement}"
        near = f"did you mean {error.possibilities[0]}? " if error.possibilities else ""
        return f"no such option: {option} ({near}try {_path(error)} --help)"
    message = error.format_message().rstrip(".")
    return f"{message[0].lower()}{message[1:]} (try {_path(error)} --help)"


def _path(error: click.UsageError) -> str:
    return error.ctx.command_path if error.ctx else "trajeval"
