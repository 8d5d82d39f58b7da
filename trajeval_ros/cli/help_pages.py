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
    arguments = [each for each in command.params if isinstance(each, click.Argument)]
    options = [each for each in command.get_params(ctx) if isinstance(each, click.Option)]
    shown = [each for each in options if not is_short or _is_common(each)]
    panels: dict[str, list[click.Parameter]] = {}
    for each in shown:
        panel = _COMMON if is_short else getattr(each, "panel", "") or "Options"
        panels.setdefault(panel, []).append(each)
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
            *(_panel(name, each) for name, each in panels.items()),
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
    if all(isinstance(each, click.Argument) for each in params):
        columns = ["metavar", "help"]
    return RichOptionPanel(
        name, options=[str(each.opts[0]) for each in params], column_types=columns
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
