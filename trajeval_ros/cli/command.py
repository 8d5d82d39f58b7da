"""The class of the verbs: short and full help, and ROS arguments."""

from __future__ import annotations

from collections.abc import Callable
from inspect import cleandoc
from typing import Any

import click

from trajeval_ros.cli.options import HelpedOption
from trajeval_ros.cli.programs import split_ros_arguments
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.formatting.escaping import without_secrets

# Verbs with more options than this have a short help with the common ones.
_MANY = 20
_ARGUMENTS = "trajeval.arguments"  # key of the context


class VerbCommand(click.Command):
    """A verb. Its help is drawn by rich-click, which is imported only for that."""

    def __init__(self, name: str, *, params: list[click.Parameter], **more: Any) -> None:
        options = [parameter for parameter in params if isinstance(parameter, HelpedOption)]
        self.has_short_help = len(options) > _MANY
        if self.has_short_help:
            params = [*params, _help_all()]
        super().__init__(name, params=params, **more)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Refuse a second value for an option of one value, of which click takes the last."""
        ctx.meta[_ARGUMENTS] = list(args)
        _, _, order = self.make_parser(ctx).parse_args(args=list(args))
        for parameter in self.params:
            is_single = isinstance(parameter, HelpedOption) and not (
                parameter.multiple or parameter.is_flag
            )
            if is_single and order.count(parameter) > 1:
                more = ", and for several robots list their runs for trajeval compare"
                raise SettingsError(
                    f"{parameter.opts[0]} is given {order.count(parameter)} times; give one per "
                    "call" + (f"{more} (docs/compare.md)" if parameter.metavar == "SOURCE" else "")
                )
        return super().parse_args(ctx, args)

    def get_help(self, ctx: click.Context) -> str:
        """Return the help, of the common options if there are many."""
        from trajeval_ros.cli.help_pages import help_of_verb

        return help_of_verb(self, ctx, is_short=self.has_short_help)


class RosCommand(VerbCommand):
    """A verb that passes the arguments after `--ros-args` to ROS, as with `ros2 run`."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Store the ROS arguments in the context, and parse the others."""
        others, ctx.obj = split_ros_arguments(args)
        return super().parse_args(ctx, others)


def ros_arguments() -> list[str]:
    """Return the ROS arguments of the verb that runs."""
    arguments: list[str] = click.get_current_context().obj or []
    return arguments


def arguments() -> list[str]:
    """Return the words after the verb that runs."""
    words: list[str] = click.get_current_context().meta[_ARGUMENTS]
    return words


def command_line() -> str:
    """Return the command that runs, without secrets of its URLs."""
    import shlex

    verb = click.get_current_context().info_name or ""
    words = ["trajeval", verb, *map(without_secrets, arguments())]
    return " ".join(map(shlex.quote, words))


def verb(
    *params: click.Parameter, kind: type[VerbCommand] = VerbCommand
) -> Callable[[Callable[..., Any]], VerbCommand]:
    """Return a decorator that makes a function a verb, with its docstring as the help."""

    def decorated(function: Callable[..., Any]) -> VerbCommand:
        return kind(
            function.__name__.rpartition("_")[2],
            params=list(params),
            callback=function,
            help=cleandoc(function.__doc__ or ""),
        )

    return decorated


def _help_all() -> click.Option:
    def show(ctx: click.Context, _: click.Parameter, is_set: bool) -> None:
        if is_set and not ctx.resilient_parsing:
            from trajeval_ros.cli.help_pages import help_of_verb

            click.echo(help_of_verb(ctx.command, ctx, is_short=False), color=ctx.color)
            ctx.exit()

    return click.Option(
        ["--help-all"],
        is_flag=True,
        is_eager=True,
        expose_value=False,
        callback=show,
        help="Help with all options.",
    )
