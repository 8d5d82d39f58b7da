"""How the verbs and their options are read and shown: a flag takes no value, so has no type."""

from __future__ import annotations

from typing import Any

from typer.core import TyperCommand

from trajeval_ros.cli.evaluator_program import split_ros_arguments


class VerbCommand(TyperCommand):
    """A verb."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return its parameters."""
        return without_types_of_flags(super().get_params(ctx))


class RosCommand(VerbCommand):
    """A verb that hands what follows `--ros-args` to ROS, as `ros2 run` has it."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Keep the ROS arguments in the context; the others are the verb's."""
        own, ctx.obj = split_ros_arguments(args)
        return super().parse_args(ctx, own)


def without_types_of_flags(parameters: list[Any]) -> list[Any]:
    """Newer typer shows `<bool>` behind each flag, as if one were to be typed."""
    for each in parameters:
        if getattr(each, "is_flag", False):
            each.metavar = ""
    return parameters
