"""From the words of the command line to likelihoods of evaluated runs."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from trajeval_ros.exceptions import InputError, SettingsError, TrajevalError
from trajeval_ros.geometry.gauge import Gauge

if TYPE_CHECKING:
    from trajeval_ros.io.results.result_json import Run
    from trajeval_ros.likelihood.assessment import Assessment
    from trajeval_ros.metrics.protocol import Protocol

CONTINUOUS = "continuous"


def with_model(
    protocol: Protocol, model: str | None, noise: tuple[float, float] | None
) -> Protocol:
    """Return the protocol with the groundtruth's model and noise, where it asks for one.

    Args:
        protocol: With its association.
        model: Its name; None for the default one.
        noise: Standard deviations of groundtruth positions (m) and rotations (deg).

    Raises:
        SettingsError: They mean nothing, or nothing together.
    """
    rule = protocol.association
    if rule.method != CONTINUOUS:
        if model is not None:
            raise SettingsError(
                f"--continuous-model is for --association continuous, not {rule.method}"
            )
        return protocol
    if protocol.gauge is Gauge.PLANAR:
        raise SettingsError(
            "association continuous is of poses in space, and gauge planar leaves a plane; use "
            "gauge yaw, or association linear"
        )
    if noise is not None:
        from trajeval_ros.continuous_time.samples import Noise

        rule = dataclasses.replace(rule, noise=Noise(noise[0], math.radians(noise[1])))
    if model is not None:
        rule = dataclasses.replace(rule, model=model)
    return dataclasses.replace(protocol, association=rule)


def assessed(runs: Sequence[Run]) -> list[Run]:
    """Return the runs with their likelihoods, where groundtruth was continuous.

    Raises:
        InputError: One of them has none; says which and why.
    """
    if runs[0].evaluation.protocol.association.method != CONTINUOUS:
        return list(runs)
    from trajeval_ros.likelihood.assessment import compared

    assessments = [_assessed(run) for run in runs]
    names = [run.estimate.name for run in runs]
    return [
        dataclasses.replace(run, probabilistic=assessment)
        for run, assessment in zip(runs, compared(names, assessments), strict=True)
    ]


def _assessed(run: Run) -> Assessment:
    from trajeval_ros.likelihood.assessment import assess

    try:
        return assess(run.evaluation)
    except TrajevalError as error:
        raise InputError(f"{run.estimate.source}: {error}") from error
