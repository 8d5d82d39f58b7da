"""`trajeval finish`: the evaluation of what a live run left on disk."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from trajeval_ros.cli.deliver import deliver
from trajeval_ros.io.live.live_folder import evaluate_folder
from trajeval_ros.io.results.requirement import Requirement


def finish(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="The live evaluator's output folder.")
    ],
    json: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|-",
            help="Write the result as JSON; - prints it alone on stdout.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Write result.json, errors.npz and figures there; it may be FOLDER itself.",
        ),
    ] = None,
    require: Annotated[
        list[str] | None,
        typer.Option(
            metavar="BOUND",
            help="Exit with status 1 unless it holds for every estimate; repeatable.",
        ),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing.")] = False,
) -> None:
    """Evaluate what a live run has recorded so far, also after a crash, and while it goes on.

    The live evaluator writes each pair of states to its output folder as it is made. This reads
    them and gives what `trajeval evaluate` would give on a bag of the same topics:

        trajeval finish trajeval_2026_03_01-10_00_00 --output result
    """
    requirements = [Requirement.parse(text) for text in require or []]
    live = evaluate_folder(folder)
    deliver(
        live.result,
        live.runs,
        requirements,
        json=json,
        output=output,
        quiet=quiet,
        gauge_given=True,
    )
