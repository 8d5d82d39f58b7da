"""`trajeval finish`: evaluation of the states that a live run has recorded."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from trajeval_ros.cli.command import verb
from trajeval_ros.cli.evaluation_output import write_and_print
from trajeval_ros.cli.options import OUTPUT, argument, option, settings_options, shared_options
from trajeval_ros.io.live.live_folder import evaluate_folder
from trajeval_ros.io.requests.request_from import request_from
from trajeval_ros.io.requests.setting import FINISH
from trajeval_ros.io.results.requirement import Requirement

_PARAMETERS = (
    argument("folder", kind=Path, metavar="FOLDER", help="Output folder of the live evaluator."),
    *settings_options(FINISH),
    *shared_options(FINISH),
    option("--output", kind=Path, metavar="DIR", panel=OUTPUT,
        help="Output folder for result.json, errors.npz and figures. Default: FOLDER; none with "
        "--json."),
)  # fmt: skip


@verb(*_PARAMETERS)
def finish(
    folder: Path,
    json: str | None,
    require: Sequence[str],
    quiet: bool,
    output: Path | None,
    align_with: str | None,
    **settings: Any,
) -> None:
    """Evaluates the poses that a live run has recorded, during the run or after a crash.

    The live evaluator writes every pose to its output folder, as it was received. This command
    evaluates them, and writes the results into the same folder. They are equal to the results of
    `trajeval evaluate` on a bag of the same topics:

        trajeval finish trajeval_2026_03_01-10_00_00

    Apply the pose of the groundtruth's marker in the body:

        trajeval finish trajeval_2026_03_01-10_00_00 --hand-eye marker.yaml

    Test the consistency of the covariances in the estimate's messages:

        trajeval finish trajeval_2026_03_01-10_00_00 --covariance message
    """
    request = request_from(settings)
    requirements = [Requirement.parse(text) for text in require]
    write_and_print(
        evaluate_folder(folder, request, align_with),
        requirements,
        json=json,
        output=folder if output is None and json is None else output,
        quiet=quiet,
    )
