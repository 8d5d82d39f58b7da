"""`trajeval view`: results in Rerun's viewer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from trajeval_ros.cli.pictures import PICTURE
from trajeval_ros.exceptions import InputError
from trajeval_ros.io.live.live_folder import evaluate_folder
from trajeval_ros.io.live.pair_file import SUFFIX
from trajeval_ros.io.temporary import temporary_folder


def view(
    result: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT",
            help="Output folder of `trajeval evaluate` or of the live evaluator, or a .rrd file.",
        ),
    ],
    web: Annotated[
        bool,
        typer.Option("--web", help="Viewer as a web page on this machine, instead of a window."),
    ] = False,
) -> None:
    """Shows trajectories and errors in Rerun's viewer.

    Show a recorded run:

        trajeval evaluate run.mcap:/mocap/pose run.mcap:/vio/odometry --rrd run.rrd
        trajeval view run.rrd

    Show a live run, by its output folder:

        trajeval view trajeval_2026_03_01-10_00_00
    """
    from trajeval_ros.viewer.show import show

    picture = result / PICTURE if result.is_dir() else result
    if picture.exists():
        show(picture, in_browser=web)
        return
    if not result.is_dir():
        raise InputError(f"{result} does not exist; give a folder with results or a .rrd file")
    if not any(result.glob(f"*{SUFFIX}")):
        raise InputError(
            f"no {PICTURE} in {result}; write a recording with trajeval evaluate --rrd FILE"
        )
    from trajeval_ros.viewer.recorded_scene import write_recording

    live = evaluate_folder(result)
    with temporary_folder("picture") as folder:
        made = folder / PICTURE
        write_recording(made, [run.evaluation for run in live.runs])
        show(made, in_browser=web)
