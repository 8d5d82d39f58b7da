"""Evaluation of the output folder of a live run, by the pipeline for recorded runs.

The folder has the states of both sides as they were received, and the settings of the run. The
evaluation is that of a recording of the same topics. `NAME.revised` has the last message of an
estimate of type `nav_msgs/Path`: the trajectory as finally revised by the estimator. Then the
errors are those of the revised trajectory, and the ATE of the poses as first published is stored
as `causal_ate`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.consistency.covariance_request import CovarianceRequest
from trajeval_ros.exceptions import InputError, SettingsError, TrajevalError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import Remark, remark_of, warning
from trajeval_ros.geometry.arrays import Stamps
from trajeval_ros.geometry.fix_selection import FixRule, trajectory_of_rows
from trajeval_ros.geometry.geodesy import Datum
from trajeval_ros.geometry.source_info import DeclaredReset, ReceiveTimes, SourceInfo
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.geometry.valid_poses import add_counts
from trajeval_ros.io.checks import check_rotations
from trajeval_ros.io.hand_eye_file import hand_eye_of
from trajeval_ros.io.live.fix_file import read_fix_rows
from trajeval_ros.io.live.state_file import (
    GROUNDTRUTH,
    REVISED_SUFFIX,
    RecordedStates,
    read_states,
    state_files,
)
from trajeval_ros.io.requests.request_from import request_from
from trajeval_ros.io.requests.setting import NONE, Setting
from trajeval_ros.io.requests.settings_table import SETTINGS, settings_with
from trajeval_ros.io.results.result_json import statistics_json
from trajeval_ros.metrics.association_rule import AT_GROUNDTRUTH
from trajeval_ros.metrics.input_summary import InputSummary
from trajeval_ros.metrics.stream_health import UNKNOWN
from trajeval_ros.online.live_availability import received_poses
from trajeval_ros.pipeline.outcome import (
    FailedRun,
    Outcome,
    RunOutcome,
    with_noise_corrected_ates,
    with_same_estimates_named,
)
from trajeval_ros.pipeline.pipeline import run_alone
from trajeval_ros.pipeline.request import Request


@dataclass(frozen=True, eq=False)
class _EvaluatedFile:
    """The evaluation of one estimate."""

    place: int  # position of the estimate in the configuration, from 0
    request: Request
    groundtruth: InputSummary  # summary of the groundtruth
    run: RunOutcome  # the evaluation
    stated: Mapping[str, Any]  # settings of the node by name


def evaluate_folder(
    folder: Path, request: Request | None = None, align_with: str | None = None
) -> Outcome:
    """Evaluate all estimates of a live run, which can still be running.

    The settings are those of the run, where `request` has none. `align_with` replaces the run's.

    Raises:
        InputError: It is no folder of a live run, or no estimate can be evaluated.
        SettingsError: The request contradicts the run's settings.
    """
    request = request or Request()
    paths = state_files(folder)
    groundtruth = read_states(folder / GROUNDTRUTH)
    evaluated: list[_EvaluatedFile] = []
    failed: list[FailedRun] = []
    for path in paths:
        try:
            estimate = _evaluate(path, groundtruth, request, align_with)
        except SettingsError:
            raise
        except TrajevalError as error:
            failed.append(FailedRun(path.stem, str(path), str(error)))
            continue
        evaluated.append(estimate)
    if not evaluated:
        raise InputError("; ".join(failure.reason for failure in failed))
    evaluated.sort(key=lambda estimate: estimate.place)
    first = evaluated[0]
    # Jumps are attributed to fixes or estimates by comparing the estimates.
    runs = with_same_estimates_named([estimate.run for estimate in evaluated])
    runs = with_noise_corrected_ates(runs, first.request.fixes)
    request = dataclasses.replace(first.request, protocol=runs[0].evaluation.protocol)
    settings = settings_with(request, first.stated)
    return Outcome(request, first.groundtruth, tuple(runs), tuple(failed), settings)


def _evaluate(
    path: Path, groundtruth: RecordedStates, request: Request, align_with: str | None
) -> _EvaluatedFile:
    """Evaluate an estimate; values of a wrong type in its file raise various exceptions."""
    recorded = read_states(path)
    if not recorded.state:
        raise InputError(f"{path.stem}: no pose so far")
    try:
        return _of_states(path, groundtruth, recorded, request, align_with)
    except InputError as error:
        damage = [remark.text for side in (groundtruth, recorded) for remark in side.remarks]
        raise InputError("; ".join([str(error), *damage])) from error
    except (KeyError, TypeError, AttributeError, ValueError, ArithmeticError) as error:
        raise InputError(f"{path} is damaged or from another version: {error!r}") from error


def _of_states(
    path: Path,
    groundtruth: RecordedStates,
    recorded: RecordedStates,
    request: Request,
    align_with: str | None,
) -> _EvaluatedFile:
    state, name = recorded.state, str(recorded.description["name"])
    asked_live = _request_of(state, align_with, path)
    asked = _with_settings_of(request, asked_live)
    truth = _groundtruth(path.parent, groundtruth, state["groundtruth"], state["fixes"])
    estimate = _trajectory(recorded, state["estimate"], name)
    if asked.up is not None:
        axes = zip((truth, estimate), asked.up, strict=True)
        truth, estimate = (dataclasses.replace(side, up=UpAxis(up)) for side, up in axes)
    if asked.available.is_asked_for:
        estimate = _with_poses_as_received(estimate, recorded)
    if state["until_ns"] is not None:
        truth, estimate = _until(int(state["until_ns"]), truth, estimate, asked)
    live = dict(state["live"])
    revised = path.with_suffix(REVISED_SUFFIX)
    if revised.exists():
        _, causal = run_alone(truth, estimate, asked)
        live["causal_ate"] = {
            metric: statistics_json(ate) for metric, ate in causal.evaluation.ate.items()
        }
        as_received = estimate.reading.as_received
        estimate = _trajectory(read_states(revised), state["estimate"], name)
        reading = dataclasses.replace(estimate.reading, as_received=as_received)
        estimate = dataclasses.replace(estimate, reading=reading)
    summary, run, remarks = _tested(truth, estimate, asked, request.covariances)
    remarks += [remark_of(item) for item in state["warnings"]]
    remarks += _about_end(recorded)
    evaluation = dataclasses.replace(run.evaluation, remarks=(*run.evaluation.remarks, *remarks))
    run = dataclasses.replace(run, evaluation=evaluation, live=live, stream=None)
    # The settings state the rule that selected the fixes, not the datum that resulted.
    stated = dataclasses.replace(asked, fixes=FixRule(correlation_s=asked.fixes.correlation_s))
    place = int(recorded.description["place"])
    return _EvaluatedFile(place, stated, summary, run, dict(state["settings"]))


def _request_of(state: Mapping[str, Any], align_with: str | None, path: Path) -> Request:
    """Return the request of the live run, with what it has decided at its start."""
    settings = {
        name: _as_option(value, SETTINGS[name])
        for name, value in state["settings"].items()
        if value != SETTINGS[name].default
    }
    settings |= {"hand_eye": NONE, "time_offset": float(state["time_offset_s"])}
    if settings.get("alert_limit") is None:
        settings.pop("risk", None)
    try:
        request = request_from(settings)
        protocol, fixes = request.protocol, request.fixes
        # Number of states when the alignment was frozen.
        frozen = int(state["aligned_by"]) if state["aligned_by"] else protocol.align_states
        protocol = dataclasses.replace(
            protocol, align_with=align_with or protocol.align_with, align_states=frozen
        )
        if state["fixes"] is not None:  # the live run has selected them
            fixes = FixRule(Datum(*state["fixes"]), correlation_s=fixes.correlation_s)
        calibration = CalibrationRequest()
        if (body := state["hand_eye"]) is not None:
            known = hand_eye_of(body["T_body_marker"], str(path))
            calibration = CalibrationRequest(known=known, source=str(body["source"]))
    except SettingsError as error:  # a damaged file; other estimates can be valid
        raise InputError(f"{path} is damaged or from another version: {error}") from error
    return dataclasses.replace(
        request,
        protocol=protocol,
        calibration=calibration,
        fixes=fixes,
        gauge_is_default=False,
    )


def _as_option(value: Any, setting: Setting) -> Any:
    """Return a value of `settings_of` as `request_from` takes it."""
    if isinstance(value, list):
        return ",".join(map(str, value)) or NONE
    return str(value) if setting.kind is str and value is not None else value


def _with_settings_of(request: Request, live: Request) -> Request:
    """Return the request with the settings of the live run where it has none."""
    return dataclasses.replace(
        live,
        calibration=request.calibration if request.calibration.anything else live.calibration,
        covariances=request.covariances
        if request.covariances.source != NONE
        else live.covariances,
        up=request.up or live.up,
        available=request.available if request.available.is_asked_for else live.available,
        time_span=request.time_span,
        states_table=request.states_table,
    )


def _groundtruth(
    folder: Path, recorded: RecordedStates, counts: Mapping[str, Any], datum: object
) -> Trajectory:
    """Return the groundtruth of a run; its fixes are stored as in their messages."""
    name = str(recorded.description["name"])
    if datum is None:
        return _trajectory(recorded, counts, name)
    stamps, rows, remarks = read_fix_rows(folder)
    reading = _reading(recorded, counts)
    reading = dataclasses.replace(reading, remarks=(*reading.remarks, *remarks))
    return trajectory_of_rows(
        reading.source,
        stamps,
        rows[:, :3],
        rows[:, 3:],
        reading,
        child_frame=str(counts["child_frame"]),
        name=name,
    )


def _reading(recorded: RecordedStates, counts: Mapping[str, Any]) -> SourceInfo:
    return SourceInfo(
        source=str(recorded.description["source"]),
        dropped={str(reason): int(count) for reason, count in counts["dropped"].items()},
        remarks=(*map(remark_of, counts["notes"]), *recorded.remarks),
        resets=tuple(DeclaredReset(*reset) for reset in counts["resets"]),
    )


def _trajectory(recorded: RecordedStates, counts: Mapping[str, Any], name: str) -> Trajectory:
    """Return recorded states as a trajectory, as the reader of a bag does."""
    states, reading = recorded.states, _reading(recorded, counts)
    quaternions, remarks = check_rotations(states.quaternions)
    velocities, covariances = states.velocities, states.covariances
    is_moving = quaternions is not None and velocities is not None and velocities.any()
    return dataclasses.replace(
        states,
        quaternions=quaternions,
        velocities=velocities if is_moving else None,
        covariances=covariances if covariances is not None and covariances.any() else None,
        frame=str(counts["frame"]),
        child_frame=str(counts["child_frame"]),
        up=_up_axis(counts["up"]),
        name=name,
        reading=dataclasses.replace(
            reading,
            has_identity_rotations=states.quaternions is not None and quaternions is None,
            dropped=add_counts(reading.dropped, states.reading.dropped),
            remarks=(*reading.remarks, *states.reading.remarks, *remarks),
            receive_times=_in_order(states.reading.receive_times),
        ),
    )


def _in_order(receive_times: ReceiveTimes | None) -> ReceiveTimes | None:
    """Return receive times if all are known, by a clock that did not start again."""
    if receive_times is None or UNKNOWN in receive_times.times:
        return None
    return receive_times if (np.diff(receive_times.times) >= 0).all() else None


def _up_axis(words: Mapping[str, str]) -> UpAxis:
    try:
        return UpAxis(**words)
    except SettingsError as error:  # of a damaged file, and no mistake of the user
        raise ValueError(str(error)) from error


def _with_poses_as_received(estimate: Trajectory, recorded: RecordedStates) -> Trajectory:
    """Return an estimate with the poses as received, where the receive time is known."""
    if len(recorded.received):
        received = received_poses(recorded.received, estimate.up)
    else:
        receive_times = recorded.states.reading.receive_times
        assert receive_times is not None
        received = dataclasses.replace(estimate, reading=SourceInfo(receive_times=receive_times))
        received = received[receive_times.times != UNKNOWN]
    reading = dataclasses.replace(estimate.reading, as_received=received)
    return dataclasses.replace(estimate, reading=reading)


def _until(
    until_ns: int, groundtruth: Trajectory, estimate: Trajectory, request: Request
) -> tuple[Trajectory, Trajectory]:
    """Return the states before the next run, and the one after them that interpolation needs."""
    rule = request.protocol.association
    interpolates_estimate = rule.for_kind(groundtruth.kind).method == AT_GROUNDTRUTH
    offset_ns = round(rule.time_offset_s * NANOSECONDS)
    return (
        _cut(groundtruth, groundtruth.stamps, until_ns, one_more=not interpolates_estimate),
        _cut(estimate, estimate.stamps + offset_ns, until_ns, one_more=interpolates_estimate),
    )


def _cut(states: Trajectory, stamps: Stamps, until_ns: int, *, one_more: bool) -> Trajectory:
    after = stamps[stamps >= until_ns]
    if one_more and len(after):
        until_ns = int(after.min()) + 1
    return states[stamps < until_ns]


def _tested(
    groundtruth: Trajectory, estimate: Trajectory, request: Request, asked: CovarianceRequest
) -> tuple[InputSummary, RunOutcome, list[Remark]]:
    """Evaluate an estimate and test its covariances.

    If a test that only the live run requested is not possible, there is a warning instead.
    """
    try:
        return *run_alone(groundtruth, estimate, request), []
    except TrajevalError as error:
        if request.covariances.source == NONE or asked.source != NONE:
            raise
        untested = dataclasses.replace(request, covariances=CovarianceRequest(), integrity=None)
        summary, run = run_alone(groundtruth, estimate, untested)
        text = f"the consistency test is not possible: {error}"
        return summary, run, [warning("no_consistency_test", text)]


def _about_end(recorded: RecordedStates) -> Iterator[Remark]:
    """Yield a warning about an end without the last counts."""
    if recorded.later or recorded.torn:
        yield warning(
            "live_run_stopped",
            "the live run stopped before its last counts were written: counts of lost and "
            f"dropped messages are from {counted(recorded.later, 'pose')} before the end",
        )
