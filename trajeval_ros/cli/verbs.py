"""The verbs. A verb is imported only if it is requested, because its libraries load slowly."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any, Final

import typer
from typer.core import TyperGroup
from typer.main import get_command

from trajeval_ros.cli.verb_classes import RosCommand, VerbCommand, without_types_of_flags

# Verbs in the order of the help: module of `cli` with a function of the verb's name, and class.
VERBS: dict[str, tuple[str, type[VerbCommand]]] = {
    "info": ("info", VerbCommand),
    "trajectory": ("edit_trajectories", VerbCommand),
    "evaluate": ("evaluate", VerbCommand),
    "diagnose": ("diagnose", VerbCommand),
    "view": ("view", VerbCommand),
    "compare": ("compare", VerbCommand),
    "evaluator": ("live_evaluator", RosCommand),
    "finish": ("finish", VerbCommand),
    "replay": ("replay", RosCommand),
    "watch": ("watch", VerbCommand),
    "simulate": ("simulate", VerbCommand),
    "demo": ("demo", VerbCommand),
    "compare-association": ("compare_association", VerbCommand),
    "gauge-study": ("gauge_study", VerbCommand),
}
MARKUP: Final = "markdown"


@cache
def verb(name: str) -> Any:
    """Import a verb of `VERBS` and return its command."""
    file, command_class = VERBS[name]
    function = getattr(import_module(f"trajeval_ros.cli.{file}"), name.replace("-", "_"))
    alone = typer.Typer(add_completion=False, rich_markup_mode=MARKUP)
    alone.command(name, cls=command_class)(function)
    return get_command(alone)


class VerbGroup(TyperGroup):
    """All verbs."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        # click suggests names from this dictionary for a misspelt one; `get_command` imports.
        self.commands: Any = dict.fromkeys(VERBS)

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002
        """Return the verbs' names in the order of the help."""
        return list(VERBS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ARG002
        """Return the verb of a name; None if there is none."""
        return verb(cmd_name) if cmd_name in VERBS else None

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters of the program, which precede the verb."""
        return without_types_of_flags(super().get_params(ctx))
