"""`ros2 run trajeval_ros evaluator`: the live evaluator's command line."""

from __future__ import annotations

import typer

from trajeval_ros.ros.evaluator_help import HELP


def evaluator(context: typer.Context) -> None:
    """Run the live evaluator."""
    from trajeval_ros.ros.run import evaluate_live

    status = evaluate_live(context.obj or ())
    if status:
        raise typer.Exit(status)


evaluator.__doc__ = HELP
