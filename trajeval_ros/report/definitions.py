"""Definitions and labels of the numbers as text, for result lines, tables and figures."""

from __future__ import annotations

from collections.abc import Sequence

from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.metrics.absolute_errors import AbsoluteErrors
from trajeval_ros.metrics.evaluation import Evaluation

METHOD_TEXTS = {
    "auto": "groundtruth interpolated (for points and fixes the estimate), gaps up to "
    "{0.max_gap_s:g} s",
    "linear": "groundtruth interpolated, gaps up to {0.max_gap_s:g} s",
    "groundtruth-stamps": "estimate interpolated at the groundtruth's timestamps, gaps up to "
    "{0.max_gap_s:g} s",
    "continuous": "groundtruth at the estimate's timestamps from model {0.model}, including gaps",
    "nearest": "nearest timestamps one to one, within {0.max_time_difference_s:g} s",
    "rpg": "nearest timestamps one to one, under {0.max_time_difference_s:g} s",
    "evo": "nearest timestamps many to one, within {0.max_time_difference_s:g} s",
    "index": "paired by frame or row index",
}
WEIGHT_TEXTS = {
    "none": "",
    "covariance": ", weighted by covariance",
    "groundtruth-covariance": ", weighted by the groundtruth's covariance",
}
RE_FORM_TEXTS = {
    "gauge": "first state aligned by the gauge, position difference at the end",
    "se3": "relative poses, SE(3) at the first state",
    "tutorial": "eq. (26) of the tutorial",
    "matrices": "relative poses, with the matrices of the file",
    "fitted": "yaw and position fitted to every sub-trajectory, position difference at the end",
    "evo": "relative poses, as evo_rpe",
    "euler": "relative poses, as rpg_trajectory_evaluation; yaw and tilt are its Euler angles",
}
ABSOLUTE_LABELS = {
    "position_m": "position [m]",
    "horizontal_m": "horizontal [m]",
    "vertical_m": "vertical [m]",
    "rotation_deg": "rotation [deg]",
    "yaw_deg": "yaw [deg]",
    "tilt_deg": "tilt [deg]",
    "velocity_mps": "velocity [m/s]",
    "gyroscope_bias": "gyroscope bias [rad/s]",
    "accelerometer_bias": "accelerometer bias [m/s^2]",
    "rotation_part": "rotation part",
    "full": "full pose",
}
RELATIVE_STATISTICS = ("rmse", "mean", "median")  # that a terminal can show
RELATIVE_LABELS = {
    "position_m": "position [m]",
    "position_percent": "position [%]",
    "rotation_deg": "rotation [deg]",
    "rotation_deg_per_m": "rotation [deg/m]",
    "yaw_deg": "yaw [deg]",
    "tilt_deg": "tilt [deg]",
    "velocity_mps": "velocity [m/s]",
    "distance_m": "distance [m]",
    "distance_percent": "distance [%]",
    "rotation_part": "rotation part",
    "full": "full pose",
}


def alignment_of(evaluations: Sequence[Evaluation], *, brief: bool = False) -> str:
    """Return what the alignment fits to which pairs; `brief`: for the result lines."""
    protocol, first = evaluations[0].protocol, evaluations[0].alignment
    if protocol.gauge is Gauge.NONE:
        return "not aligned" if brief else protocol.gauge.description
    text = f"aligned by {protocol.gauge.description}"
    if protocol.gauge.has_scale and len(evaluations) == 1:
        text += f", scale {first.similarity.scale:.4f}"
    used = {evaluation.alignment.states_used for evaluation in evaluations}
    number = used.pop() if len(used) == 1 else protocol.align_states
    count = "pairs" if number is None else counted(number, "pair")
    pairs = f"all {count}"
    if protocol.align_states is not None:
        pairs = "the first pair" if number == 1 else f"the first {count}"
    only = ", only its scale applied" if protocol.apply == "scale" else ""
    if brief:
        return f"{text}{only}" if protocol.align_states is None else f"{text}, {pairs}{only}"
    sensors = f" for {protocol.modality}" if protocol.modality else ""
    poses = " with orientations" if protocol.align_with == "poses" else ""
    weights = WEIGHT_TEXTS[protocol.align_weights]
    return f"{text}, gauge {protocol.gauge.value}{sensors}, {pairs}{only}{poses}{weights}"


def absolute_form_of(evaluations: Sequence[Evaluation]) -> str:
    """Return the form of the absolute error."""
    if evaluations[0].protocol.ate_form == "tutorial":
        return "Absolute error, eq. (23) of the tutorial"
    return "Absolute error, position difference"


def first_state_alignment_of(evaluations: Sequence[Evaluation]) -> str:
    """Return how sub-trajectories are aligned at their first states."""
    protocol = evaluations[0].protocol
    if protocol.re_form == "fitted":
        return "aligned by yaw and position over all states of a sub-trajectory"
    by_gauge = protocol.re_form in ("gauge", "tutorial")
    what = "yaw and position" if by_gauge and protocol.gauge is Gauge.YAW else "SE(3)"
    if by_gauge and protocol.gauge is Gauge.PLANAR:
        what = "SE(2), 2-D errors"
    if protocol.gauge is Gauge.SIM3:
        what += " with the global scale"
    equation = ", eq. (26) of the tutorial" if protocol.re_form == "tutorial" else ""
    return f"aligned at the first state by {what}{equation}"


def why_no_rotation(evaluation: Evaluation) -> str:
    """Return why rotation errors are withheld."""
    return evaluation.doubts.about(AbsoluteErrors, "rotation_deg")
