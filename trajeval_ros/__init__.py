"""Evaluate VIO and SLAM trajectories, live and recorded, with one set of definitions.

Lengths are in metres, times in seconds, stamps in int64 nanoseconds, angles in radians unless a
name ends in `_deg`; quaternions are xyzw. What a user can correct is a `TrajevalError`. Everything
is imported when it is first used. docs/api has a script for each feature.

Example:
    >>> from trajeval_ros import Protocol, evaluate, simulate
    >>> flight = simulate(seed=1, duration_s=30.0)
    >>> protocol = Protocol(modality="stereo-inertial")
    >>> evaluation = evaluate(flight.groundtruth, flight.estimate, protocol)
    >>> evaluation.ate["position_m"].rmse < 1.0
    True
"""

from importlib import import_module

TYPE_CHECKING = False  # of `typing`, whose import takes time: Ctrl-C meanwhile is a traceback
if TYPE_CHECKING:
    from trajeval_ros.batch.compare_runs import compare
    from trajeval_ros.calibration.calibrate import Calibration, calibrate
    from trajeval_ros.calibration.calibration_request import CalibrationRequest
    from trajeval_ros.consistency.consistency_assessment import assess_consistency
    from trajeval_ros.consistency.consistency_result import Consistency
    from trajeval_ros.consistency.covariance_request import CovarianceRequest
    from trajeval_ros.consistency.joint_covariance import JointCovariance
    from trajeval_ros.continuous_time.continuous_trajectory import (
        ContinuousTrajectory,
        fit_trajectory,
    )
    from trajeval_ros.continuous_time.samples import Noise
    from trajeval_ros.exceptions import InputError, NoMatchError, SettingsError, TrajevalError
    from trajeval_ros.explanation.explain import explain
    from trajeval_ros.geometry.gauge import MODALITIES, Gauge, Similarity
    from trajeval_ros.geometry.marker import HandEye
    from trajeval_ros.geometry.trajectory import Trajectory
    from trajeval_ros.io.python_inputs import evaluate, run
    from trajeval_ros.io.results.result_folder import write_result
    from trajeval_ros.io.sources import read_many, read_trajectory
    from trajeval_ros.likelihood.likelihood_assessment import assess_likelihood
    from trajeval_ros.metrics.alignment import align
    from trajeval_ros.metrics.association_rule import AssociationRule
    from trajeval_ros.metrics.evaluation import Evaluation
    from trajeval_ros.metrics.protocol import PROTOCOLS, Protocol
    from trajeval_ros.metrics.statistics import Statistics
    from trajeval_ros.metrics.sub_trajectories import Length
    from trajeval_ros.online.evaluator import OnlineEvaluator
    from trajeval_ros.online.live_settings import OnlineSettings
    from trajeval_ros.pipeline.outcome import Outcome, RunOutcome
    from trajeval_ros.pipeline.request import Request
    from trajeval_ros.report.figures import draw
    from trajeval_ros.simulation.drifting_odometry import simulate

__version__ = "0.4.0"

__all__ = [
    "MODALITIES",
    "PROTOCOLS",
    "AssociationRule",
    "Calibration",
    "CalibrationRequest",
    "Consistency",
    "ContinuousTrajectory",
    "CovarianceRequest",
    "Evaluation",
    "Gauge",
    "HandEye",
    "InputError",
    "JointCovariance",
    "Length",
    "NoMatchError",
    "Noise",
    "OnlineEvaluator",
    "OnlineSettings",
    "Outcome",
    "Protocol",
    "Request",
    "RunOutcome",
    "SettingsError",
    "Similarity",
    "Statistics",
    "Trajectory",
    "TrajevalError",
    "align",
    "assess_consistency",
    "assess_likelihood",
    "calibrate",
    "compare",
    "draw",
    "evaluate",
    "explain",
    "fit_trajectory",
    "read_many",
    "read_trajectory",
    "run",
    "simulate",
    "write_result",
]

# The module of each name.
_HOMES = {
    "AssociationRule": "metrics.association_rule",
    "Calibration": "calibration.calibrate",
    "CalibrationRequest": "calibration.calibration_request",
    "Consistency": "consistency.consistency_result",
    "ContinuousTrajectory": "continuous_time.continuous_trajectory",
    "CovarianceRequest": "consistency.covariance_request",
    "Evaluation": "metrics.evaluation",
    "Gauge": "geometry.gauge",
    "HandEye": "geometry.marker",
    "InputError": "exceptions",
    "JointCovariance": "consistency.joint_covariance",
    "Length": "metrics.sub_trajectories",
    "MODALITIES": "geometry.gauge",
    "NoMatchError": "exceptions",
    "Noise": "continuous_time.samples",
    "OnlineEvaluator": "online.evaluator",
    "OnlineSettings": "online.live_settings",
    "Outcome": "pipeline.outcome",
    "PROTOCOLS": "metrics.protocol",
    "Protocol": "metrics.protocol",
    "Request": "pipeline.request",
    "RunOutcome": "pipeline.outcome",
    "SettingsError": "exceptions",
    "Similarity": "geometry.gauge",
    "Statistics": "metrics.statistics",
    "Trajectory": "geometry.trajectory",
    "TrajevalError": "exceptions",
    "align": "metrics.alignment",
    "assess_likelihood": "likelihood.likelihood_assessment",
    "calibrate": "calibration.calibrate",
    "compare": "batch.compare_runs",
    "draw": "report.figures",
    "evaluate": "io.python_inputs",
    "explain": "explanation.explain",
    "fit_trajectory": "continuous_time.continuous_trajectory",
    "assess_consistency": "consistency.consistency_assessment",
    "read_many": "io.sources",
    "read_trajectory": "io.sources",
    "run": "io.python_inputs",
    "simulate": "simulation.drifting_odometry",
    "write_result": "io.results.result_folder",
}


def __getattr__(name: str) -> object:
    """Import a name of the API when it is first used."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, "__doc__", "__version__"})
