"""Options of the verbs: those of the table of settings, those that verbs share, and own ones."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.source_info import NAMED_COLUMNS
from trajeval_ros.io.requests.setting import (
    COMPARE,
    EVALUATE,
    FINISH,
    INPUT,
    TRAJECTORY,
    Setting,
)
from trajeval_ros.io.text.hints import TextHints
from trajeval_ros.io.text.times import ROW_TIMES
from trajeval_ros.report.figure_style import FORMATS, WIDTHS_IN

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

OUTPUT, FIGURES = "Output", "Figures"
_TYPES: dict[Any, str] = {str: "TEXT", float: "NUMBER", int: "N"}
_FEW = 2  # choices that fit a placeholder
# Metavars of values that are names of files.
_FILES = ("FILE", "DIR", "FOLDER", "SOURCE", "BAG", "yaml", "parquet", "GROUNDTRUTH", "RESULT")
STUDY_GAUGE, STUDY_ASSOCIATION = "study gauge", "study association"

# Options of several verbs that are not settings of a request.
_SHARED = (
    Setting(name="groundtruth", letter="-g", metavar="SOURCE", panel=INPUT,
        verbs=(EVALUATE, STUDY_ASSOCIATION), is_common=True,
        help="Groundtruth: PATH, BAG:TOPIC or BAG:/tf:PARENT.CHILD; - reads text from stdin. "
        "The format is detected from the content: text (TUM, KITTI, EuRoC, OpenVINS, VINS-Mono) "
        "or bag (MCAP, rosbag2 sqlite3, ROS 1)."),
    Setting(name="estimate", letter="-e", metavar="SOURCE", panel=INPUT,
        verbs=(EVALUATE, STUDY_ASSOCIATION), is_common=True, is_repeatable=True,
        help="Trajectory to evaluate. Repeat the option to evaluate several."),
    Setting(name="columns", metavar="NAMES", panel=INPUT,
        verbs=(EVALUATE, COMPARE, TRAJECTORY, "info"),
        is_repeatable=True,
        help="Columns of the estimates' text files, as in 't x y z qw qx qy qz'; of the "
        "groundtruth's or reference's after a prefix, as in 'groundtruth: t_us x y z'. "
        "Repeatable. Use _ for columns to ignore. Names: docs/trajectory.md."),
    Setting(name="frame_rate", kind=float, metavar="HZ", panel=INPUT,
        verbs=(EVALUATE, COMPARE, TRAJECTORY, "info"),
        help="Pose rate of text files without timestamps, such as KITTI, TartanAir and g2o."),
    Setting(name="strict", kind=bool, panel=INPUT, verbs=(EVALUATE, TRAJECTORY),
        help="Verification of all data read from a bag. Exits with status 2 if it is damaged, "
        "or if poses of a file are not finite or cannot be decoded."),
    Setting(name="json", metavar="FILE|-", panel=OUTPUT,
        verbs=(
            EVALUATE, FINISH, "explain", "watch", "groundtruth", STUDY_ASSOCIATION,
        ),
        is_common=True,
        help="JSON output file. With -, only the JSON is printed to stdout."),
    Setting(name="require", metavar="BOUND", panel=OUTPUT, verbs=(EVALUATE, FINISH),
        is_repeatable=True,
        help="Requirement for every estimate; exits with status 1 if it is not met. Repeatable. "
        "Examples: 'ate.position_m.rmse < 0.3', 're.8m.position_percent.mean < 1'."),
    Setting(name="quiet", kind=bool, letter="-q", panel=OUTPUT,
        verbs=(EVALUATE, COMPARE, FINISH, TRAJECTORY, "watch", "groundtruth"),
        help="No output on the terminal except warnings about missing data."),
    Setting(name="figure_format", metavar="LIST", panel=FIGURES,
        verbs=(EVALUATE, COMPARE, TRAJECTORY, STUDY_GAUGE),
        help=f"Formats of figures, separated by commas: {','.join(FORMATS)}. PGF needs LaTeX."),
    Setting(name="figure_width", metavar="INCHES|PRESET", panel=FIGURES,
        verbs=(EVALUATE, TRAJECTORY, STUDY_GAUGE),
        help="Width of figures in print, with a font size of 7 to 9 points: "
        + ", ".join(f"{name} ({width:g})" for name, width in WIDTHS_IN.items())
        + "."),
    Setting(name="no_title", kind=bool, panel=FIGURES, verbs=(EVALUATE, STUDY_GAUGE),
        help="Figures without titles, for papers. The titles stay in the metadata of the "
        "files."),
    Setting(name="style", kind=Path, metavar="FILE.mplstyle", panel=FIGURES,
        verbs=(EVALUATE, TRAJECTORY, STUDY_GAUGE),
        help="Matplotlib style sheet; overrides the default style and your matplotlibrc. With "
        "`text.usetex: True`, LaTeX sets all text."),
)  # fmt: skip


class HelpedOption(click.Option):
    """An option with a heading in the help (`panel`); the short help shows common ones."""

    def __init__(
        self, names: list[str], *, panel: str = "", is_common: bool = False, **more: Any
    ) -> None:
        super().__init__(names, **more)
        self.panel, self.is_common = panel, is_common


class HelpedArgument(click.Argument):
    """An argument with a help."""

    def __init__(self, name: str, *, help: str, **more: Any) -> None:  # noqa: A002 - as click's
        super().__init__([name], **more)
        self.help = help
        # rich-click shows the type's name instead of a metavar that equals the argument's name.
        self.type = copy.copy(self.type)
        self.type.name = str(self.metavar).lower()


def settings_options(verb: str) -> list[click.Parameter]:
    """Return the options of a verb for the settings of a request, which the table states."""
    from trajeval_ros.io.requests.settings_table import SETTINGS

    return [_option_of(setting) for setting in SETTINGS.values() if verb in setting.verbs]


def shared_options(verb: str) -> list[click.Parameter]:
    """Return the other options that a verb shares with others."""
    return [_option_of(item) for item in _SHARED if verb in item.verbs]


def _option_of(setting: Setting) -> HelpedOption:
    is_flag = setting.kind is bool
    alone = {"is_flag": False, "flag_value": setting.value_if_alone}
    return HelpedOption(
        [setting.option, *([setting.letter] if setting.letter else [])],
        help=setting.text,
        type=None if is_flag else _click_type(setting.kind),
        # False would make the value optional. A flag that is not given leaves a file's value.
        **(alone if setting.value_if_alone else {"is_flag": is_flag or None}),
        **({"default": None} if is_flag else {}),
        multiple=setting.is_repeatable,
        metavar=None if is_flag else setting.metavar or _metavar(setting),
        panel=setting.panel,
        is_common=setting.is_common,
        shell_complete=_completion(setting.metavar, setting.choices),
    )


def _click_type(kind: Any) -> Any:
    return _local_path if kind is Path else kind


def _local_path(path: str | Path) -> Path:
    if "://" in str(path):  # pyarrow would write to it
        raise click.BadParameter("this is a URL; give a path of this machine")
    return Path(path)


def _metavar(setting: Setting) -> str:
    if setting.choices:
        return "|".join(setting.choices) if len(setting.choices) <= _FEW else "NAME"
    return _TYPES[setting.kind]


def option(
    *names: str,
    help: str,  # noqa: A002 - as click's
    metavar: str = "",
    kind: Any = str,
    default: Any = None,
    panel: str = "",
    is_common: bool = False,
    is_repeatable: bool = False,
    count: int = 1,
) -> HelpedOption:
    """Return an option that a single verb has; a bool is a flag, `--a/--b` are two opposite ones.

    The default is appended to the help. `kind`: type, or click's type. `count`: of values.
    """
    is_flag = kind is bool
    shown = "the current folder" if default == Path() else default
    return HelpedOption(
        list(names),
        help=help if default is None or is_flag else f"{help} Default: {shown}.",
        type=None if is_flag else _click_type(kind),
        is_flag=is_flag or None,  # False would make the value optional
        default=(None if "/" in names[0] else False) if is_flag else default,
        multiple=is_repeatable,
        nargs=count,
        metavar=None if is_flag else metavar or _TYPES.get(kind, "N"),
        panel=panel,
        is_common=is_common,
        shell_complete=_completion(metavar, ()),
    )


def argument(
    name: str,
    *,
    help: str,  # noqa: A002 - as click's
    metavar: str,
    kind: Any = str,
    default: Any = None,
    count: int = 1,
    is_required: bool = True,
) -> HelpedArgument:
    """Return a positional argument; with the count -1, any number of values."""
    is_required = is_required and default is None
    return HelpedArgument(
        name,
        help=help,
        type=_click_type(kind),
        nargs=count,
        required=is_required,
        metavar=metavar,
        shell_complete=_completion(metavar, ()),
        **({} if default is None else {"default": default}),
    )


def _completion(metavar: str, choices: Iterable[str]) -> Callable[..., list[CompletionItem]]:
    """Return a function that completes a value: one of the choices, or the name of a file."""

    def complete(_context: Any, _parameter: Any, start: str) -> list[CompletionItem]:
        from click.shell_completion import CompletionItem

        completions = [CompletionItem(choice) for choice in choices if choice.startswith(start)]
        if not completions and any(file in metavar for file in _FILES):
            completions = [CompletionItem(start, type="file")]
        return completions

    return complete


_FORMATS = ("tum", "kitti", "euroc", "bag", "bag2")  # first words of evo


def refuse_format(sources: Sequence[str], usage: str) -> None:
    """Refuse the name of a format before the sources, which evo requires."""
    if sources[:1] and sources[0] in _FORMATS and not Path(sources[0]).exists():
        raise SettingsError(
            f"{sources[0]} is a format, which is detected by content; remove it: trajeval {usage}"
        )


def require_used(given: Sequence[tuple[TextHints, Any]]) -> None:
    """Refuse column names and a frame rate that no source needed, by the readers' remarks.

    `given`: hints, and the trajectory or its description that was read with them.
    """
    sides = {hints.side for hints, _ in given if hints.columns}
    for side in sides:
        codes = {code for hints, read in given if hints.side == side for code in _codes(read)}
        if NAMED_COLUMNS not in codes:
            prefix = f" '{side}: ...'" if side else ""
            raise SettingsError(
                f"--columns{prefix} is for text files, and no text file was read; remove it"
            )
    codes = {code for _, read in given for code in _codes(read)}
    if any(hints.frame_rate_hz is not None for hints, _ in given) and ROW_TIMES not in codes:
        raise SettingsError(
            "--frame-rate is for text files without timestamps, and none was read; remove it"
        )


def _codes(read: Any) -> set[str]:
    remarks = getattr(read, "reading", read).remarks
    return {remark.code for remark in remarks}


def sources_of(
    verb: str, by_position: Sequence[str], groundtruth: str | None, estimates: Sequence[str]
) -> list[str]:
    """Return the groundtruth and the estimates of a verb, from arguments or options.

    Raises:
        SettingsError: One is missing or given twice.
    """
    refuse_format(by_position, f"{verb} GROUNDTRUTH ESTIMATE")
    if by_position and (groundtruth is not None or estimates):
        raise SettingsError(
            "sources are given twice; use either GROUNDTRUTH ESTIMATE... or --groundtruth and "
            "--estimate"
        )
    first = by_position[:1] if groundtruth is None else [groundtruth]
    estimates = estimates or by_position[1:]
    if first and estimates:
        return [*first, *estimates]
    missing = "groundtruth" if estimates else "estimate" if first else "groundtruth and estimate"
    raise SettingsError(f"{missing} missing; call trajeval {verb} GROUNDTRUTH ESTIMATE")
