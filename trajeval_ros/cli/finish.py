"""`trajeval finish`: evaluation of the pairs that a live run has recorded."""

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
        Path, typer.Argument(metavar="FOLDER", help="Output folder of the live evaluator.")
    ],
    align_with: options.AlignWithOption = None,
    hand_eye: options.HandEyeOption = None,
    up: options.UpOption = None,
    covariance: options.CovarianceOption = None,
    rotation_covariance_frame: options.RotationCovarianceFrameOption = None,
    groundtruth_noise: options.GroundtruthNoiseOption = None,
    json: options.JsonOption = None,
    output: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Output folder for result.json, errors.npz and figures. It can be FOLDER itself.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    require: options.RequireOption = None,
    quiet: options.QuietOption = False,
) -> None:
    """Evaluates the pairs that a live run has recorded, during the run or after a crash.

    The live evaluator writes every pair to its output folder during the run. This command
    evaluates them. The results are equal to the results of `trajeval evaluate` on a bag of the
    same topics:

        trajeval finish trajeval_2026_03_01-10_00_00 --output result

    Apply the pose of the groundtruth's marker in the body:

        trajeval finish trajeval_2026_03_01-10_00_00 --hand-eye marker.yaml

    Test the consistency of the covariances in the estimate's messages:

        trajeval finish trajeval_2026_03_01-10_00_00 --covariance message
    """
    request = request_from(
        {
            "hand_eye": hand_eye,
            "up": up,
            "covariance": covariance,
            "rotation_covariance_frame": rotation_covariance_frame,
            "groundtruth_noise": groundtruth_noise,
        }
    )
    requirements = [Requirement.parse(text) for text in require or []]
    deliver(
        evaluate_folder(folder, request, align_with),
        requirements,
        json=json,
        output=output,
        quiet=quiet,
    )
