"""Classes of the verbs: the help of flags, and ROS arguments."""

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
    """A verb that passes the arguments after `--ros-args` to ROS, as with `ros2 run`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Store the ROS arguments in the context, and parse the others."""
        own, ctx.obj = split_ros_arguments(args)
        return super().parse_args(ctx, own)


def without_types_of_flags(parameters: list[Any]) -> list[Any]:
    """Return the parameters without the `<bool>` that newer versions of typer add to flags."""
    for each in parameters:
        if getattr(each, "is_flag", False):
            each.metavar = ""
    return parameters
