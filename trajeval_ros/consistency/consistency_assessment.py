"""Consistency tests of an evaluated estimate, by a joint covariance or covariances of poses."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.consistency.consistency_result import (
    AS_PUBLISHED_STATEMENT,
    BOUND_STATEMENT,
    COMMON_FRAME_STATEMENT,
    IN_PLANE_STATEMENT,
    JOINT_STATEMENT,
    OWN_GAUGE_STATEMENT,
    STRIPPED_STATEMENT,
    Consistency,
    Joint,
    sigmas_of,
    verdict_of,
)
from trajeval_ros.consistency.covariance_request import CovarianceRequest, constant_covariances
from trajeval_ros.consistency.joint_covariance import JointCovariance
from trajeval_ros.consistency.nees import (
    chi_square_band,
    diagonal_blocks,
    effective_dof,
    extra_directions,
    joint_nees,
    joint_nees_by_information,
    nees_by_pose,
    summary_of,
)
from trajeval_ros.consistency.s_transformation import (
    IN_PLANE,
    STransformation,
    carried,
    carried_information,
    errors_of,
    independent_noise,
    initial_uncertainty,
    observed_axes,
    turning,
    unknown_covariances,
    upper_bounds,
    without_initial_prior,
)
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.banded_matrices import BandedGaussian
from trajeval_ros.geometry.gauge import POSE_DOF, Gauge, Similarity
from trajeval_ros.geometry.marker import at_arms
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.evaluation import Evaluation

# Largest uncertainty of the first pose relative to the largest one that counts as none.
_NEGLIGIBLE = 1e-4
_UNCOUPLED = 1e-6


def assess_consistency(evaluation: Evaluation, request: CovarianceRequest) -> Consistency:
    """Test whether the errors of an evaluation fit the estimate's covariances.

    Covariances are of the estimate at its own timestamps. The time offset is therefore subtracted.
    Covariances about the body's axes are converted to the world's. If a lever arm or another up
    axis is applied to the estimate, call `CovarianceRequest.about_world` before, as `run` does.

    Args:
        evaluation: Paired states, with covariances of the estimate for source `message`.
        request: Source of the covariances, not `none`.

    Raises:
        InputError: The covariances are unknown, or belong to other poses.
        SettingsError: Covariances cannot be transformed to the gauge of the alignment.
        DegenerateGeometryError: The states do not determine the alignment.

    Example:
        >>> import numpy as np
        >>> from dataclasses import replace
        >>> from trajeval_ros import CovarianceRequest, Protocol, assess_consistency
        >>> from trajeval_ros import evaluate, simulate
        >>> flight = simulate(seed=1, duration_s=30.0)
        >>> block = np.diag([0.1**2] * 3 + [0.01**2] * 3)
        >>> growth = np.linspace(1.0, 1.1, len(flight.estimate))
        >>> blocks = growth[:, None, None] * block
        >>> estimate = replace(flight.estimate, covariances=blocks)
        >>> result = evaluate(flight.groundtruth, estimate, Protocol(gauge="yaw"))
        >>> request = CovarianceRequest("message", groundtruth_noise=(0.002, 0.1))
        >>> consistency = assess_consistency(result, request)
        >>> consistency.exactness, consistency.nees.shape == (len(result.association),)
        ('bound', True)
    """
    as_published = evaluation.protocol.nees_form == "as_published"
    if as_published and request.joint is not None:
        raise SettingsError(
            "NEES form as_published (protocol ov_eval) needs covariances of single poses; use "
            "--covariance message, or another protocol for a joint covariance"
        )
    aligned = _aligned(evaluation, request)
    if request.joint is not None:
        try:
            return assess_joint(aligned, request.joint, request.name.rpartition("/")[2])
        except InputError as error:
            raise InputError(f"{request.name}: {error}") from error
    at_start = evaluation.association.from_the_start
    return assess_marginals(aligned, from_the_start=at_start, as_published=as_published)


def _aligned(evaluation: Evaluation, request: CovarianceRequest) -> AlignedStates:
    """Return the aligned states of an evaluation at the estimate's own timestamps."""
    protocol, pairs = evaluation.protocol, evaluation.association
    if protocol.align_weights != "none":
        raise SettingsError(
            "the consistency test needs an alignment with equal weights; use align weights none"
        )
    if protocol.align_with != "positions":
        raise SettingsError(
            "the consistency test needs an alignment by positions; use align with positions"
        )
    if evaluation.alignment.why_rotation_withheld:
        why = evaluation.alignment.why_rotation_withheld
        raise InputError(f"no covariance can be transformed to this gauge: {why}")
    offset = round(protocol.association.time_offset_s * NANOSECONDS)
    estimate = dataclasses.replace(pairs.estimate, stamps=pairs.estimate.stamps - offset)
    estimate = request.about_world(estimate)
    return AlignedStates(
        groundtruth=pairs.groundtruth,
        estimate=estimate,
        similarity=evaluation.alignment.similarity,
        gauge=protocol.gauge,
        states=protocol.align_states,
        noise=_noise(pairs.groundtruth, request),
    )


def _noise(groundtruth: Trajectory, request: CovarianceRequest) -> Floats | None:
    """Return covariances (N, 6, 6) of the groundtruth's errors; None if it has none.

    Groundtruth of the body is p_M - R l if that of its marker is p_M: errors of the rotation move
    it by s_R^2 (|l|^2 I - a a'), a = R l, and are correlated with that.
    """
    if request.groundtruth_noise is None:
        return None
    position_m, rotation_deg = request.groundtruth_noise
    variances = np.square([position_m] * 3 + [math.radians(rotation_deg)] * 3)
    noise: Floats = np.broadcast_to(np.diag(variances), (len(groundtruth), 6, 6))
    if request.marker_lever_m is None or groundtruth.quaternions is None:
        return noise
    arms = lie.rotate(groundtruth.quaternions, np.array(request.marker_lever_m))
    return at_arms(noise, -arms)


@dataclass(frozen=True, eq=False)
class AlignedStates:
    """Paired states and their alignment."""

    groundtruth: Trajectory  # N states
    estimate: Trajectory  # N states, paired with them, in their own frame
    similarity: Similarity  # the alignment
    gauge: Gauge  # its gauge
    states: int | None  # number of aligned states, 1 for the first; None for all
    # (N, 6, 6), covariances of the groundtruth's errors, m^2 and rad^2; None for none
    noise: Floats | None = None

    def __post_init__(self) -> None:
        """Check the shape of the noise, which would otherwise be repeated without a word.

        Raises:
            ValueError: The noise is not a covariance per state.
        """
        expected = (len(self.estimate), POSE_DOF, POSE_DOF)
        if self.noise is not None and np.shape(self.noise) != expected:
            raise ValueError(f"noise has shape {np.shape(self.noise)}, expected {expected}")

    def transformation(self) -> STransformation:
        """Return the S-transformation to the alignment's gauge."""
        needed = max(2, self.first_with_nees + 1)
        if len(self.estimate) < needed:
            raise InputError(
                f"the consistency test needs at least {needed} pairs, found {len(self.estimate)}"
            )
        aligned = self.similarity.trajectory(self.estimate)
        return STransformation.of_alignment(self.gauge, self.states, self.groundtruth, aligned)

    def errors(self) -> Floats:
        """Return the errors (N, 6), position (m) and rotation (rad)."""
        return errors_of(self.groundtruth, self.similarity.trajectory(self.estimate))

    @property
    def first_with_nees(self) -> int:
        """Number of first poses without a NEES, because the alignment makes their errors exact.

        The least number of positions that determine an alignment have no error in some direction:
        three positions have none perpendicular to their plane.
        """
        if self.gauge is Gauge.NONE:
            return 0
        aligned = len(self.estimate) if self.states is None else self.states
        return aligned if aligned in (1, self.gauge.minimum_states) else 0


def assess_joint(aligned: AlignedStates, covariance: JointCovariance, source: str) -> Consistency:
    """Test a run with the joint covariance of all poses: exact in every gauge."""
    covariance.require_sound()
    if aligned.gauge is Gauge.NONE and covariance.gauge in ("free", "first4"):
        raise InputError(
            f"a joint covariance in gauge {covariance.gauge} has no information on global "
            "position and yaw; align by gauge yaw"
        )
    transformation, errors = aligned.transformation(), aligned.errors()
    rows = covariance.rows_of(aligned.estimate)
    per_pose, nees, blocks = None, None, None
    if covariance.is_dense:
        transformed = carried(covariance.pose_covariance(rows), aligned.similarity)
        if aligned.noise is not None:
            count, item = len(errors), np.arange(len(errors))
            blocks_of = transformed.reshape(count, POSE_DOF, count, POSE_DOF)
            blocks_of[item, :, item] += aligned.noise
        projected = transformation.covariance(transformed)
        value = joint_nees(errors, projected, transformation.normals)
        first = aligned.first_with_nees
        blocks = diagonal_blocks(projected, POSE_DOF)
        nees = nees_by_pose(errors, blocks, first)
        part = slice(POSE_DOF * first, None)
        per_pose = summary_of(nees, effective_dof(projected[part, part], POSE_DOF))
    else:
        assert covariance.information is not None
        open_ = covariance.gauge == "free"
        value = joint_nees_by_information(
            errors,
            carried_information(covariance.information, aligned.similarity, covariance.block),
            extra_directions(transformation) if open_ else transformation.orbit,
            aligned.noise,
            covariance.pose_rows(rows),
        )
        banded = covariance.banded()
        if banded is not None:
            blocks = _blocks_of_banded(
                banded, covariance, rows, aligned.similarity, transformation
            )
            if aligned.noise is not None:
                blocks = blocks + independent_noise(transformation, aligned.noise)
            nees = nees_by_pose(errors, blocks, aligned.first_with_nees)
            per_pose = summary_of(nees)
    joint = Joint(value, transformation.dof, chi_square_band(transformation.dof))
    return Consistency(
        gauge=aligned.gauge,
        covariance_source=source,
        exactness="exact",
        statement=JOINT_STATEMENT,
        verdict=verdict_of(joint),
        joint=joint,
        per_pose=per_pose,
        pose_nees=nees,
        errors=errors,
        covariances=blocks,
    )


def _blocks_of_banded(
    banded: BandedGaussian,
    covariance: JointCovariance,
    rows: NDArray[np.int64],
    similarity: Similarity,
    transformation: STransformation,
) -> Floats:
    """Return the poses' own blocks (M, 6, 6) in the alignment's gauge, for runs of any length."""
    rotation, seen = turning(similarity, POSE_DOF), covariance.pose_rows(rows)
    columns = np.zeros((len(covariance.stamps) * covariance.block, transformation.orbit.shape[2]))
    columns[seen] = np.swapaxes(transformation.pull @ rotation, 1, 2).reshape(len(seen), -1)
    solved = banded.solved(columns)[seen].reshape(len(rows), POSE_DOF, -1)
    marginals = banded.marginals(rows * covariance.block, POSE_DOF)
    return transformation.blocks(
        rotation @ marginals @ rotation.T, np.swapaxes(solved, 1, 2) @ rotation.T
    )


def assess_marginals(
    aligned: AlignedStates, *, from_the_start: bool, as_published: bool = False
) -> Consistency:
    """Test a run with the covariances of single poses about the world's axes, as in ROS messages.

    `from_the_start` states that the first pair has the first published estimate. With
    `as_published`, covariances are not transformed to the gauge of the alignment, as in ov_eval.
    """
    covariances = aligned.estimate.covariances
    name = aligned.estimate.name or "the estimate"
    if covariances is None:
        raise InputError(
            f"{name} has no covariances, or only zeros (unknown); give a joint covariance with "
            "--covariance FILE.npz, or use --covariance none"
        )
    gauge, axes = aligned.gauge, observed_axes(covariances)
    if gauge is Gauge.PLANAR:  # for x, y and yaw the same as gauge yaw
        axes, aligned = IN_PLANE, dataclasses.replace(aligned, gauge=Gauge.YAW)
    # Checked first: the covariances of a single pair would look like unknown ones.
    transformation, errors = aligned.transformation(), aligned.errors()
    pose_blocks = covariances[:, axes[:, None], axes]
    why = unknown_covariances(pose_blocks) or constant_covariances(covariances)
    if why:
        raise InputError(f"covariances of {name} are not valid: {why}; use --covariance none")
    if len(axes) < POSE_DOF and gauge.has_so3:
        raise InputError(
            f"{name} has covariances of x, y and yaw only, which gauge {gauge.value} mixes with "
            "other axes; use gauge planar or yaw"
        )
    others = np.setdiff1d(np.arange(POSE_DOF), axes)
    errors[:, others] = 0.0
    blocks = carried(_without(covariances, others), aligned.similarity)
    statement, exactness = BOUND_STATEMENT, "exact"
    if aligned.gauge is Gauge.NONE:
        statement = COMMON_FRAME_STATEMENT
    elif as_published:
        statement, exactness = AS_PUBLISHED_STATEMENT, "as published"
    elif aligned.gauge is Gauge.YAW and aligned.states == 1 and from_the_start:
        statement, blocks = _in_own_gauge(blocks, transformation)
    if statement == BOUND_STATEMENT:
        exactness, blocks = "bound", upper_bounds(blocks, transformation)
    in_gauge = exactness != "as published"
    if aligned.noise is not None:
        noise = aligned.noise
        blocks = blocks + (independent_noise(transformation, noise) if in_gauge else noise)
    blocks = _without(blocks, others)
    known = 0 if (sigmas_of(blocks[:1, axes][:, :, axes]) > 0.0).all() else 1
    nees = nees_by_pose(errors, blocks, max(aligned.first_with_nees * in_gauge, known), axes)
    per_pose = summary_of(nees, in_gauge=in_gauge, pose_dof=len(axes))
    over = per_pose.limit_95 is not None and per_pose.max > per_pose.limit_95
    return Consistency(
        gauge=gauge,
        covariance_source="message",
        exactness=exactness,
        statement=statement + (IN_PLANE_STATEMENT if len(others) else ""),
        verdict="overconfident" if over else "undecided",
        joint=None,
        per_pose=per_pose,
        pose_nees=nees,
        errors=errors,
        covariances=blocks,
    )


def _without(blocks: Floats, axes: NDArray[np.int64]) -> Floats:
    """Return covariances (N, 6, 6) with zeros in the rows and columns of some axes, or of none."""
    if not len(axes):
        return blocks
    kept = blocks.copy()
    kept[:, axes] = kept[:, :, axes] = 0.0
    return kept


def _in_own_gauge(blocks: Floats, transformation: STransformation) -> tuple[str, Floats]:
    """Return the statement for the gauge of the first pose, and the covariances for it."""
    initial = initial_uncertainty(blocks, transformation)
    orbit = transformation.orbit[:, :3]
    moved = np.trace(orbit @ initial @ np.swapaxes(orbit, 1, 2), axis1=1, axis2=2).max()
    largest = np.trace(blocks[:, :3, :3], axis1=1, axis2=2).max()
    if moved <= _NEGLIGIBLE * largest:
        return OWN_GAUGE_STATEMENT, blocks
    first = blocks[0]
    units = np.sqrt(np.maximum(np.diagonal(first), 0.0))
    held, tilt = [0, 1, 2, 5], [3, 4]
    cross = np.abs(first[np.ix_(held, tilt)]) / np.maximum(
        units[held][:, None] * units[tilt], np.finfo(float).tiny
    )
    if cross.max() > _UNCOUPLED:
        return BOUND_STATEMENT, blocks
    try:
        return STRIPPED_STATEMENT, without_initial_prior(blocks, transformation)
    except InputError:
        return BOUND_STATEMENT, blocks
