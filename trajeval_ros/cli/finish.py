"""`trajeval finish`: the evaluation of what a live run left on disk."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from trajeval_ros.cli import options
from trajeval_ros.cli.deliver import deliver
from trajeval_ros.io.live.live_folder import evaluate_folder
from trajeval_ros.io.requests.request_words import request_from
from trajeval_ros.io.results.requirement import Requirement


def finish(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="The live evaluator's output folder.")
    ],
    align_with: options.AlignWithOption = None,
    hand_eye: options.HandEyeOption = None,
    up: options.UpOption = None,
    json: options.JsonOption = None,
    output: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Write result.json, errors.npz and figures there; it may be FOLDER itself.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    require: options.RequireOption = None,
    quiet: options.QuietOption = False,
) -> None:
    """Evaluate what a live run has recorded so far, also after a crash, and while it goes on.

    The live evaluator writes each pair of states to its output folder as it is made. This reads
    them and gives what `trajeval evaluate` would give on a bag of the same topics:

        trajeval finish trajeval_2026_03_01-10_00_00 --output result

    If the groundtruth was of a marker and not of the body, with the marker's pose in the body:

        trajeval finish trajeval_2026_03_01-10_00_00 --hand-eye marker.yaml
    """
    request = request_from({"hand_eye": hand_eye, "up": up})
    requirements = [Requirement.parse(text) for text in require or []]
    deliver(
        evaluate_folder(folder, request, align_with),
        requirements,
        json=json,
        output=output,
        quiet=quiet,
        gauge_given=True,
    )
