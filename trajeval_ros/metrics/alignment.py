"""Trajectory alignment: the element of the gauge that brings the estimate to the groundtruth.

Tutorial, section III-C. Many states: Alg. 1 (Umeyama), for yaw with the rotation of eq. (18);
one state: eq. (19) and (20).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.exceptions import DegenerateGeometryError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry import lie, so3
from trajeval_ros.geometry.arrays import Floats, extents
from trajeval_ros.geometry.gauge import Gauge, Similarity
from trajeval_ros.metrics.moments import Moments, OrientationSum
from trajeval_ros.metrics.rotation_uncertainty import RotationUncertainty, rotation_uncertainty

if TYPE_CHECKING:
    from trajeval_ros.metrics.protocol import Protocol

# Ratio of squared lengths below which a component is rounding error rather than motion.
_ROUNDING = 1e-12
# The orientation error that weighs as much as a position error of the size of the ATE. With half
# of it the ATE of good runs grows; with twice of it wrong rotations are corrected less.
_ARM_ANGLE = float(np.radians(2.0))
# Rotation and scale are solved alternately when orientations and a scale are both fitted.
_SAME_SCALE, _MOST_ROUNDS = 1e-12, 50


@dataclass(frozen=True, eq=False)
class Alignment:
    """A fitted similarity, and how well the states determine it."""

    similarity: Similarity  # maps the estimate's frame to the groundtruth's
    states_used: int  # number of states in the fit
    # Uncertainty of the fitted rotation; None for a gauge without rotation, and for an alignment
    # by the pose of one state.
    freedom: RotationUncertainty | None = None
    # The alignment by positions alone if orientations were included in the fit; else None.
    by_positions: Similarity | None = None

    @property
    def scale_alone(self) -> Alignment:
        """The scale alone, about the origin; rotation and translation are the identity."""
        similarity = Similarity(np.eye(3), np.zeros(3), self.similarity.scale)
        return Alignment(similarity, self.states_used)

    @property
    def undetermined(self) -> str:
        """The reason why the states do not determine the rotation; empty if they do."""
        return "" if self.freedom is None else self.freedom.undetermined

    @property
    def why_rotation_withheld(self) -> str:
        """The reason why rotation and velocity errors are meaningless; empty if they are not."""
        return "" if self.freedom is None else self.freedom.why_withheld

    def why_withheld(self, protocol: Protocol) -> str:
        """Return why a protocol withholds rotation and velocity errors; empty if it reports them.

        Protocols that reproduce another program report whatever that program reports, unless the
        rotation is undetermined to rounding.
        """
        if self.freedom is None or (
            protocol.is_of_a_program and np.isfinite(self.freedom.std_deg)
        ):
            return ""
        return self.freedom.why_withheld


def solve(
    gauge: Gauge,
    moments: Moments,
    orientations: OrientationSum | None = None,
    *,
    align_with: str = "positions",
) -> Alignment:
    """Return the least-squares alignment, eq. (13): Alg. 1, with eq. (18) for gauge yaw.

    Args:
        orientations: Sum over the same states; None if a side has no orientations.
        align_with: `positions`, or `poses` to include orientations in the cost: the mean of
            |p - s R q - t|^2 + l^2 |A - R B|^2 / 2, with rotations A and B. The length l is the
            position ATE of the alignment by positions, per 2 deg. `poses` needs `orientations`.
    """
    states = int(moments.weight)
    if not gauge.has_translation:
        return Alignment(Similarity.identity(), states)
    if not (gauge.has_so3 or gauge.yaw_only):
        return Alignment(_mean_to_mean(np.eye(3), 1.0, moments), states)
    similarity, best_scale, is_free = _fit(gauge, moments, np.zeros((3, 3)), 1.0)
    arm_m, by_positions = 0.0, None
    if align_with == "poses":
        assert orientations is not None
        by_positions = similarity
        error_m = moments.rmse(similarity)
        if error_m**2 > _ROUNDING * similarity.scale**2 * moments.variance_q:
            arm_m = error_m / _ARM_ANGLE
        pull = arm_m**2 / 2.0 * orientations.mean
        similarity, best_scale, is_free = _fit(gauge, moments, pull, similarity.scale)
    freedom = rotation_uncertainty(
        gauge,
        moments,
        orientations,
        similarity,
        None if orientations is None else _nearest_rotation(gauge, orientations.mean)[0],
        arm_m,
        best_scale,
        is_free=is_free,
    )
    return Alignment(similarity, states, freedom, by_positions)


def _fit(
    gauge: Gauge, moments: Moments, pull: Floats, scale: float
) -> tuple[Similarity, float, bool]:
    """Return the alignment, the best scale for its rotation, and whether the rotation is free.

    The rotation is free if the cost is constant, up to rounding, along some rotation. `pull` (3,
    3) is the term of the orientations; it is added to s Sigma before the rotation is computed. The
    initial scale has no effect if `pull` is zero.
    """
    sigma = moments.covariance_pq
    for _ in range(_MOST_ROUNDS):
        target = scale * sigma + pull
        rotation, curvature = _nearest_rotation(gauge, target)
        best_scale = _best_scale(rotation, sigma, moments)
        if gauge.has_so3:
            best_scale = max(best_scale, 0.0)  # negative only by a pull that contradicts Sigma
        before, scale = scale, best_scale if gauge.has_scale else 1.0
        if not pull.any() or abs(scale - before) <= _SAME_SCALE * scale:
            break
    is_free = best_scale == 0.0 or curvature <= _ROUNDING * float(np.vdot(rotation, target))
    return _mean_to_mean(rotation, scale, moments), best_scale, is_free


def _nearest_rotation(gauge: Gauge, target: Floats) -> tuple[Floats, float]:
    """Return the gauge's rotation R that maximises tr(R^T K) for K (3, 3): Alg. 1, lines 5 to 8.

    The second value is the least curvature of the trace over all rotation axes.
    """
    if gauge.yaw_only:
        sine, cosine = target[1, 0] - target[0, 1], target[0, 0] + target[1, 1]
        return so3.rot_z(np.arctan2(sine, cosine)), float(np.hypot(sine, cosine))
    # scipy's LAPACK takes a third of the time, but its import takes as long as an evaluation.
    u, d, vt = np.linalg.svd(target)
    flip = -1.0 if _is_mirrored(u @ vt) else 1.0
    return (u * [1.0, 1.0, flip]) @ vt, float(d[1] + flip * d[2])


def _best_scale(rotation: Floats, sigma: Floats, moments: Moments) -> float:
    """Return the scale of Alg. 1, line 9, where trace(D W) equals the trace of R^T Sigma.

    It is negative if a rotation about gravity leaves most of the motion reversed.
    """
    if moments.variance_q <= 0.0:
        return 1.0
    scale = float(np.vdot(rotation, sigma)) / moments.variance_q
    # A groundtruth at rest gives a scale of zero; the remainder is rounding of the sums.
    return scale if abs(scale) > _ROUNDING * moments.anchor.scale else 0.0


def _is_mirrored(orthogonal: Floats) -> bool:
    """Return whether an orthogonal matrix (3, 3) has the determinant -1."""
    (a, b, c), (d, e, f), (g, h, i) = orthogonal.tolist()
    return bool(a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g) < 0.0)


def _mean_to_mean(rotation: Floats, scale: float, moments: Moments) -> Similarity:
    """Return the similarity with the translation of Alg. 1, line 10."""
    return Similarity(rotation, moments.mean_difference(scale * rotation), scale)


def align(
    gauge: Gauge | str,
    groundtruth: Floats,
    estimate: Floats,
    weights: Floats | None = None,
    orientations: tuple[Floats, Floats] | None = None,
    *,
    align_with: str = "positions",
) -> Alignment:
    """Align N estimated positions to the groundtruth: Alg. 1, with eq. (18) for gauge yaw.

    Args:
        gauge: The group of the alignment, or its name.
        groundtruth: (N, 3), metres. Gauge `planar` ignores the height for the rotation.
        estimate: (N, 3), in units of the estimate.
        weights: (N,), positive, one per pair (see `pair_alignment`); None for equal weights.
        orientations: (N, 4) xyzw of the groundtruth and of the estimate, to measure how well
            positions determine the rotation; None if a side has none.
        align_with: `positions` or `poses`, see `solve`; `poses` needs `orientations`.

    Raises:
        DegenerateGeometryError: Fewer states than the gauge needs, or no motion although the
            gauge has a scale. Without motion, a rotation is `undetermined`.

    Example:
        >>> import numpy as np
        >>> from trajeval_ros import align
        >>> points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        >>> align("sim3", 2.0 * points + 5.0, points).similarity.scale.__round__(9)
        2.0
    """
    gauge = Gauge.of(gauge)
    count = len(groundtruth)
    if count < gauge.minimum_states:
        raise DegenerateGeometryError(
            f"gauge {gauge.value} needs at least {counted(gauge.minimum_states, 'pair')}, found "
            f"{count}; align only the first state (align states 1), or use a gauge with fewer "
            "degrees of freedom"
        )
    moments = Moments.of_pairs(groundtruth, estimate, weights)
    if gauge.has_scale:
        _require_motion("groundtruth", groundtruth)
        _require_motion("estimate", estimate)
    orientation_sum = (
        None if orientations is None else OrientationSum.of_pairs(*orientations, weights)
    )
    solution = solve(gauge, moments, orientation_sum, align_with=align_with)
    return dataclasses.replace(solution, states_used=count)


def _require_motion(who: str, positions: Floats) -> None:
    extent = extents(positions).max()
    if extent <= _ROUNDING * max(1.0, float(np.abs(positions[0]).max())):
        raise DegenerateGeometryError(
            f"the {who} does not move in {counted(len(positions), 'aligned state')}, so the "
            "scale is undetermined; align more states, or use a gauge without scale"
        )


def align_first(
    gauge: Gauge,
    groundtruth_position: Floats,
    groundtruth_quaternion: Floats | None,
    estimate_position: Floats,
    estimate_quaternion: Floats | None,
) -> Alignment:
    """Align by the pose of one state: eq. (19), for gauge yaw with the rotation of eq. (20)."""
    if gauge.has_scale:
        raise DegenerateGeometryError(
            "one state does not determine a scale, so gauge sim3 can't be aligned by the first "
            "state (tutorial, Table I); align more states, or use se3"
        )
    rotation = np.eye(3)
    if gauge.minimum_states > 1:
        if groundtruth_quaternion is None or estimate_quaternion is None:
            raise DegenerateGeometryError(
                f"gauge {gauge.value} can't be aligned by the first state without orientations "
                "on both sides; align more states"
            )
        between = lie.multiply(groundtruth_quaternion, lie.conjugate(estimate_quaternion))
        if gauge.has_so3:
            rotation = lie.to_matrix(lie.normalized(between))
        else:
            if np.hypot(between[2], between[3]) < 1e-9:
                raise DegenerateGeometryError(
                    "the first rotations differ by half a turn about a horizontal axis, so the "
                    "yaw is undetermined; check the vertical axes of both trajectories (--up)"
                )
            rotation = so3.rot_z(float(lie.yaw(between)))
    translation = groundtruth_position - rotation @ estimate_position
    similarity = Similarity(rotation, translation if gauge.has_translation else np.zeros(3))
    return Alignment(similarity, 1)
