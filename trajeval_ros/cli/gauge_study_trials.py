"""Trials of the gauge study, with progress."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from trajeval_ros.cli.progress import progress

if TYPE_CHECKING:
    from trajeval_ros.geometry.arrays import Floats
    from trajeval_ros.report.gauge_report import GaugeStudy
    from trajeval_ros.visual_inertial.examination import Examination
    from trajeval_ros.visual_inertial.solver import GaugeHandling
    from trajeval_ros.visual_inertial.study import Covariances, StudiedScene, Trials


def run_study(
    profile: str,
    trials: int,
    scenes: dict[str, StudiedScene],
    measured: str,
    examined: Examination | None,
) -> GaugeStudy:
    """Run all trials.

    Args:
        profile: Name of the sensors.
        trials: Number of trials per scene and gauge.
        scenes: The scenes by name.
        measured: Name of the scene of measured tracks; "" if there is none.
        examined: Examination of the measured tracks; None if there are none.
    """
    from trajeval_ros.report.gauge_report import SWEPT, GaugeStudy
    from trajeval_ros.visual_inertial.study import PATH_WEIGHTS, paths

    figured = ["sine random", *(name for name in scenes if " of " in name)]
    transformed = {name: _transformed(name, scenes[name], trials) for name in figured}
    return GaugeStudy(
        profile,
        trials,
        {name: scene.truth for name, scene in scenes.items()},
        {name: _compared(name, scene, trials) for name, scene in scenes.items()},
        {
            name: _swept(name, scenes[name], trials)
            for name in (SWEPT, *([measured] if measured else []))
        },
        paths(scenes[SWEPT], PATH_WEIGHTS),
        {name: first for name, (first, _) in transformed.items()},
        {name: differences for name, (_, differences) in transformed.items()},
        measured,
        examined,
        os.environ.get("OPENBLAS_NUM_THREADS", ""),
    )


def _compared(name: str, scene: StudiedScene, trials: int) -> dict[GaugeHandling, Trials]:
    from trajeval_ros.visual_inertial.study import compare

    with progress(f"{name}, {trials} trials") as advance:
        done = iter(range(1, trials + 1))
        return compare(scene, trials, lambda: advance(next(done), trials))


def _swept(name: str, scene: StudiedScene, trials: int) -> list[Trials]:
    from trajeval_ros.visual_inertial.study import SWEEP_WEIGHTS, sweep

    with progress(f"{name}, prior weights") as advance:
        done = iter(range(1, len(SWEEP_WEIGHTS) + 1))
        count = len(SWEEP_WEIGHTS)
        return sweep(scene, trials, lambda: advance(next(done), count), SWEEP_WEIGHTS)


def _transformed(
    name: str, scene: StudiedScene, trials: int
) -> tuple[tuple[Covariances, Covariances], tuple[Floats, Floats]]:
    """Return the covariances of the first trial, and the differences of all."""
    import numpy as np

    from trajeval_ros.visual_inertial.study import covariances

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
            stopped[trial], converged[trial] = (each.difference for each in pair)
            advance(trial + 1, trials)
    return first, (stopped, converged)
