"""The gauge study: its trials and results, and the content of tables.md and study.json."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from trajeval_ros.formatting.escaping import markdown_text
from trajeval_ros.formatting.text_tables import markdown_table
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.papers import gauge_figures, gauge_tables
from trajeval_ros.papers.examination import Examination
from trajeval_ros.papers.gauge_tables import examination_lines, examination_numbers
from trajeval_ros.papers.gauge_trials import (
    PATH_WEIGHTS,
    SWEEP_WEIGHTS,
    Covariances,
    StudiedScene,
    Trials,
    compare_handlings,
    covariances,
    paths,
    sweep,
)
from trajeval_ros.papers.solver import GaugeHandling, Trace
from trajeval_ros.papers.state import State
from trajeval_ros.report import canvas

# A progress bar with a title, which yields a function of the finished and of all parts.
Progress = Callable[[str], AbstractContextManager[Callable[[int, int], None]]]

SWEPT = "sine plane"


@dataclass(frozen=True, eq=False)
class GaugeStudy:
    """The results of a study."""

    profile: str  # profile of the simulated sensors
    trials: int  # number of solves per configuration and gauge handling
    states: dict[str, State]  # True keyframes and landmarks by configuration
    compared: dict[str, dict[GaugeHandling, Trials]]  # trials by configuration and gauge handling
    # Trials for every weight in `SWEEP_WEIGHTS`, of some configurations.
    sweeps: dict[str, list[Trials]]
    paths: list[Trace]  # iterations for every weight in `PATH_WEIGHTS`, of one trial of `SWEPT`
    # Covariances of the first trial at the termination of Ceres and at the minimum, of some
    # configurations.
    covariances: dict[str, tuple[Covariances, Covariances]]
    # Of all trials (T,), the relative differences of the transformed covariance from that of gauge
    # fixation, at the termination of Ceres and at the minimum.
    differences: dict[str, tuple[Floats, Floats]]
    measured: str  # name of the configuration with measured sensors; "" if there is none
    examined: Examination | None  # examination of its data and residuals; None if there is none
    blas_threads: str  # value of OPENBLAS_NUM_THREADS, "" if not set

    @property
    def sensors(self) -> str:
        """A sentence about simulated and measured sensors."""
        if self.measured:
            return f"Sensors are simulated, except for {self.measured} (measured)."
        return "All sensors are simulated, including sensors on recorded motions."

    @property
    def timing(self) -> str:
        """A sentence about the measurement of times."""
        if self.blas_threads == "1":
            return (
                "Times are measured with one linear algebra thread, alternating between methods."
            )
        return (
            "Times are measured with the default number of linear algebra threads, alternating "
            "between methods; for one thread, set OPENBLAS_NUM_THREADS=1."
        )

    def lines(self) -> list[str]:
        """Return the lines about measured data; empty if there are none."""
        return [] if self.examined is None else examination_lines(self.measured, self.examined)

    def numbers(self) -> dict[str, Any]:
        """Return the content of study.json."""
        return {
            "profile": self.profile,
            "trials": self.trials,
            "blas_threads": self.blas_threads or None,
            "sensors": {
                name: "measured" if name == self.measured else "simulated"
                for name in self.compared
            },
            "configurations": {
                name: {handling.value: _listed(trials) for handling, trials in of_gauge.items()}
                for name, of_gauge in self.compared.items()
            },
            "prior_weight_sweep": {
                "weights": list(SWEEP_WEIGHTS),
                "trials": {
                    name: [_listed(weighted) for weighted in trials]
                    for name, trials in self.sweeps.items()
                },
            },
            "covariance_difference": {
                name: {"as_ceres_stops": stopped.tolist(), "converged": converged.tolist()}
                for name, (stopped, converged) in self.differences.items()
            },
            "examination": None if self.examined is None else examination_numbers(self.examined),
        }

    def tables(self) -> str:
        """Return the content of tables.md."""
        parts = [
            "Root mean square errors after alignment by the first keyframe (yaw and "
            f"translation), means over {self.trials} trials: p [m] / φ [deg] / v [m/s]; "
            f"profile `{self.profile}`. {markdown_text(self.sensors)} {self.timing} The values "
            "of the paper are from its Tables II and III. Its noise, segments and feature "
            "tracks are not public.\n",
            *markdown_table(gauge_tables.HEADINGS, gauge_tables.accuracy_rows(self.compared)),
            "",
            "Relative Frobenius difference between the transformed free-gauge covariance, eq. "
            "(12), and the covariance of a separate solve with gauge fixation (paper: 0.11 % "
            "simulated, 0.02 % on V1_01), at the termination of Ceres and at the minimum; medians "
            "of the trials and their range:\n",
            *markdown_table(
                ["configuration", "at termination of Ceres", "converged"],
                [
                    [name, *(gauge_tables.percent_and_range(trials) for trials in pair)]
                    for name, pair in self.differences.items()
                ],
            ),
        ]
        if self.examined is not None:
            parts += [
                "",
                f"Prior weight on {markdown_text(self.measured)}:\n",
                *markdown_table(
                    gauge_tables.SWEEP_HEADINGS,
                    gauge_tables.sweep_rows(SWEEP_WEIGHTS, self.sweeps[self.measured]),
                ),
                "",
                *(f"* {markdown_text(line)}" for line in self.lines()),
            ]
        return "\n".join([*parts, ""])

    def figures(self) -> dict[str, canvas.Drawing]:
        """Return the functions that draw the figures, by file name without a suffix."""
        what = f"profile {self.profile}, {self.trials} trials"
        figures: dict[str, canvas.Drawing] = {
            "scenes": partial(gauge_figures.scenes, self.states),
            "cost": partial(gauge_figures.cost, self.compared, what),
            "prior_paths": partial(
                gauge_figures.prior_paths,
                PATH_WEIGHTS,
                self.paths,
                f"{SWEPT}, one trial, profile {self.profile}",
            ),
        }
        for name, trials in self.sweeps.items():
            file = "prior_weight" if name == SWEPT else f"prior_weight_{_file_name(name)}"
            title = f"{name}, {what if name == SWEPT else f'{self.trials} trials'}"
            figures[file] = partial(gauge_figures.prior_weight, SWEEP_WEIGHTS, trials, title)
        for name, (stopped, converged) in self.covariances.items():
            file = _file_name(name)
            figures[f"covariances_{file}"] = partial(
                gauge_figures.covariance_matrices, stopped, name
            )
            figures[f"gauges_{file}"] = partial(
                gauge_figures.gauges, converged, self.states[name], name
            )
        return figures


def run_study(
    profile: str,
    trials: int,
    scenes: dict[str, StudiedScene],
    measured: str,
    examined: Examination | None,
    progress: Progress,
) -> GaugeStudy:
    """Run all trials of the scenes; see `GaugeStudy` for the arguments."""
    figured = ["sine random", *(name for name in scenes if " of " in name)]
    transformed = {name: _transformed(name, scenes[name], trials, progress) for name in figured}
    return GaugeStudy(
        profile,
        trials,
        {name: scene.groundtruth for name, scene in scenes.items()},
        {name: _compared(name, scene, trials, progress) for name, scene in scenes.items()},
        {
            name: _swept(name, scenes[name], trials, progress)
            for name in (SWEPT, *([measured] if measured else []))
        },
        paths(scenes[SWEPT], PATH_WEIGHTS),
        {name: first for name, (first, _) in transformed.items()},
        {name: differences for name, (_, differences) in transformed.items()},
        measured,
        examined,
        os.environ.get("OPENBLAS_NUM_THREADS", ""),
    )


def _compared(
    name: str, scene: StudiedScene, trials: int, progress: Progress
) -> dict[GaugeHandling, Trials]:
    with progress(f"{name}, {trials} trials") as advance:
        done = iter(range(1, trials + 1))
        return compare_handlings(scene, trials, lambda: advance(next(done), trials))


def _swept(name: str, scene: StudiedScene, trials: int, progress: Progress) -> list[Trials]:
    with progress(f"{name}, prior weights") as advance:
        count = len(SWEEP_WEIGHTS)
        done = iter(range(1, count + 1))
        return sweep(scene, trials, lambda: advance(next(done), count), SWEEP_WEIGHTS)


def _transformed(
    name: str, scene: StudiedScene, trials: int, progress: Progress
) -> tuple[tuple[Covariances, Covariances], tuple[Floats, Floats]]:
    """Return the covariances of the first trial, and the differences of all."""

    def pair_of(trial: int) -> tuple[Covariances, Covariances]:
        return (
            covariances(scene, trial, is_converged=False),
            covariances(scene, trial, is_converged=True),
        )

    first = pair_of(0)
    stopped, converged = np.empty((2, trials))
    with progress(f"{name}, covariances") as advance:
        for trial in range(trials):
            pair = pair_of(trial) if trial else first
            stopped[trial], converged[trial] = (item.difference for item in pair)
            advance(trial + 1, trials)
    return first, (stopped, converged)


def _listed(trials: Trials) -> dict[str, Any]:
    """Return the columns of trials as lists."""
    return {name: column.tolist() for name, column in vars(trials).items()}


def _file_name(configuration: str) -> str:
    """Return a configuration's name as part of a file name."""
    plain = configuration.removeprefix("motion of ").removeprefix("tracks of ")
    return plain.replace(" ", "_").replace("/", "_")
