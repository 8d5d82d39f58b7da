"""`trajeval gauge-study`: the gauge paper's tables and figures."""

from __future__ import annotations

import functools
import logging
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from trajeval_ros.cli.progress import progress
from trajeval_ros.exceptions import InputError, SettingsError

if TYPE_CHECKING:
    from trajeval_ros.visual_inertial.scene import Scene, SensorProfile
    from trajeval_ros.visual_inertial.solver import GaugeHandling
    from trajeval_ros.visual_inertial.study import Covariances, Trials

_SEED = 0
_MOTION_KEYFRAMES, _MOTION_LANDMARKS = 30, 150
_LAYOUTS_AND_SHAPES = [
    (layout, name) for layout in ("plane", "random") for name in ("sine", "arc", "rec")
]


def gauge_study(
    output: Annotated[
        Path,
        typer.Option(metavar="DIR", help="Write tables.md, study.json and the figures there."),
    ],
    motion: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SOURCE",
            help="Fly a recorded trajectory as well, 30 keyframes of it, with simulated sensors; "
            "repeatable.",
        ),
    ] = None,
    start: Annotated[
        float,
        typer.Option(metavar="S", help="Where in a recorded trajectory the motion begins."),
    ] = 50.0,
    duration: Annotated[
        float, typer.Option(metavar="S", help="How long a part of a recorded trajectory.")
    ] = 15.0,
    profile: Annotated[
        str,
        typer.Option(
            help="Simulated sensors: paper (errors of Table II's size), euroc, stereo (paper's "
            "and a second camera), overconfident."
        ),
    ] = "paper",
    trials: Annotated[
        int, typer.Option(metavar="N", help="Solves for each configuration and gauge.")
    ] = 50,
) -> None:
    """Compare gauge fixation, gauge prior and free gauge, as Zhang, Gallego and Scaramuzza did.

    Table II with the paper's values beside ours, the sweep of the prior's weight (Fig. 4 to 6),
    iterations and time (Fig. 7), covariances and their transformation (Fig. 9):

        trajeval gauge-study --output study

    With the motion of real flights, as Table III, and simulated sensors, since the paper's
    feature tracks are not public:

        trajeval gauge-study --output study --motion MH_01.txt --motion V1_01.csv
    """
    from trajeval_ros.visual_inertial import motion as motions
    from trajeval_ros.visual_inertial import study
    from trajeval_ros.visual_inertial.scene import make_scene, profile_named

    if trials < 1:
        raise SettingsError(f"--trials must be at least 1, not {trials}")
    if output.exists() and not output.is_dir():
        raise InputError(f"{output} is a file; name a folder")
    sensors = profile_named(profile)
    scenes = {
        f"{name} {layout}": make_scene(motions.shape(name), layout, sensors, _SEED)
        for layout, name in _LAYOUTS_AND_SHAPES
    }
    scenes |= _recorded(motion or [], start, duration, sensors)
    outcome = {name: _compared(name, scene, trials) for name, scene in scenes.items()}
    swept = scenes["sine plane"]
    with progress("prior weights") as advance:
        weights = study.SWEEP_WEIGHTS
        done = iter(range(1, len(weights) + 1))
        sweep = study.sweep(swept, trials, lambda: advance(next(done), len(weights)), weights)
    figured = ["sine random", *(name for name in scenes if name.startswith("motion of "))]
    matrices = {name: study.covariances(scenes[name]) for name in figured}
    output.mkdir(parents=True, exist_ok=True)
    _write(output, profile, trials, outcome, sweep, matrices)
    if find_spec("matplotlib") is not None:
        _draw(output, profile, trials, swept, outcome, sweep, matrices)
    _print(output, outcome, matrices)


def _recorded(
    sources: list[str], start: float, duration: float, sensors: SensorProfile
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
            keyframes=_MOTION_KEYFRAMES,
            landmarks=_MOTION_LANDMARKS,
        )
    return scenes


def _compared(name: str, scene: Scene, trials: int) -> dict[GaugeHandling, Trials]:
    from trajeval_ros.visual_inertial.study import compare

    with progress(f"{name}, {trials} trials") as advance:
        done = iter(range(1, trials + 1))
        return compare(scene, trials, lambda: advance(next(done), trials))


def _write(
    folder: Path,
    profile: str,
    trials: int,
    outcome: dict[str, dict[GaugeHandling, Trials]],
    sweep: list[Trials],
    matrices: dict[str, Covariances],
) -> None:
    from trajeval_ros.formatting.text_tables import markdown_table
    from trajeval_ros.io.json_file import json_text
    from trajeval_ros.io.writing import write_text
    from trajeval_ros.report import gauge_tables
    from trajeval_ros.visual_inertial.study import SWEEP_WEIGHTS

    numbers = {
        "profile": profile,
        "trials": trials,
        "sensors": "simulated",
        "configurations": {
            name: {handling.value: _listed(each) for handling, each in of_gauge.items()}
            for name, of_gauge in outcome.items()
        },
        "prior_weight_sweep": {
            "configuration": "sine plane",
            "weights": list(SWEEP_WEIGHTS),
            "trials": [_listed(each) for each in sweep],
        },
        "covariance_difference": {name: each.difference for name, each in matrices.items()},
    }
    write_text(folder / "study.json", json_text(numbers, indent=1))
    lines = [
        f"Root mean square errors after alignment by the first keyframe (yaw and translation), "
        f"means over {trials} trials: p [m] / φ [deg] / v [m/s]; profile `{profile}`. All sensors "
        "are simulated, also those along recorded motions. The paper's values are those of its "
        "Tables II and III, whose noise and, for the recordings, feature tracks are not public.\n",
        *markdown_table(gauge_tables.HEADINGS, gauge_tables.accuracy_rows(outcome)),
        "",
        "Relative Frobenius difference between the transformed free-gauge covariance, eq. (12), "
        "and that of a separate solve with fixation (paper: 0.11 % simulated, 0.02 % on V1_01):\n",
        *markdown_table(
            ["configuration", "difference"],
            [[name, f"{100 * each.difference:.3f} %"] for name, each in matrices.items()],
        ),
        "",
    ]
    write_text(folder / "tables.md", "\n".join(lines))


def _listed(trials: Trials) -> dict[str, Any]:
    return {name: column.tolist() for name, column in vars(trials).items()}


def _draw(
    folder: Path,
    profile: str,
    trials: int,
    swept: Scene,
    outcome: dict[str, dict[GaugeHandling, Trials]],
    sweep: list[Trials],
    matrices: dict[str, Covariances],
) -> None:
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    from trajeval_ros.io.writing import write_whole
    from trajeval_ros.report import canvas, gauge_figures
    from trajeval_ros.visual_inertial.study import PATH_WEIGHTS, SWEEP_WEIGHTS, paths

    what = f"simulated sensors, profile {profile}, {trials} trials"
    with canvas.house_style():
        figures = {
            "prior_weight.png": gauge_figures.prior_weight(
                SWEEP_WEIGHTS, sweep, f"sine plane, {what}"
            ),
            "prior_paths.png": gauge_figures.prior_paths(
                PATH_WEIGHTS,
                paths(swept, PATH_WEIGHTS),
                f"sine plane, one trial, profile {profile}",
            ),
            "cost.png": gauge_figures.cost(outcome, what),
        }
        for name, each in matrices.items():
            file = f"covariances_{name.removeprefix('motion of ').replace(' ', '_')}.png"
            figures[file.replace("/", "_")] = gauge_figures.covariance_matrices(each, name)
        for file, figure in figures.items():
            write_whole(folder / file, functools.partial(canvas.save, figure))


def _print(
    folder: Path,
    outcome: dict[str, dict[GaugeHandling, Trials]],
    matrices: dict[str, Covariances],
) -> None:
    from trajeval_ros.report.console import console, show
    from trajeval_ros.report.gauge_tables import accuracy_table

    terminal = console()
    show(terminal, accuracy_table(outcome))
    for name, each in matrices.items():
        terminal.print(
            f"{name}: the free gauge's covariance, transformed, differs by "
            f"{100 * each.difference:.3f} % from that of fixation"
        )
    terminal.print("All sensors are simulated, also those along recorded motions.")
    terminal.print(f"tables.md, study.json and figures are in {folder}", soft_wrap=True)
