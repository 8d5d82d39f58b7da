"""Absolute errors as vectors, axis by axis: eq. (23) of the tutorial before lengths are taken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.metrics.absolute_errors import position_errors, rotation_errors
from trajeval_ros.metrics.evaluation import Evaluation


@dataclass(frozen=True, eq=False)
class ErrorVectors:
    """Errors of N aligned states, groundtruth minus estimate; None if not available.

    Attributes:
        position_world_m: (N, 3), along the axes of the groundtruth's frame. Its length is
            `AbsoluteErrors.position_m`.
        position_body_m: (N, 3), the same vector along the axes of the groundtruth's body.
        rotation_world_deg: (N, 3), rotation vector of E = R R'^T, about the axes of the
            groundtruth's frame: roll, pitch, yaw. Its length is `AbsoluteErrors.rotation_deg`.
        rotation_body_deg: (N, 3), rotation vector of R'^T R, about the axes of the body. It is
            the same for the groundtruth's and the estimate's body: E keeps its own axis.
    """

    position_world_m: Floats
    position_body_m: Floats | None = None
    rotation_world_deg: Floats | None = None
    rotation_body_deg: Floats | None = None


def error_vectors(evaluation: Evaluation) -> ErrorVectors:
    """Return the errors of an evaluation's pairs as vectors, in the form of its ATE."""
    truth, aligned = evaluation.association.groundtruth, evaluation.aligned
    position = position_errors(truth, aligned, evaluation.protocol.ate_form)
    if truth.quaternions is None:
        return ErrorVectors(position)
    to_body = lie.conjugate(truth.quaternions)
    in_body = lie.rotate(to_body, position)
    if aligned.quaternions is None or evaluation.absolute.rotation_deg is None:
        return ErrorVectors(position, in_body)
    between = lie.normalized(rotation_errors(truth.quaternions, aligned.quaternions))
    turn = np.degrees(lie.rotation_vector(between))
    return ErrorVectors(position, in_body, turn, lie.rotate(to_body, turn))
