"""The files of `trajeval gauge-study`: tables.md, study.json and figures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from trajeval_ros.formatting.escaping import markdown_text
from trajeval_ros.formatting.text_tables import markdown_table
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.report import canvas, gauge_figures, gauge_scenes, gauge_tables
from trajeval_ros.report.measured_lines import measured_lines, measured_numbers
from trajeval_ros.visual_inertial.examination import Examination
from trajeval_ros.visual_inertial.solver import GaugeHandling, Trace
from trajeval_ros.visual_inertial.state import State
from trajeval_ros.visual_inertial.study import (
    PATH_WEIGHTS,
    SWEEP_WEIGHTS,
    Covariances,
    Trials,
)

SWEPT = "sine plane"


@dataclass(frozen=True, eq=False)
class GaugeStudy:
    """The results of a study.

    Attributes:
        profile: Profile of the simulated sensors.
        trials: Number of solves per configuration and gauge handling.
        states: True keyframes and landmarks by configuration.
        compared: Trials by configuration and gauge handling.
        sweeps: Trials for every weight in `SWEEP_WEIGHTS`, of some configurations.
        paths: Iterations for every weight in `PATH_WEIGHTS`, of one trial of `SWEPT`.
        covariances: Covariances of the first trial at the termination of Ceres and at the
            minimum, of some configurations.
        differences: Of all trials (T,), the relative differences of the transformed covariance
            from that of gauge fixation, at the termination of Ceres and at the minimum.
        measured: Name of the configuration with measured sensors; "" if there is none.
        examined: Examination of its data and residuals; None if there is none.
        blas_threads: Value of OPENBLAS_NUM_THREADS, "" if not set.
    """

    profile: str
    trials: int
    states: dict[str, State]
    compared: dict[str, dict[GaugeHandling, Trials]]
    sweeps: dict[str, list[Trials]]
    paths: list[Trace]
    covariances: dict[str, tuple[Covariances, Covariances]]
    differences: dict[str, tuple[Floats, Floats]]
    measured: str
    examined: Examination | None
    blas_threads: str

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
        return [] if self.examined is None else measured_lines(self.measured, self.examined)

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
            "examination": None if self.examined is None else measured_numbers(self.examined),
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
            "scenes": partial(gauge_scenes.scenes, self.states),
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
                gauge_scenes.gauges, converged, self.states[name], name
            )
        return figures


def _listed(trials: Trials) -> dict[str, Any]:
    """Return the columns of trials as lists."""
    return {name: column.tolist() for name, column in vars(trials).items()}


def _file_name(configuration: str) -> str:
    """Return a configuration's name as part of a file name."""
    plain = configuration.removeprefix("motion of ").removeprefix("tracks of ")
    return plain.replace(" ", "_").replace("/", "_")
