"""`trajeval demo`: a simulated flight, evaluated live and recorded."""

from __future__ import annotations

import json
import shlex
import shutil
import signal
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import click

from trajeval_ros.cli.command import verb
from trajeval_ros.cli.options import argument
from trajeval_ros.cli.pictures import PICTURE
from trajeval_ros.cli.simulated_bag import ESTIMATE_TOPIC, GROUNDTRUTH_TOPIC, is_simulated
from trajeval_ros.exceptions import InputError, TrajevalError
from trajeval_ros.formatting.install_command import extra_command
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.viewer.sdk import is_installed as has_rerun

_MODALITY = "stereo-inertial"
_RATE = 5
_PATIENCE_S = 600  # timeout for discovery of the nodes, and for the end of the evaluator
_INTERRUPTED = 130
_COMPARED: dict[str, tuple[str | int, ...]] = {
    "pairs": ("association", "pairs"),
    "position ATE [m]": ("ate", "position_m", "rmse"),
    "rotation ATE [deg]": ("ate", "rotation_deg", "rmse"),
    "error after 40 m [%]": ("re", "segments", -1, "position_percent", "mean"),
}
_FIGURE = "trajectory_top.png"


_PARAMETERS = (
    argument("folder", kind=Path, metavar="FOLDER", default=Path("demo_output"),
        help="Output folder: new, or from an earlier demo. Default: demo_output."),
)  # fmt: skip


@verb(*_PARAMETERS)
def demo(folder: Path) -> None:
    """Simulates a flight, evaluates it live and recorded, and draws it. Takes about a minute.

    With ROS 2 (rclpy), the flight is replayed to the live evaluator, and the live results are
    compared with the recording. Without ROS 2, only the recording is evaluated. The picture is
    optional and needs rerun-sdk and a Vulkan driver.

        trajeval demo
    """
    bag, live, recorded = folder / "flight", folder / "live", folder / "recorded"
    _make_way(folder, bag, [live, recorded])
    has_ros = find_spec("rclpy") is not None
    status = 0
    try:
        _heading("Simulate a flight and odometry with drift")
        print(_quietly("simulate", str(bag), "--overwrite").splitlines()[0])
        if has_ros:
            _heading(f"Evaluate the flight live, replayed at {_RATE} times its speed")
            _evaluate_live(bag, live)
            _heading("Evaluate the recording and compare")
        else:
            _heading("Evaluate the recording (rclpy is not installed, so no live evaluation)")
        draws = ["--rrd", str(recorded / PICTURE)] if has_rerun() else []
        _evaluate(bag, recorded, *draws, *(["--quiet"] if has_ros else []))
        if has_ros:
            results = [item / "result.json" for item in (live, recorded)]
            texts = [result.read_text(encoding="utf-8") for result in results]
            print("\n".join(comparison(*map(json.loads, texts))))
        _heading("Evaluate a visual-inertial estimator: consistency of errors and covariances")
        certain = folder / "certain_flight"
        euroc = ("--profile", "euroc", "--duration", "30", "--overwrite")
        _quietly("simulate", str(certain), *euroc)
        more = ("--covariance", f"{certain}.npz", "--lengths", "none")
        _evaluate(certain, folder / "certainty", *more)
    except TrajevalError as error:
        print(f"trajeval: {error}", file=sys.stderr)
        status = 2
    shown = live if (live / PICTURE).exists() else recorded
    _heading("Draw the picture")
    print("with Rerun's viewer, without a window; this takes some seconds", flush=True)
    picture = folder / "rerun.png"
    why_none = _draw(shown / PICTURE, picture)
    _heading("Results" if not status else "The demo failed; results so far")
    _tell(shown, picture, why_none)
    if status:
        raise click.exceptions.Exit(status)


def _make_way(folder: Path, bag: Path, results: list[Path]) -> None:
    """Remove the results of an earlier demo, and nothing else."""
    if folder.is_dir() and any(folder.iterdir()) and not is_simulated(bag):
        raise InputError(f"{folder} exists and is not from an earlier demo; choose another folder")
    for result in results:
        shutil.rmtree(result, ignore_errors=True)
    (folder / "rerun.png").unlink(missing_ok=True)
    folder.mkdir(parents=True, exist_ok=True)


def _evaluate_live(bag: Path, output: Path) -> None:
    """Replay the bag to the live evaluator, and stop the evaluator with Ctrl-C."""
    node = _begin(
        "evaluator", "--ros-args",
        "-p", f"groundtruth_topic:={GROUNDTRUTH_TOPIC}",
        "-p", f"estimate_topics:=[{ESTIMATE_TOPIC}]",
        "-p", f"modality:={_MODALITY}",
        "-p", f"output:={json.dumps(str(output))}",
        "-p", f"rerun:={'file' if has_rerun() else 'none'}",
    )  # fmt: skip
    try:
        # The output of the replay is hidden; the output of the evaluator is shown.
        waiting = ("--wait-for-subscribers", str(_PATIENCE_S))
        # The IMU topic has no subscriber, and the replay waits for subscribers.
        topics = ("--topic", GROUNDTRUTH_TOPIC, "--topic", ESTIMATE_TOPIC)
        _quietly("replay", str(bag), "--rate", str(_RATE), *waiting, *topics)
        node.send_signal(signal.SIGINT)
        status = node.wait(_PATIENCE_S)
    except subprocess.TimeoutExpired as error:
        raise InputError(f"the live evaluator did not stop within {_PATIENCE_S} s") from error
    finally:
        node.kill()
        node.wait()
    if status:
        raise InputError(f"the live evaluator exited with status {status}")


def _evaluate(bag: Path, output: Path, *options: str) -> None:
    """Evaluate a recorded flight."""
    _run(
        "evaluate", "--groundtruth", f"{bag}:{GROUNDTRUTH_TOPIC}",
        "--estimate", f"{bag}:{ESTIMATE_TOPIC}", "--modality", _MODALITY,
        "--output", str(output), *options,
    )  # fmt: skip


def comparison(live: dict[str, Any], recorded: dict[str, Any]) -> list[str]:
    """Return lines that compare two results of the same bag, with the reason of a difference."""
    results = (live, recorded)
    received = {
        "groundtruth messages": [result["groundtruth"]["poses"] for result in results],
        "odometry messages": [result["runs"][0]["estimate"]["poses"] for result in results],
    }
    numbers = {
        label: [_number(result["runs"][0], path) for result in results]
        for label, path in _COMPARED.items()
    }
    lines = [f"{'':22}{'live':>12}{'recorded':>12}"]
    for label, values in received.items():
        lost = values[1] - values[0]
        lines.append(_row(label, values) + (f"   {lost} lost" if lost else ""))
    lines += [_row(label, values) for label, values in numbers.items()]
    lost = sum(values[1] - values[0] for values in received.values())
    if lost:
        lines.append(
            f"The columns differ: {counted(lost, 'message')} lost between replay and evaluator. "
            "The machine is overloaded. Close other programs and run the demo again."
        )
    elif all(_agree(*values) for values in numbers.values()):
        lines.append("All messages arrived, and both columns agree.")
    else:
        lines.append(
            "The columns differ although all messages arrived. Please report this as a bug."
        )
    return lines


def _row(label: str, values: list[float]) -> str:
    return f"{label:22}" + "".join(f"{value:12.6g}" for value in values)


def _agree(one: float, other: float) -> bool:
    """Return whether two numbers agree to 1e-9, the documented tolerance."""
    return abs(one - other) <= 1e-9 * max(abs(one), abs(other))


def _number(run: dict[str, Any], path: tuple[str | int, ...]) -> float:
    """Return the number of a run at a path of keys and indices."""
    value: Any = run
    for item in path:
        value = value[item]
    return float(value)


def _draw(recording: Path, png: Path) -> str:
    """Draw the picture; return the reason if that is not possible, else ""."""
    if not has_rerun():
        return f"rerun-sdk is not installed: {extra_command('rerun')}"
    if not recording.exists():
        return "no recording exists"
    from trajeval_ros.viewer.screenshot import save_png

    try:
        save_png(recording, png)
    except TrajevalError as error:
        return str(error)
    return ""


def _tell(shown: Path, picture: Path, why_none: str) -> None:
    """Print the paths of the results and the next command."""
    from trajeval_ros.viewer.program import has_display

    recording, report, figure = shown / PICTURE, shown / "result.json", shown / _FIGURE
    print(f"picture:    {f'none: {why_none}' if why_none else _near(picture)}")
    print(f"recording:  {_near(recording) if recording.exists() else 'none'}")
    print(f"report:     {_near(report) if report.exists() else 'none'}", end="")
    print(f", and figures in the same folder, such as {_near(figure)}" if figure.exists() else "")
    if recording.exists() and has_rerun():
        more = "" if has_display() else " --web"
        print(f"next, show the run in 3D:\n  {_command()} view {_quoted(recording)}{more}")
    else:
        print(f"next, list the contents of your recording:\n  {_command()} info YOUR.mcap")


def _command() -> str:
    """Return the command that runs `trajeval` from here."""
    program = Path(sys.executable).with_name("trajeval")
    if not program.exists():
        return f"{_quoted(Path(sys.executable))} -m trajeval_ros"
    known = shutil.which("trajeval")
    return "trajeval" if known and Path(known) == program else _quoted(program)


def _near(path: Path) -> str:
    """Return a path relative to the current folder if it is in it."""
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)


def _quoted(path: Path) -> str:
    return shlex.quote(_near(path))


def _run(*arguments: str) -> None:
    """Run a verb."""
    _refuse(arguments, _begin(*arguments).wait())


def _quietly(*arguments: str) -> str:
    """Run a verb without output, and return its stdout."""
    process = _begin(*arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        out, err = process.communicate()
    finally:
        process.kill()
    if process.returncode:
        sys.stderr.write(err)
    _refuse(arguments, process.returncode)
    return str(out)


def _refuse(arguments: tuple[str, ...], status: int) -> None:
    if status in (_INTERRUPTED, -signal.SIGINT):
        raise KeyboardInterrupt
    if status:
        raise InputError(f"trajeval {arguments[0]} exited with status {status}")


def _begin(*arguments: str, **options: Any) -> subprocess.Popen[Any]:
    """Start a verb in a new process."""
    sys.stdout.flush()
    return subprocess.Popen([sys.executable, "-m", "trajeval_ros", *arguments], **options)


def _heading(text: str) -> None:
    """Print a heading."""
    print(f"\n--- {text}", flush=True)
