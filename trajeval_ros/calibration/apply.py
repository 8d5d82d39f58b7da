"""Evaluation with an estimated or known clock offset and hand-eye transform.

An estimated parameter is applied if it is requested, observable, precise and significant. The
outcome lists the applied and the rejected parameters with reasons, and the errors before and
after.
"""

from __future__ import annotations

import contextlib
import dataclasses
from dataclasses import dataclass

import numpy as np

from trajeval_ros.calibration.calibrate import Calibration, calibrate
from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.calibration.significance import UNOBSERVABLE, WEAK, Parameter
from trajeval_ros.exceptions import (
    DegenerateGeometryError,
    InputError,
    NoMatchError,
    SettingsError,
)
from trajeval_ros.formatting.remarks import Remark, warning
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.association import Association
from trajeval_ros.metrics.evaluation import Evaluation, evaluate, evaluate_pairs
from trajeval_ros.metrics.pair_alignment import align_pairs
from trajeval_ros.metrics.protocol import Protocol


@dataclass(frozen=True)
class Ate:
    """The RMSE of an evaluation: position in metres, rotation in degrees if available."""

    position_m: float
    rotation_deg: float | None

    @classmethod
    def of(cls, evaluation: Evaluation) -> Ate:
        """Return the RMSE of an evaluation."""
        position, rotation = evaluation.ate["position_m"], evaluation.ate["rotation_deg"]
        assert position is not None
        return cls(position.rmse, None if rotation is None else rotation.rmse)


@dataclass(frozen=True, eq=False)
class Calibrated:
    """An evaluation with the applied calibration."""

    evaluation: Evaluation  # the evaluation with the applied parameters
    request: CalibrationRequest
    calibration: Calibration | None  # the estimated parameters; None if nothing was estimated
    estimated_from: str  # name of the estimate that they were estimated from
    offset_applied: bool  # whether the estimated offset is applied
    rotation_applied: bool  # whether a rotation of the body is applied
    lever_applied: bool  # whether a lever arm is applied
    hand_eye: HandEye | None  # the applied transform; None if there is none
    # Whether the errors are those of the marker's position. This is so if the groundtruth has no
    # orientations, which a conversion to the body needs.
    of_marker: bool
    # The errors without calibration; None if there were too few pairs.
    before: Ate | None
    after: Ate  # the errors of `evaluation`
    # The errors with all requested parameters, significant or not; None if these are the applied
    # ones, or nothing was estimated.
    if_applied: Ate | None

    @property
    def parameters_applied(self) -> int:
        """Degrees of freedom of the applied parameters that were estimated from the data."""
        if self.calibration is None:
            return 0
        count = int(self.offset_applied)
        if self.request.known is None:
            count += self.calibration.rotation.seen if self.rotation_applied else 0
            count += self.calibration.lever.seen if self.lever_applied else 0
        return count


# Growth of the ATE above which a warning is given.
_WORSE = 1.05
# An iteration reduces the error by the ratio of the lever arm's motion to the marker's motion.
_SAME_SCALE, _ROUNDS_OF_SCALE = 1e-10, 300
_VANISHED = 1e-6


def evaluate_calibrated(
    groundtruth: Trajectory,
    estimate: Trajectory,
    protocol: Protocol,
    request: CalibrationRequest,
    *,
    same_as: Calibrated | None = None,
    pairs: Association | None = None,
    compares: bool = True,
) -> Calibrated:
    """Evaluate an estimate with the requested calibration.

    The groundtruth has poses or positions of a marker. The protocol's time offset is the centre of
    the search. `same_as` is the outcome of another estimate whose calibration is used: estimates
    with individual calibrations cannot be ranked. `pairs` were paired before, as in a live run.
    Only if it `compares`, the error without the calibration is computed.
    """
    if protocol.lever_m is not None and (request.hand_eye or request.known is not None):
        raise SettingsError(
            f"protocol {protocol.name} already defines a lever arm; remove --hand-eye, or use a "
            "protocol file with a different lever_m"
        )
    if request.known is not None:
        request.known.require_frames(groundtruth, estimate)
    calibration, source = None, estimate.name
    if same_as is not None:
        calibration, source = same_as.calibration, same_as.estimated_from
    elif request.offset or request.hand_eye:
        calibration = calibrate(
            groundtruth, estimate, protocol.gauge, around_s=protocol.association.time_offset_s
        )
    if calibration is not None:
        _require_body_known(calibration, protocol, request)
    parameters = _Significant.in_calibration(calibration, request)
    used = parameters.significant()
    before = None  # if the states cannot be paired or aligned
    with contextlib.suppress(NoMatchError, DegenerateGeometryError):
        if compares:
            before = Ate.of(_measure(groundtruth, estimate, protocol, pairs))
    try:
        evaluation, of_marker = _with(groundtruth, estimate, protocol, used, pairs)
    except NoMatchError as error:
        if calibration is None or not request.offset or used.offset is not None:
            raise
        why = calibration.offset.reason
        raise NoMatchError(f"{error}; --time-offset auto finds no offset: {why}") from error
    after = Ate.of(evaluation)
    calibrated = Calibrated(
        evaluation=evaluation,
        request=request,
        calibration=calibration,
        estimated_from=source,
        offset_applied=used.offset is not None,
        rotation_applied=not of_marker and (used.rotation or used.known) is not None,
        lever_applied=(used.lever or used.known) is not None,
        hand_eye=used.hand_eye,
        of_marker=of_marker,
        before=before,
        after=after,
        if_applied=None
        if parameters == used
        else Ate.of(_with(groundtruth, estimate, protocol, parameters, pairs)[0]),
    )
    remarks = (*evaluation.remarks, *_remarks(calibrated))
    return dataclasses.replace(
        calibrated, evaluation=dataclasses.replace(evaluation, remarks=remarks)
    )


def _require_body_known(
    calibration: Calibration, protocol: Protocol, request: CalibrationRequest
) -> None:
    """Refuse an alignment by orientations if the rotation between the bodies is unknown."""
    rotation = calibration.rotation
    if (
        protocol.align_with == "poses"
        and request.hand_eye
        and rotation.status in (WEAK, UNOBSERVABLE)
    ):
        raise InputError(
            "--hand-eye auto can't estimate the rotation between the two bodies "
            f"({rotation.reason}), so orientations can't be used for the alignment; use "
            "--align-with positions, or give --hand-eye FILE"
        )


@dataclass(frozen=True)
class _Significant:
    """The requested parameters that have a value: offset, rotation, lever arm, or a transform."""

    offset: Parameter | None
    rotation: Parameter | None
    lever: Parameter | None
    known: HandEye | None

    @classmethod
    def in_calibration(
        cls, calibration: Calibration | None, request: CalibrationRequest
    ) -> _Significant:
        """Return the requested parameters of a calibration."""

        def asked(parameter: Parameter, wish: bool) -> Parameter | None:
            return parameter if wish and parameter.value is not None else None

        if calibration is None:
            return cls(None, None, None, request.known)
        return cls(
            asked(calibration.offset, request.offset),
            asked(calibration.rotation, request.hand_eye),
            asked(calibration.lever, request.hand_eye),
            request.known,
        )

    def significant(self) -> _Significant:
        """Return the parameters that are observable, precise and significant."""
        offset, rotation, lever = (
            parameter if parameter is not None and parameter.is_significant else None
            for parameter in (self.offset, self.rotation, self.lever)
        )
        return _Significant(offset, rotation, lever, self.known)

    @property
    def hand_eye(self) -> HandEye | None:
        """The transform of these parameters; None if there is none."""
        if self.rotation is None and self.lever is None:
            return self.known
        return HandEye.of(
            None if self.rotation is None else self.rotation.value,
            None if self.lever is None else self.lever.value,
        )


def _measure(
    groundtruth: Trajectory, estimate: Trajectory, protocol: Protocol, pairs: Association | None
) -> Evaluation:
    """Evaluate, with given pairs if there are any."""
    if pairs is None:
        return evaluate(groundtruth, estimate, protocol)
    moved = dataclasses.replace(pairs, groundtruth=groundtruth, estimate=estimate)
    return evaluate_pairs(moved, groundtruth, estimate, protocol)


def _with(
    groundtruth: Trajectory,
    estimate: Trajectory,
    protocol: Protocol,
    used: _Significant,
    pairs: Association | None,
) -> tuple[Evaluation, bool]:
    """Evaluate with parameters; the second value is whether errors are those of the marker."""
    hand_eye = used.hand_eye
    if used.offset is not None:
        assert used.offset.value is not None
        offset_s = float(used.offset.value[0])
        rule = dataclasses.replace(protocol.association, time_offset_s=offset_s)
        protocol = dataclasses.replace(protocol, association=rule)
    if hand_eye is None:
        return _measure(groundtruth, estimate, protocol, pairs), False
    if groundtruth.quaternions is not None:
        of_body = hand_eye.of_body(groundtruth, hand_eye.body or estimate.child_frame)
        return _measure(of_body, estimate, protocol, pairs), False
    scale = 1.0
    if protocol.gauge.has_scale:
        body = _measure(groundtruth, estimate, dataclasses.replace(protocol, lengths=()), pairs)
        scale = _scale(body, protocol, hand_eye)
    marker = hand_eye.of_marker(estimate, scale, hand_eye.marker or groundtruth.child_frame)
    return _measure(groundtruth, marker, protocol, pairs), True


def _scale(body: Evaluation, protocol: Protocol, hand_eye: HandEye) -> float:
    """Return the scale of the marker's alignment, if the lever arm in metres is divided by it."""
    pairs, first = body.association, body.alignment.similarity.scale
    scale = first
    for _ in range(_ROUNDS_OF_SCALE):
        if scale <= _VANISHED * first:
            break
        marker = hand_eye.of_marker(pairs.estimate, scale)
        moved = dataclasses.replace(pairs, estimate=marker)
        last, scale = scale, align_pairs(moved, protocol).similarity.scale
        if abs(scale - last) <= _SAME_SCALE * scale:
            return scale
    raise DegenerateGeometryError(
        f"no scale of {body.estimate.name or 'the estimate'} is compatible with the lever arm of "
        f"{np.linalg.norm(hand_eye.lever_m):.3g} m, since the motion is too small; remove "
        "--hand-eye, or use a gauge without scale"
    )


def _remarks(calibrated: Calibrated) -> list[Remark]:
    """Return warnings about the calibration and about significant clock offsets."""
    calibration, request = calibrated.calibration, calibrated.request
    warnings = list(() if calibration is None else calibration.remarks)
    before, after = calibrated.before, calibrated.after
    something = calibrated.offset_applied or calibrated.hand_eye is not None
    if something and before is not None and after.position_m > _WORSE * before.position_m:
        warnings.append(
            warning(
                "calibration_worsens",
                f"the calibration increases the position ATE from {before.position_m:.4g} m to "
                f"{after.position_m:.4g} m, so it does not explain the error",
            )
        )
    if calibration is not None and not request.offset and calibration.offset.is_significant:
        assert calibration.offset.value is not None
        assert calibration.offset.half_width_95 is not None
        assumed_s = calibrated.evaluation.protocol.association.time_offset_s
        apart_s = float(calibration.offset.value[0]) - assumed_s
        if abs(apart_s) > 2.0 * calibration.offset.half_width_95[0]:
            warnings.append(
                warning(
                    "clock_offset_not_corrected",
                    f"the clocks differ by {1e3 * apart_s:+.1f} ms, which is not corrected; add "
                    "--time-offset auto",
                )
            )
    return warnings
