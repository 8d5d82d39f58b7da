"""`trajeval view`: results in Rerun's viewer."""

from __future__ import annotations

from pathlib import Path

from trajeval_ros.cli.command import verb
from trajeval_ros.cli.options import argument, option
from trajeval_ros.cli.pictures import PICTURE
from trajeval_ros.exceptions import InputError
from trajeval_ros.io.live.live_folder import evaluate_folder
from trajeval_ros.io.live.state_file import SUFFIX
from trajeval_ros.io.writing import temporary_folder

_PARAMETERS = (
    argument("result", kind=Path, metavar="RESULT",
        help="Output folder of `trajeval evaluate` or of the live evaluator, or a .rrd file."),
    option("--web", kind=bool, help="Viewer as a web page on this machine, instead of a window."),
    option("--screenshot", kind=Path, metavar="FILE",
        help="PNG file of the first screen, instead of a window. Needs no display."),
)  # fmt: skip


@verb(*_PARAMETERS)
def view(result: Path, web: bool, screenshot: Path | None) -> None:
    """Shows trajectories and errors in Rerun's viewer.

    Show a recorded run:

        trajeval evaluate run.mcap:/mocap/pose run.mcap:/vio/odometry --rrd run.rrd
        trajeval view run.rrd

    Show a live run, by its output folder:

        trajeval view trajeval_2026_03_01-10_00_00

    Write a picture, without a display:

        trajeval view run.rrd --screenshot run.png
    """
    if web and screenshot is not None:
        raise InputError("--web and --screenshot exclude each other; remove one of them")

    picture = result / PICTURE if result.is_dir() else result
    if picture.exists():
        _show(picture, screenshot, in_browser=web)
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
        _show(made, screenshot, in_browser=web)


def _show(picture: Path, screenshot: Path | None, *, in_browser: bool) -> None:
    if screenshot is None:
        from trajeval_ros.viewer.program import show

        show(picture, in_browser=in_browser)
        return
    from trajeval_ros.viewer.screenshot import save_png

    save_png(picture, screenshot)
    print(f"wrote {screenshot}")
