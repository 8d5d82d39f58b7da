"""`evaluate` and `run` of the Python API: of trajectories, SOURCEs, arrays and tables."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.io.text.reader import array_trajectory
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.pipeline import pipeline
from trajeval_ros.pipeline.outcome import Outcome
from trajeval_ros.pipeline.request import Request

if TYPE_CHECKING:
    import pandas

    Given: TypeAlias = Trajectory | str | Path | NDArray[np.generic] | pandas.DataFrame


def evaluate(groundtruth: Given, estimate: Given, protocol: Protocol | None = None) -> Evaluation:
    """Evaluate one estimate: ATE and relative errors, with warnings.

    Tutorial: alignment by eq. (13) in the protocol's gauge, absolute errors (23) with the RMSE
    (24), relative errors (27) over sub-trajectories (25).

    Args:
        groundtruth: M states; yaw and tilt are about its `up` axis. A `Trajectory`, a SOURCE as
            for `read_trajectory`, an array as in a .npy file, such as (M, 4, 4) or (M, 8), or a
            table as for `Trajectory.from_pandas`. Arrays without times pair by row.
        estimate: N states in their own frame, as the groundtruth. Gauges yaw and planar align its
            `up` axis with the groundtruth's.
        protocol: Association, alignment and errors; None for gauge se3 and lengths of 8 to 40 m.

    Returns:
        Errors in metres and degrees, per pair and as statistics, in the groundtruth's frame. For
        gauges yaw and planar, and association continuous, this frame is converted to z up.

    Raises:
        InputError: A trajectory cannot be evaluated; `NoMatchError` if there is no pair.
        DegenerateGeometryError: Too few states, or no motion, for the gauge's alignment.

    Example:
        >>> from trajeval_ros import Protocol, evaluate, simulate
        >>> flight = simulate(seed=1, duration_s=30.0)
        >>> protocol = Protocol(modality="stereo-inertial", lengths=(8, 16))
        >>> result = evaluate(flight.groundtruth, flight.estimate, protocol)
        >>> 0.0 < result.ate["position_m"].rmse < 1.0
        True
    """
    if not isinstance(protocol, Protocol | None):
        raise InputError(
            f"the protocol is of type {type(protocol).__name__}; give a Protocol, such as "
            "Protocol(modality='mono') or PROTOCOLS['evo']"
        )
    sides = _trajectory(groundtruth, "groundtruth"), _trajectory(estimate, "estimate")
    return pipeline.evaluate(*sides, protocol)


def run(groundtruth: Given, estimates: Sequence[Given], request: Request | None = None) -> Outcome:
    """Evaluate the estimates of one groundtruth according to a request.

    All estimates use the calibration of the first one, because errors with individual calibrations
    cannot be ranked.

    Args:
        groundtruth: M states, as for `evaluate`.
        estimates: Trajectories in frames of their own, with distinct names, as for `evaluate`.
        request: What to compute; by default ATE and relative errors with the default protocol.

    Raises:
        InputError: There is no estimate, or one cannot be evaluated as requested; the message
            starts with its source or name.

    Example:
        >>> from trajeval_ros import Request, run, simulate
        >>> flight = simulate(seed=1, duration_s=30.0)
        >>> outcome = run(flight.groundtruth, [flight.estimate, flight.estimate[::2]], Request())
        >>> len(outcome.runs)
        2
    """
    if not isinstance(estimates, list | tuple):
        raise InputError(f"the estimates are of type {type(estimates).__name__}; give a list")
    inputs = [
        _trajectory(estimate, f"estimate {row}") for row, estimate in enumerate(estimates, 1)
    ]
    return pipeline.run(_trajectory(groundtruth, "groundtruth"), inputs, request)


def _trajectory(given: object, what: str) -> Trajectory:
    """Return a trajectory, which a message calls `what`."""
    if isinstance(given, Trajectory):
        return given
    if isinstance(given, str | Path):
        return read_trajectory(given)
    if isinstance(given, np.ndarray):
        return array_trajectory(given, what)
    if hasattr(given, "columns") and hasattr(given, "to_numpy"):
        return dataclasses.replace(Trajectory.from_pandas(given), name=what)
    raise InputError(
        f"the {what} is of type {type(given).__name__}; give a Trajectory, a file, a numpy array "
        "or a pandas.DataFrame"
    )
