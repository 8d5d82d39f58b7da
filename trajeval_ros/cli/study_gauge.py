"""`trajeval study gauge`: the gauge paper's tables and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trajeval_ros.cli.command import verb
from trajeval_ros.cli.options import STUDY_GAUGE, option, shared_options
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.io.requests.setting import parse_imu_noise
from trajeval_ros.report.figure_style import FigureStyle

if TYPE_CHECKING:
    from trajeval_ros.papers.examination import Examination, MeasurementModel
    from trajeval_ros.papers.gauge_study import GaugeStudy
    from trajeval_ros.papers.gauge_trials import StudiedScene
    from trajeval_ros.papers.scene import Scene, SensorProfile

_SEED = 0
_MOTION_LANDMARKS = 150
# Defaults of options that need another option.
_START_S, _DURATION_S, _KEYFRAMES, _EVERY, _PIXEL_NOISE, _GRAVITY = 50.0, 15.0, 30, 3, 1.0, 9.81
_IMU_NOISE = "6e-4,2e-2"
_LAYOUTS_AND_SHAPES = [
    (layout, name) for layout in ("plane", "random") for name in ("sine", "arc", "rec")
]


_PARAMETERS = (
    option("--output", kind=Path, metavar="DIR",
        help="Output folder for tables.md, study.json and the figures. Required."),
    option("--motion", metavar="SOURCE", is_repeatable=True,
        help="Recorded trajectory to use as motion, with simulated sensors. Repeatable."),
    option("--start", kind=float, metavar="S", default=_START_S,
        help="Start of the motion in a recorded trajectory, in seconds."),
    option("--duration", kind=float, metavar="S", default=_DURATION_S,
        help="Duration of the motion in a recorded trajectory, in seconds."),
    option("--profile", metavar="NAME", default="paper",
        help="Simulated sensors: paper (as in Table II), euroc, stereo (as paper, with a second "
        "camera), overconfident."),
    option("--tracks", kind=Path, metavar="FOLDER",
        help="Folder with feature tracks, IMU and groundtruth (docs/consistency.md)."),
    option("--keyframes", kind=int, metavar="N", default=_KEYFRAMES,
        help="Number of keyframes of --motion, and largest number of keyframes of --tracks."),
    option("--every", kind=int, metavar="N", default=_EVERY,
        help="Interval of keyframes in --tracks: every Nth image."),
    option("--pixel-noise", kind=float, metavar="PX", default=_PIXEL_NOISE,
        help="Standard deviation of an image coordinate of --tracks, for the weights."),
    option("--imu-noise", metavar="GYRO,ACCEL", default=_IMU_NOISE,
        help="Noise densities of the IMU of --tracks, rad/s/sqrt(Hz) and m/s^2/sqrt(Hz)."),
    option("--gravity", kind=float, metavar="G", default=_GRAVITY,
        help="Gravity at the place of the recording in --tracks, m/s^2."),
    option("--trials", kind=int, metavar="N", default=50,
        help="Number of trials per configuration and gauge."),
    *shared_options(STUDY_GAUGE),
)  # fmt: skip


@verb(*_PARAMETERS)
def study_gauge(
    output: Path | None,
    motion: Sequence[str],
    start: float,
    duration: float,
    profile: str,
    tracks: Path | None,
    keyframes: int,
    every: int,
    pixel_noise: float,
    imu_noise: str,
    gravity: float,
    trials: int,
    figure_format: str | None,
    figure_width: str | None,
    no_title: bool,
    style: Path | None,
) -> None:
    """Compares gauge fixation, gauge prior and free gauge, as in Zhang, Gallego and Scaramuzza.

    Reproduce Table II with the values of the paper, the sweep of the prior weight (Fig. 4 to 6),
    iterations and time (Fig. 7), covariances and their transformation (Fig. 1 and 9):

        trajeval study gauge --output study

    Reproduce section VII (Table III, Fig. 10 and 11) with measured feature tracks and IMU data
    (the tracks of the paper are not public):

        trajeval study gauge --output study --tracks V1_01_tracks

    Use the motion of recorded flights, with simulated sensors:

        trajeval study gauge --output study --motion MH_01.txt --motion V1_01.csv
    """
    from trajeval_ros.cli.progress import progress
    from trajeval_ros.papers.examination import MeasurementModel
    from trajeval_ros.papers.gauge_study import run_study
    from trajeval_ros.papers.scene import make_scene, profile_named
    from trajeval_ros.simulation.motion import shape

    if output is None:
        raise SettingsError("--output is missing; give a folder, as in --output study")
    if trials < 1:
        raise SettingsError(f"--trials must be at least 1, not {trials}")
    if output.exists() and not output.is_dir():
        raise InputError(f"{output} is a file; choose a folder")
    look = FigureStyle.parse(figure_format, figure_width, style, has_titles=not no_title)
    look.check()
    sensors = profile_named(profile)
    model = MeasurementModel(
        _above_zero("--every", every),
        keyframes,
        _above_zero("--pixel-noise", pixel_noise),
        parse_imu_noise(imu_noise),
        _above_zero("--gravity", gravity),
    )
    if not motion:
        _require_defaults("--motion", {
            "--start": (start, _START_S), "--duration": (duration, _DURATION_S),
        })  # fmt: skip
    if not motion and tracks is None:
        _require_defaults("--motion or --tracks", {"--keyframes": (keyframes, _KEYFRAMES)})
    if tracks is None:
        _require_defaults("--tracks", {
            "--every": (every, _EVERY), "--pixel-noise": (pixel_noise, _PIXEL_NOISE),
            "--imu-noise": (imu_noise, _IMU_NOISE), "--gravity": (gravity, _GRAVITY),
        })  # fmt: skip
    measured, examined = _examined(tracks, model)
    scenes: dict[str, StudiedScene] = {
        f"{name} {layout}": make_scene(shape(name), layout, sensors, _SEED)
        for layout, name in _LAYOUTS_AND_SHAPES
    }
    scenes |= _recorded(motion, start, duration, sensors, keyframes)
    if examined is not None:
        scenes[measured] = examined.scene
    study = run_study(profile, trials, scenes, measured, examined, progress)
    output.mkdir(parents=True, exist_ok=True)
    _write(output, study, look)
    _print(output, study)


def _require_defaults(needed: str, values: Mapping[str, tuple[object, object]]) -> None:
    """Refuse options that differ from their default but need another one."""
    unused = [option for option, (value, default) in values.items() if value != default]
    if unused:
        raise SettingsError(f"{', '.join(unused)}: no effect without {needed}; add it")


def _above_zero(option: str, value: float) -> Any:
    if not 0.0 < value < float("inf"):
        raise SettingsError(f"{option} must be greater than zero, not {value:g}")
    return value


def _examined(folder: Path | None, model: MeasurementModel) -> tuple[str, Examination | None]:
    """Return the name and the examination of measured tracks; "" and None without a folder."""
    from trajeval_ros.papers.examination import examine
    from trajeval_ros.papers.tracks_folder import read_tracks_folder

    if folder is None:
        return "", None
    recording = read_tracks_folder(folder)
    return f"tracks of {recording.name}", examine(recording, model)


def _recorded(
    sources: Sequence[str], start: float, duration: float, sensors: SensorProfile, keyframes: int
) -> dict[str, Scene]:
    import dataclasses

    from trajeval_ros.io.source_names import names_of
    from trajeval_ros.io.sources import read_trajectory
    from trajeval_ros.papers.scene import make_scene
    from trajeval_ros.simulation.motion import recorded

    scenes = {}
    for source, name in zip(sources, names_of(sources), strict=True):
        flown = recorded(dataclasses.replace(read_trajectory(source), name=name), start, duration)
        scenes[f"motion of {name}"] = make_scene(
            flown, "random", sensors, _SEED, keyframes=keyframes, landmarks=_MOTION_LANDMARKS
        )
    return scenes


def _write(folder: Path, study: GaugeStudy, look: FigureStyle) -> None:
    from trajeval_ros.io.json_file import json_text
    from trajeval_ros.io.writing import write_text
    from trajeval_ros.report.figure_output import save_all

    write_text(folder / "study.json", json_text(study.numbers(), indent=1))
    write_text(folder / "tables.md", study.tables())
    if find_spec("matplotlib") is not None:
        save_all(study.figures(), folder, look)


def _print(folder: Path, study: GaugeStudy) -> None:
    from trajeval_ros.papers.gauge_tables import accuracy_table, percent_and_range
    from trajeval_ros.report.console import console, show

    terminal = console()
    for line in study.lines():
        terminal.print(line)
    show(terminal, accuracy_table(study.compared))
    for name, (stopped, converged) in study.differences.items():
        terminal.print(
            f"{name}: after transformation, the covariance of the free gauge differs by "
            f"{percent_and_range(stopped)} from the covariance of gauge fixation, and by "
            f"{percent_and_range(converged)} at the minimum"
        )
    terminal.print(study.sensors)
    terminal.print(study.timing)
    terminal.print(f"tables.md, study.json and figures are in {folder}", soft_wrap=True)
