"""The help of verbs, drawn by rich-click."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import click
from rich_click import RichCommand, RichContext, RichGroup, RichHelpConfiguration
from rich_click.rich_panel import RichCommandPanel, RichOptionPanel

from trajeval_ros.cli.options import HelpedOption

if TYPE_CHECKING:
    from rich_click.rich_help_configuration import OptionColumnType

_COMMON = "Common options"
_EMPTY_LINES = re.compile(r"\n((\x1b\[[0-9;]*m|[ \t])*\n){2,}")


def help_of_verb(command: click.Command, ctx: click.Context, *, is_short: bool) -> str:
    """Return the help of a verb, with its common options only if it is short."""
    arguments = [
        parameter for parameter in command.params if isinstance(parameter, click.Argument)
    ]
    options = [
        parameter for parameter in command.get_params(ctx) if isinstance(parameter, click.Option)
    ]
    shown = [option for option in options if not is_short or _is_common(option)]
    panels: dict[str, list[click.Parameter]] = {}
    for item in shown:
        panel = _COMMON if is_short else getattr(item, "panel", "") or "Options"
        panels.setdefault(panel, []).append(item)
    text = command.help or ""
    if is_short:
        text += f"\n\nAll options: `{ctx.command_path} --help-all`"
    page = RichCommand(
        name=command.name,
        params=[*arguments, *shown],
        help=text,
        add_help_option=False,
        panels=[
            *([_panel("Arguments", arguments)] if arguments else []),
            *(_panel(name, item) for name, item in panels.items()),
        ],
    )
    return _drawn(page, ctx)


def help_of_group(
    group: click.Group, ctx: click.Context, verbs: Mapping[str, click.Command]
) -> str:
    """Return the help of the program, or of a verb that has verbs."""
    page = RichGroup(
        name=group.name,
        params=group.get_params(ctx),
        help=group.help,
        add_help_option=False,
        commands=dict(verbs),
        panels=[RichCommandPanel("Commands", commands=list(verbs))],
    )
    return _drawn(page, ctx)


def _is_common(option: click.Option) -> bool:
    return not isinstance(option, HelpedOption) or option.is_common


def _panel(name: str, params: Sequence[click.Parameter]) -> RichOptionPanel:
    columns: list[OptionColumnType] = ["opt_all_metavar", "help"]
    if all(isinstance(parameter, click.Argument) for parameter in params):
        columns = ["metavar", "help"]
    return RichOptionPanel(
        name, options=[str(parameter.opts[0]) for parameter in params], column_types=columns
    )


def _drawn(page: RichCommand, ctx: click.Context) -> str:
    config = RichHelpConfiguration(
        text_markup="markdown",
        padding_helptext_first_line=(0, 0, 1, 0),
        append_metavars_help_string="{}",
        delimiter_comma=", ",
    )
    context = RichContext(
        page, parent=ctx.parent, info_name=ctx.info_name, rich_help_config=config
    )
    formatter = context.make_formatter()
    page.format_help(context, formatter)
    # Markdown puts several empty lines around examples. They can contain codes of colours.
    return _EMPTY_LINES.sub("\n\n", str(formatter.getvalue()).strip("\n"))
