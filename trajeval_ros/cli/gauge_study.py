"""`trajeval gauge-study`: the gauge paper's tables and figures."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from trajeval_ros.cli import figure_options
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.report.figure_style import FigureStyle

if TYPE_CHECKING:
    from trajeval_ros.report.gauge_report import GaugeStudy
    from trajeval_ros.visual_inertial.examination import Examination, MeasurementModel
    from trajeval_ros.visual_inertial.inertial_errors import BiasNoise
    from trajeval_ros.visual_inertial.preintegration import ImuNoise
    from trajeval_ros.visual_inertial.scene import Scene, SensorProfile
    from trajeval_ros.visual_inertial.study import StudiedScene

_SEED = 0
_MOTION_LANDMARKS = 150
# Defaults of options that need another option.
_START_S, _DURATION_S, _KEYFRAMES, _EVERY, _PIXEL_NOISE, _GRAVITY = 50.0, 15.0, 30, 3, 1.0, 9.81
_IMU_NOISE, _BIAS_NOISE = "6e-4,2e-2", "1e-3,5e-2,1.9e-5,3e-3"
_LAYOUTS_AND_SHAPES = [
    (layout, name) for layout in ("plane", "random") for name in ("sine", "arc", "rec")
]


def gauge_study(
    output: Annotated[
        Path,
        typer.Option(
            metavar="DIR", help="Output folder for tables.md, study.json and the figures."
        ),
    ],
    motion: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SOURCE",
            help="Recorded trajectory to use as motion, with simulated sensors. Repeatable.",
        ),
    ] = None,
    start: Annotated[
        float,
        typer.Option(
            metavar="S", help="Start of the motion in a recorded trajectory, in seconds."
        ),
    ] = _START_S,
    duration: Annotated[
        float,
        typer.Option(
            metavar="S", help="Duration of the motion in a recorded trajectory, in seconds."
        ),
    ] = _DURATION_S,
    profile: Annotated[
        str,
        typer.Option(
            help="Simulated sensors: paper (as in Table II), euroc, stereo (as paper, with a "
            "second camera), overconfident."
        ),
    ] = "paper",
    tracks: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Folder with a recording: feature tracks, IMU and groundtruth (docs/tracks.md).",
        ),
    ] = None,
    keyframes: Annotated[
        int,
        typer.Option(
            metavar="N",
            help="Number of keyframes of --motion, and largest number of keyframes of --tracks.",
        ),
    ] = _KEYFRAMES,
    every: Annotated[
        int, typer.Option(metavar="N", help="Interval of keyframes in --tracks: every Nth image.")
    ] = _EVERY,
    pixel_noise: Annotated[
        float,
        typer.Option(
            metavar="PX",
            help="Standard deviation of an image coordinate of --tracks, for the weights.",
        ),
    ] = _PIXEL_NOISE,
    imu_noise: Annotated[
        str,
        typer.Option(
            metavar="GYRO,ACCEL",
            help="Noise densities of the IMU of --tracks, rad/s/sqrt(Hz) and m/s^2/sqrt(Hz).",
        ),
    ] = _IMU_NOISE,
    estimate_biases: Annotated[
        bool,
        typer.Option(
            "--estimate-biases",
            help="Estimation of the IMU biases at every keyframe of --tracks. By default, biases "
            "are taken from the groundtruth, as in the paper.",
        ),
    ] = False,
    bias_noise: Annotated[
        str,
        typer.Option(
            metavar="GYRO,ACCEL,GYRO_WALK,ACCEL_WALK",
            help="Noise of estimated biases: standard deviations at the first keyframe, rad/s and "
            "m/s^2, and densities of the random walk, rad/s^2/sqrt(Hz) and m/s^3/sqrt(Hz).",
        ),
    ] = _BIAS_NOISE,
    gravity: Annotated[
        float,
        typer.Option(
            metavar="G", help="Gravity at the place of the recording in --tracks, m/s^2."
        ),
    ] = _GRAVITY,
    split_half: Annotated[
        bool,
        typer.Option(
            "--split-half",
            help="Test of the covariance of --tracks without groundtruth, with estimates from "
            "halves of the landmarks.",
        ),
    ] = False,
    trials: Annotated[
        int, typer.Option(metavar="N", help="Number of trials per configuration and gauge.")
    ] = 50,
    figure_format: figure_options.FigureFormatOption = None,
    figure_width: figure_options.FigureWidthOption = None,
    no_title: figure_options.NoTitleOption = False,
    style: figure_options.StyleOption = None,
) -> None:
    """Compares gauge fixation, gauge prior and free gauge, as in Zhang, Gallego and Scaramuzza.

    Reproduce Table II with the values of the paper, the sweep of the prior weight (Fig. 4 to 6),
    iterations and time (Fig. 7), covariances and their transformation (Fig. 1 and 9):

        trajeval gauge-study --output study

    Reproduce section VII (Table III, Fig. 10 and 11) with measured feature tracks and IMU data
    (the tracks of the paper are not public):

        trajeval gauge-study --output study --tracks V1_01_tracks --split-half

    Use the motion of recorded flights, with simulated sensors:

        trajeval gauge-study --output study --motion MH_01.txt --motion V1_01.csv
    """
    from trajeval_ros.cli.gauge_study_trials import run_study
    from trajeval_ros.visual_inertial import motion as motions
    from trajeval_ros.visual_inertial.examination import MeasurementModel
    from trajeval_ros.visual_inertial.scene import make_scene, profile_named

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
        _imu_noise(imu_noise),
        _bias_noise(bias_noise) if estimate_biases else None,
        _above_zero("--gravity", gravity),
        split_half,
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
    if not estimate_biases:
        _require_defaults("--estimate-biases", {"--bias-noise": (bias_noise, _BIAS_NOISE)})
    measured, examined = _examined(tracks, model)
    scenes: dict[str, StudiedScene] = {
        f"{name} {layout}": make_scene(motions.shape(name), layout, sensors, _SEED)
        for layout, name in _LAYOUTS_AND_SHAPES
    }
    scenes |= _recorded(motion or [], start, duration, sensors, keyframes)
    if examined is not None:
        scenes[measured] = examined.scene
    study = run_study(profile, trials, scenes, measured, examined)
    output.mkdir(parents=True, exist_ok=True)
    _write(output, study, look)
    _print(output, study)


def _require_defaults(needed: str, values: Mapping[str, tuple[object, object]]) -> None:
    """Refuse options that have no effect without another one.

    Args:
        needed: The missing option.
        values: Value and default by option.

    Raises:
        SettingsError: A value is not the default.
    """
    unused = [option for option, (value, default) in values.items() if value != default]
    if unused:
        raise SettingsError(f"{', '.join(unused)}: no effect without {needed}; add it")


def _above_zero(option: str, value: float) -> Any:
    if not 0.0 < value < float("inf"):
        raise SettingsError(f"{option} must be greater than zero, not {value:g}")
    return value


def _imu_noise(words: str) -> ImuNoise:
    from trajeval_ros.visual_inertial.preintegration import ImuNoise

    return ImuNoise(*_numbers("--imu-noise", words, _IMU_NOISE))


def _bias_noise(words: str) -> BiasNoise:
    from trajeval_ros.visual_inertial.inertial_errors import BiasNoise

    return BiasNoise(*_numbers("--bias-noise", words, _BIAS_NOISE))


def _numbers(option: str, words: str, example: str) -> list[float]:
    """Parse positive numbers; the example states their number."""
    count = len(example.split(","))
    try:
        values = [float(word) for word in words.split(",")]
    except ValueError:
        values = []
    if len(values) != count:
        raise SettingsError(f"{option} needs {count} numbers, as in {example}, not {words!r}")
    return [_above_zero(option, value) for value in values]


def _examined(folder: Path | None, model: MeasurementModel) -> tuple[str, Examination | None]:
    """Return the name and the examination of measured tracks; "" and None without a folder."""
    from trajeval_ros.io.tracks.tracks_folder import read_tracks_folder
    from trajeval_ros.visual_inertial.examination import examine

    if folder is None:
        if model.is_split:
            raise SettingsError("--split-half tests measured data; add --tracks")
        if model.bias_noise is not None:
            raise SettingsError(
                "--estimate-biases needs measured data, since simulated IMUs "
                "have no biases; add --tracks"
            )
        return "", None
    recording = read_tracks_folder(folder)
    return f"tracks of {recording.name}", examine(recording, model)


def _recorded(
    sources: list[str], start: float, duration: float, sensors: SensorProfile, keyframes: int
) -> dict[str, Scene]:
    import dataclasses

    from trajeval_ros.cli.source_names import names_of
    from trajeval_ros.io.sources import read_trajectory
    from trajeval_ros.visual_inertial.motion import recorded
    from trajeval_ros.visual_inertial.scene import make_scene

    scenes = {}
    for source, name in zip(sources, names_of(sources), strict=True):
        flown = recorded(dataclasses.replace(read_trajectory(source), name=name), start, duration)
        scenes[f"motion of {name}"] = make_scene(
            flown,
            "random",
            sensors,
            _SEED,
            keyframes=keyframes,
            landmarks=_MOTION_LANDMARKS,
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
    from trajeval_ros.report.console import console, show
    from trajeval_ros.report.gauge_tables import accuracy_table, percent_and_range

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
